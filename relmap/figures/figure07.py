"""Figure 7: planes can be mapped under noise under which points cannot; and above which noise.

The points are fixed on the walls of a building (`surface_points`).  The plane mapper segments each
scan; the point mapper uses the points as landmarks.  Both have default settings and no
odometry.  For the crossing points with known ids show the effect of data association.
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
from relmap.plots.bench_recorder import COLUMNS, rows_of
from relmap.plots.sheet import BLUE, GREY, ORANGE, RED, blank, finish, legend_below
from relmap.plots.variants import BothMaps, both_maps, plot_both

QUICK_ITERATIONS = 80
MUCH = 2.0
SPACING_M = 0.2
NOISE = 0.3
"""Sigma over the spacing: points are no longer distinguishable from one scan to the next."""
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


def _judge_seven(maps: BothMaps) -> Outcome:
    planes, points = maps.planes.run, maps.points.run
    planes_m, points_m = planes.map_rmse_m, points.map_rmse_m
    hold = planes_m is not None and planes.coverage >= HALF
    lost = points_m is None or points.coverage < HALF
    worse = lost or (planes_m is not None and points_m is not None and points_m > MUCH * planes_m)
    shapes = {"true wall": maps.true_walls, "mapped wall": maps.planes.shapes}
    shapes |= {"mapped point": maps.points.shapes}
    shapes |= {"pose, planes": maps.planes.path, "pose, points": maps.points.path}
    return Outcome(
        Table(COLUMNS, list(rows_of(shapes))),
        float("nan") if planes_m is None else planes_m,
        f"Noise {planes.sigma:.3g} m, {planes.noise:g} of the spacing of the points. "
        f"Planes: {maps.planes.said}. Points, without ids: {maps.points.said}.",
        judged(hold, worse),
    )


def _plot_seven(maps: BothMaps) -> Figure:
    run = maps.planes.run
    return plot_both(
        maps,
        f"Figure 7: noise of {run.sigma:.3g} m, {run.noise:g} of the {run.spacing_m:g} m "
        f"between the points, seed {run.seed}",
    )


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


SEVEN = PaperFigure(
    name="7",
    title="planes under noise too large for points",
    claim=(
        "Under noise so large that no point can be distinguished from its neighbours, the map of "
        "planes has some error; points could not be mapped at all."
    ),
    criterion=(
        f"planes: {HALF:.0%} of the corners seen ten times are mapped, and points: less than "
        f"{HALF:.0%} of them are, or they are {MUCH:g} times as far off; partly where one holds"
    ),
    unit="RMSE of the corners in m",
    run=lambda quick, data, watch: both_maps(
        wall_points(SPACING_M, NOISE, 0, QUICK_ITERATIONS if quick else None)
    ),
    judge=_judge_seven,
    draw=_plot_seven,
)
CROSSING = PaperFigure(
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
FIGURES = (SEVEN, CROSSING)
