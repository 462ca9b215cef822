"""``relmap demo``: simulate, map and evaluate in one go."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from relmap.cli.arguments import Out, Seed
from relmap.cli.console import figure, print_table

if TYPE_CHECKING:
    from relmap.evaluation.evaluate import Evaluation
    from relmap.evaluation.run import Run

HELP = """See relmap at work: simulate, map and evaluate.

The robot flies a figure eight of 740 m past 185 landmarks and sees them with a noise of 5 cm.  It
is mapped twice: once told which landmark is which ('known'), once having to find out ('nearest').
DIR/map.png shows the map; DIR holds the files of 'relmap simulate' and 'relmap map', and
DIR/nearest those of the second map.

\b
Example:
  relmap demo -o demo
"""


def demo_command(
    out: Out = Path("relmap-demo"),
    seed: Seed = 0,
) -> None:
    """Run the demonstration; the help text explains the arguments."""
    from relmap.cli.evaluate import evaluate_folder, rows_of
    from relmap.cli.mapping import map_input
    from relmap.cli.simulate import write_figure_eight
    from relmap.evaluation.sources import EightSource

    typer.echo(f"simulated {write_figure_eight(out, EightSource(seed=seed))}")
    log = out / "observations.csv"
    known = map_input(log, out, "known")
    nearest = map_input(log, out / "nearest", "nearest")
    evaluations = evaluate_folder(out, out), evaluate_folder(out / "nearest", out)
    rows = rows_of(*evaluations)
    timings = [run.result.summary["timing"]["median_ms"] for run in (known, nearest)]
    rows.append(("median time per iteration [ms]", *map(figure, timings)))
    print_table("the map against the truth, by association", ("figure", "known", "nearest"), rows)
    _draw(out, known, evaluations[0])
    typer.echo(f"wrote map.png and the files behind it to {out}")


def _draw(out: Path, run: Run, evaluation: Evaluation) -> None:
    """Draw the map again, now with the truth in it."""
    from relmap.cli.evaluate import find_log
    from relmap.evaluation.landmarks import overlay
    from relmap.evaluation.truth import read_truth
    from relmap.io.results import MAP_PNG
    from relmap.plots.run import write_map_png

    truth = overlay(run.result, read_truth(out), find_log(run.result, out, None))
    counts = run.result.summary["counts"]
    title = (
        f"{counts['mapped']} of {counts['landmarks']} landmarks mapped, "
        f"RMSE {figure(evaluation.landmark_rmse_m)} m"
    )
    write_map_png(out / MAP_PNG, run.result, run.groups, truth, title)
