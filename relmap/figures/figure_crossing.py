"""Beyond figure 7: the noise above which planes give the better map, from the same points.

The points are fixed on the walls of a building (`surface_points`).  The plane mapper segments each
scan; the point mapper uses the points as landmarks.  Both have default settings and no
odometry.  Points with known ids show the effect of data association.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.core.arrays import Bools, Floats
from relmap.evaluation.surface_points import HALF, METHODS, Method, VariantRun, map_of, wall_points
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged, sentence
from relmap.figures.figure06 import longest
from relmap.plots.sheet import BLUE, GREY, ORANGE, RED, blank, finish, legend_below

Grid = tuple[Iterable[float], Iterable[float], Iterable[int]]
FULL: Grid = ((0.2, 0.3, 0.4), (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5), range(5))
"""Spacings in metres, noise in units of them, seeds."""
QUICK: Grid = ((0.3,), (0.05, 0.15, 0.3), range(1))
COLOURS: dict[Method, str] = {"planes": BLUE, "points": RED, "points, ids given": ORANGE}
BAR = 1.2
"""Target map error of planes at the noise of figure 7, in units of sigma."""
PANELS = {
    "map_rmse_m": ("error of the map", "RMSE of corners or points [m]"),
    "ate_m": ("error of the path", "ATE of the available poses [m]"),
    "coverage": ("how much is mapped", "corners or points seen ten times [%]"),
}


@dataclass(frozen=True)
class Crossing:
    """All runs with points of one spacing, in the order of `METHODS` within each cell."""

    spacing_m: float
    runs: tuple[VariantRun, ...]

    @property
    def noise(self) -> Floats:
        """All noises in units of the spacing, ascending; (n,)."""
        return np.unique([row.noise for row in self.runs])

    def values(self, name: str, method: Method) -> Floats:
        """Return an attribute of all runs of a method, (noises, seeds); None as infinite."""
        found = [
            [getattr(row, name) for row in self.runs if (row.method, row.noise) == (method, noise)]
            for noise in self.noise
        ]
        return np.array([[np.inf if v is None else v for v in values] for values in found])

    def median(self, name: str, method: Method) -> Floats:
        """Return the median over the seeds, (noises,), of what `values` returns."""
        return np.asarray(np.median(self.values(name, method), axis=1))

    def failed(self, method: Method) -> Bools:
        """Return the noises at which the median run of a method maps too little, (noises,)."""
        return self.median("coverage", method) < HALF

    def planes_ahead(self, method: Method) -> tuple[float, float] | None:
        """Return the range of noise, over the spacing, in which planes have the better map.

        The longest of several such intervals. It begins where the medians of the map error cross,
        by linear interpolation, or at the first noise at which points fail; it ends at the last
        noise at which planes are better. None if they never are.
        """
        planes, points = (
            np.where(self.failed(which), np.inf, self.median("map_rmse_m", which))
            for which in (METHODS[0], method)
        )
        ahead = planes < points
        if not ahead.any():
            return None
        noise, (k, end) = self.noise, longest(ahead)
        begin, last = float(noise[k]), float(noise[end - 1])
        if k == 0 or not np.isfinite(points[k - 1] + planes[k - 1] + points[k] + planes[k]):
            return begin, last
        before, after = points[k - 1] - planes[k - 1], points[k] - planes[k]
        return float(noise[k - 1] + (noise[k] - noise[k - 1]) * before / (before - after)), last

    def fails_at(self, method: Method) -> float | None:
        """Return the noise, over the spacing, above which a method maps too little, if any."""
        works = np.flatnonzero(~self.failed(method))
        beyond = self.noise[works[-1] + 1 if len(works) else 0 :]
        return float(beyond[0]) if len(beyond) else None


def run_crossing(
    spacings_m: Iterable[float],
    noises: Iterable[float],
    seeds: Iterable[int],
    iterations: int | None = None,
    progress: Watch = iter,
) -> list[Crossing]:
    """Map the same points as planes and as points, for all spacings, noises and seeds.

    `spacings_m`: of the points on the walls, metres. `noises`: in units of the spacing. `seeds`: of
    building, points and noise. `iterations`: scans of a run; one loop if omitted. `progress`: wraps
    the list of cells, to show progress. Returns the runs of each spacing.
    """
    runs: dict[float, list[VariantRun]] = {}
    for spacing_m, noise, seed in progress(list(product(spacings_m, noises, seeds))):
        seen = wall_points(spacing_m, noise, seed, iterations)
        runs.setdefault(spacing_m, []).extend(map_of(method, seen)[1] for method in METHODS)
    return [Crossing(spacing_m, tuple(each)) for spacing_m, each in runs.items()]


def _judge(data: list[Crossing]) -> Outcome:
    ahead = [each.planes_ahead("points") for each in data]
    begins = [interval[0] for interval in ahead if interval is not None]
    rows = [["" if v is None else v for v in astuple(run)] for each in data for run in each.runs]
    return Outcome(
        Table([field.name for field in fields(VariantRun)], rows),
        max(begins, default=float("nan")),
        " ".join(sentence(_said(each)) for each in data),
        judged(len(begins) == len(ahead), None not in [each.fails_at("points") for each in data]),
    )


def _said(data: Crossing) -> str:
    """Describe above which noise planes have the better map."""
    lowest, highest = data.noise[[0, -1]]

    def at(begin: float | None, last: float = highest) -> str:
        if begin is None:
            return "nowhere"
        text = f"from {begin:.2f}" + (" or below" if begin <= lowest else "")
        return text + (f" to {last:g}" if last < highest else "")

    own, known = (data.planes_ahead(method) for method in METHODS[1:])
    fails, planes_fail = (at(data.fails_at(method)) for method in ("points", "planes"))
    return (
        f"points {data.spacing_m:g} m apart: planes have the better map {at(*own or (None,))}, "
        f"{at(*known or (None,))} if the ids of points were given; "
        f"points lose half {fails}, planes {planes_fail}"
    )


def _plot(data: list[Crossing]) -> Figure:
    """Draw errors and mapped fractions over the noise: a row for each spacing of the points."""
    figure = blank(13.5, 0.9 + 3.7 * len(data))
    grid = figure.subplots(len(data), len(PANELS), squeeze=False)
    for row, each in zip(grid, data, strict=True):
        for axes, name in zip(row, PANELS, strict=True):
            _draw_panel(axes, each, name)
    legend_below(figure, 5, grid[0, 0])
    title = "Planes and points from the same raw points, over sigma / spacing"
    figure.suptitle("\n".join([title, *map(_said, data)]), fontsize=11)
    return figure


def _draw_panel(axes: Axes, data: Crossing, name: str) -> None:
    share = name == "coverage"
    scale = 100 if share else 1
    for method, colour in COLOURS.items():
        runs, median = data.values(name, method) * scale, data.median(name, method) * scale
        runs = np.where(np.isfinite(runs), runs, np.nan)
        shown = np.isfinite(median) & (share | ~data.failed(method))
        label = f"{method}, median"
        axes.plot(data.noise, runs, ".", color=colour, markersize=4, alpha=0.5)
        median = np.where(shown, median, np.nan)
        axes.plot(data.noise, median, "o-", color=colour, markersize=5, label=label)
    axes.plot([], [], ".", color=GREY, label="one seed")
    if share:
        axes.axhline(100 * HALF, color=GREY, linestyle=":", linewidth=1.2)
        axes.set_ylim(-4, 104)
    else:
        axes.set_yscale("log")
    if name == "map_rmse_m":
        bar = BAR * data.noise * data.spacing_m
        axes.plot(data.noise, bar, ":", color=GREY, label=f"{BAR} sigma")
    title, unit = PANELS[name]
    finish(axes, f"{title}, points {data.spacing_m:g} m apart", "noise: sigma / spacing", unit)


FIGURE = PaperFigure(
    name="crossing",
    title="planes and points over the noise",
    claim=(
        "Planes can still be mapped where the noise is too large for points, as figure 7 shows "
        "(this picture is not in the paper)."
    ),
    criterion=(
        "at every spacing of the points there is a noise above which planes have the better map, "
        "and one at which points lose half of it; partly where one of the two holds"
    ),
    unit="noise over spacing above which planes have the better map",
    run=lambda quick, data, watch: run_crossing(*(QUICK if quick else FULL), progress=watch),
    judge=_judge,
    draw=_plot,
)
