"""``relmap demo``: points and walls from simulated scans, and one page with the results."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from relmap.cli.arguments import Out, Seed
from relmap.cli.console import busy, figure, print_table

if TYPE_CHECKING:
    from relmap.evaluation.evaluate import Evaluation
    from relmap.evaluation.run import Run

HELP = """Map simulated scans and compare the maps with the truth.

First a robot flies a figure eight of 740 m past 185 point landmarks and observes them with a noise
of 5 cm. The log is mapped with known ids ('known') and without ids ('nearest'). Then a robot drives
through a building and observes fixed points on its walls, with low and with high noise. The same
scans are mapped as planes and as points.

DIR/index.html shows all pictures.  DIR holds the files of 'relmap simulate' and 'relmap map', and
DIR/nearest those of the map without ids.

\b
Example:
  relmap demo -o demo
"""

INDEX = "index.html"
STYLE = "img { display: inline }"
INTRODUCTION = """<p>Maps of simulated scans, compared with the truth. RMSE and ATE (of the path)
are after rigid alignment; coverage is the fraction of the landmarks seen at least ten times that
are mapped; purity is 1 where every observation is assigned to the right landmark. Reports to pan,
zoom and replay: <a href="report.html">with ids</a>, <a href="nearest/report.html">without</a>.</p>
"""
SPACING_M, ITERATIONS = 0.3, 50
NOISES = {"little": 0.05, "much": 0.3}
"""Noise of the points on walls, in units of their spacing."""
Rows = Sequence[Sequence[str]]


def command(out: Out = Path("relmap-demo"), seed: Seed = 0) -> None:
    """Run the demonstration; the help text explains the arguments."""
    from relmap.io.files import atomic_write
    from relmap.plots.html import document

    parts = [_figure_eight(out, seed)]
    parts += [_both_variants(out, name, noise, seed) for name, noise in NOISES.items()]
    page = document("relmap demo", ["<h1>relmap demo</h1>", INTRODUCTION, *parts], STYLE)
    atomic_write(out / INDEX, page)
    typer.echo(f"wrote {INDEX} and the files behind it to {out}")


def _figure_eight(out: Path, seed: int) -> str:
    """Map the figure eight with and without ids; return its section of the page."""
    from relmap.cli.evaluate import evaluate_folder, rows_of
    from relmap.cli.mapping import map_input
    from relmap.cli.simulated import write_figure_eight
    from relmap.evaluation.sources import EightSource

    typer.echo(f"simulated {write_figure_eight(out, EightSource(seed=seed))}")
    log = out / "observations.csv"
    known = map_input(log, out, "known")
    nearest = map_input(log, out / "nearest", "nearest")
    evaluations = evaluate_folder(out, out), evaluate_folder(out / "nearest", out)
    rows = rows_of(*evaluations)
    timings = [run.result.summary["timing"]["median_ms"] for run in (known, nearest)]
    rows.append(("median time per iteration [ms]", *map(figure, timings)))
    title, header = "point landmarks of the figure eight", ("metric", "known", "nearest")
    print_table(title, header, rows)
    _draw(out, out, known, evaluations[0])
    _draw(out / "nearest", out, nearest, evaluations[1])
    text = "Mapped with known ids (known, left), and without ids (nearest, right)."
    return _part(title, text, header, rows, "map.png", "nearest/map.png")


def _draw(folder: Path, out: Path, run: Run, evaluation: Evaluation) -> None:
    from relmap.cli.evaluate import find_log
    from relmap.evaluation.landmarks import overlay
    from relmap.evaluation.truth import read_truth
    from relmap.io.results import MAP_PNG
    from relmap.plots.run import plot_run
    from relmap.plots.sheet import write_png

    truth = overlay(run.result, read_truth(out), find_log(run.result, out, None))
    counts = run.result.summary["counts"]
    title = (
        f"{counts['mapped']} of {counts['landmarks']} landmarks mapped, "
        f"RMSE {figure(evaluation.landmark_rmse_m)} m"
    )
    write_png(folder / MAP_PNG, plot_run, run.result, run.groups, truth, title)


def _both_variants(out: Path, name: str, noise: float, seed: int) -> str:
    """Map the same scans as planes and as points; return their section of the page."""
    from relmap.evaluation.surface_points import wall_points
    from relmap.plots.sheet import write_png
    from relmap.plots.variants import both_maps, plot_both

    with busy("mapping the building as planes and as points"):
        maps = both_maps(wall_points(SPACING_M, noise, seed, ITERATIONS))
    sigma_m, picture = maps.planes.run.sigma, f"building-{name}-noise.png"
    title = f"the same scans of a building as planes and as points, noise {sigma_m:g} m"
    write_png(out / picture, plot_both, maps, title)
    runs = maps.planes.run, maps.points.run
    header = ("metric", "planes", "points")
    rows = [
        ("RMSE of corners, of points [m]", *(figure(run.map_rmse_m) for run in runs)),
        ("coverage", *(figure(run.coverage) for run in runs)),
        ("ATE [m]", *(figure(run.ate_m) for run in runs)),
        ("fraction of scans with a pose", *(figure(run.poses) for run in runs)),
    ]
    print_table(title, header, rows)
    text = f"Points on the walls are about {SPACING_M:g} m apart, and no ids are given."
    return _part(title, text, header, rows, picture)


def _part(title: str, text: str, header: Sequence[str], rows: Rows, *pictures: str) -> str:
    """Return a heading, a table and pictures, side by side, of the page."""
    from relmap.plots.html import table

    heading, width = escape(title.capitalize()), 100 // len(pictures)
    style = f'style="max-width: {width}%"'
    shown = "".join(f'<img src="{name}" alt="{escape(title)}" {style}>' for name in pictures)
    return f"<h2>{heading}</h2><p>{escape(text)}</p>{table(header, rows)}{shown}"
