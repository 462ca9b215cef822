"""Figure 7: planes can be mapped under noise under which points cannot."""

from __future__ import annotations

from matplotlib.figure import Figure

from relmap.evaluation.surface_points import HALF, wall_points
from relmap.figures.base import Outcome, PaperFigure, Table, judged
from relmap.plots.bench_recorder import COLUMNS, rows_of
from relmap.plots.variants import BothMaps, both_maps, plot_both

QUICK_ITERATIONS = 80
MUCH = 2.0
SPACING_M = 0.2
NOISE = 0.3
"""Sigma over the spacing: points are no longer distinguishable from one scan to the next."""


def _judge(maps: BothMaps) -> Outcome:
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


def _plot(maps: BothMaps) -> Figure:
    run = maps.planes.run
    return plot_both(
        maps,
        f"Figure 7: noise of {run.sigma:.3g} m, {run.noise:g} of the {run.spacing_m:g} m "
        f"between the points, seed {run.seed}",
    )


FIGURE = PaperFigure(
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
    judge=_judge,
    draw=_plot,
)
