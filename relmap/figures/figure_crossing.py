"""Beyond figure 7: from which noise on planes have the better map, from the same points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged, sentence
from relmap.figures.crossing import HALF, METHODS, Crossing, Method, run_crossing
from relmap.plots.sheet import BLUE, GREY, ORANGE, RED, blank, finish, legend_below

FULL = ((0.2, 0.3, 0.4), (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5), range(5))
"""Spacings in metres, noises in units of them, seeds."""
COLOURS: dict[Method, str] = {"planes": BLUE, "points": RED, "points, ids given": ORANGE}
BAR = 1.2
"""Map error of planes at Fig. 7's noise, in units of sigma, that is aimed at."""
PANELS = {
    "map_rmse_m": ("error of the map", "RMSE of corners or points [m]"),
    "ate_m": ("error of the path", "ATE of the poses there are [m]"),
    "coverage": ("how much is mapped", "corners or points seen ten times [%]"),
}
QUICK = ((0.3,), (0.05, 0.15, 0.3), range(1))


def _run(quick: bool, data: Path | None, watch: Watch) -> Outcome:
    """Map points of walls both ways, over spacings, noises and seeds."""
    spacings_m, noises, seeds = QUICK if quick else FULL
    return outcome(run_crossing(spacings_m, noises, seeds, progress=watch))


def outcome(data: Crossing) -> Outcome:
    """Judge all runs."""
    points = METHODS[1]
    ahead = [data.planes_ahead(points, spacing_m) for spacing_m in data.spacings_m]
    lost = [data.fails_at(points, spacing_m) for spacing_m in data.spacings_m]
    begins = [interval[0] for interval in ahead if interval is not None]
    return Outcome(
        lambda: plot_crossing(data),
        Table(data.COLUMNS, list(data.rows())),
        max(begins, default=float("nan")),
        "noise over spacing from which on planes have the better map",
        " ".join(map(sentence, said(data).splitlines())),
        judged(len(begins) == len(ahead), None not in lost),
    )


def plot_crossing(data: Crossing) -> Figure:
    """Draw errors and what is mapped over the noise: a row for each spacing of the points."""
    spacings = data.spacings_m
    figure = blank(13.5, 0.9 + 3.7 * len(spacings))
    grid = figure.subplots(len(spacings), len(PANELS), squeeze=False)
    for row, spacing_m in zip(grid, spacings, strict=True):
        for axes, name in zip(row, PANELS, strict=True):
            _draw_panel(axes, data, name, spacing_m)
    legend_below(figure, 5, grid[0, 0])
    title = "Planes and points from the same raw points, over sigma / spacing"
    figure.suptitle(f"{title}\n{said(data)}", fontsize=11)
    return figure


def said(data: Crossing) -> str:
    """Return where planes overtake points, a line for each spacing."""
    return "\n".join(_said(data, spacing_m) for spacing_m in data.spacings_m)


def _said(data: Crossing, spacing_m: float) -> str:
    lowest, highest = data.noises(spacing_m)[0], data.noises(spacing_m)[-1]

    def at(begin: float | None, last: float = highest) -> str:
        if begin is None:
            return "nowhere"
        text = f"from {begin:.2f}" + (" or below" if begin <= lowest else "")
        return text + (f" to {last:g}" if last < highest else "")

    own, known = (data.planes_ahead(method, spacing_m) for method in METHODS[1:])
    fails, planes_fail = (at(data.fails_at(method, spacing_m)) for method in ("points", "planes"))
    return (
        f"points {spacing_m:g} m apart: planes have the better map {at(*own or (None,))}, "
        f"{at(*known or (None,))} if the ids of points were given; "
        f"points lose half {fails}, planes {planes_fail}"
    )


def _draw_panel(axes: Axes, data: Crossing, name: str, spacing_m: float) -> None:
    noise = np.array(data.noises(spacing_m))
    share = name == "coverage"
    scale = 100 if share else 1
    for method, colour in COLOURS.items():
        runs = data.values(name, method, spacing_m) * scale
        runs = np.where(np.isfinite(runs), runs, np.nan)
        median = data.median(name, method, spacing_m) * scale
        lost = data.median("coverage", method, spacing_m) < HALF
        median = np.where(np.isfinite(median) & (share | ~lost), median, np.nan)
        axes.plot(noise, runs, ".", color=colour, markersize=4, alpha=0.5)
        axes.plot(noise, median, "o-", color=colour, markersize=5, label=f"{method}, median")
    axes.plot([], [], ".", color=GREY, label="one seed")
    if share:
        axes.axhline(100 * HALF, color=GREY, linestyle=":", linewidth=1.2)
        axes.set_ylim(-4, 104)
    else:
        axes.set_yscale("log")
    if name == "map_rmse_m":
        axes.plot(noise, BAR * noise * spacing_m, ":", color=GREY, label=f"{BAR} sigma")
    title, unit = PANELS[name]
    finish(axes, f"{title}, points {spacing_m:g} m apart", "noise: sigma / spacing", unit)


FIGURE = PaperFigure(
    name="crossing",
    title="planes and points over the noise",
    claim=(
        "Planes can still be mapped where the noise is too large for points, which is what figure "
        "7 stands for (this picture is not in the paper)."
    ),
    criterion=(
        "at every spacing of the points there is a noise from which on planes have the better map, "
        "and one at which points lose half of it; partly where one of the two holds"
    ),
    run=_run,
)
