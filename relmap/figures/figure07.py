"""Figure 7: planes hold at a noise at which points are lost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relmap.evaluation.truth import Truth
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.figures.figure_crossing import HALF, CrossingRow, map_of
from relmap.figures.surface_points import wall_points
from relmap.io.results import Result
from relmap.planes.files import PlaneResult
from relmap.plots.bench_recorder import COLUMNS, rows_of
from relmap.plots.path import broken_at_gaps, fit_to_truth
from relmap.plots.planes import WALL, draw_true_walls, draw_walls
from relmap.plots.sheet import GREY, blank, draw_limits, finish, limits_of

QUICK_ITERATIONS = 80
MUCH = 2.0
SPACING_M = 0.2
NOISE = 0.3
"""Sigma over the spacing: points are no longer distinguishable from one scan to the next."""


@dataclass(frozen=True, eq=False)
class NoisyMap:
    """A map in the frame of the truth, metres.

    Attributes
    ----------
    run : CrossingRow
    shapes : (m, 2, 2) or (m, 2) float64
        Mapped walls, or mapped points from above.
    path : (k, 2) float64
        NaN where it is not known.
    """

    run: CrossingRow
    shapes: NDArray[np.float64]
    path: NDArray[np.float64]

    @property
    def said(self) -> str:
        """How good it is, in one line."""
        run, what = self.run, "corner" if self.run.method == "planes" else "point"
        covered = f"{run.coverage:.0%} of the {what}s mapped"
        if run.map_rmse_m is None:
            return covered
        in_sigma = f" = {run.map_rmse_m / run.sigma:.2f} sigma" if run.sigma > 0 else ""
        return f"{what} RMSE {run.map_rmse_m:.3f} m{in_sigma}, {covered}"


@dataclass(frozen=True, eq=False)
class NoisyMaps:
    """The maps of planes and of points over the true walls (w, 2, 2)."""

    planes: NoisyMap
    points: NoisyMap
    true_walls: NDArray[np.float64]


def run_noisy_maps(
    spacing_m: float = SPACING_M, noise: float = NOISE, seed: int = 0, iterations: int | None = None
) -> NoisyMaps:
    """Map fixed points on the walls of a building as planes, and as points.

    Parameters
    ----------
    spacing_m : float
        Of the points on the walls, metres.
    noise : float
        Sigma in units of the spacing.
    seed : int
    iterations : int, optional
        Scans; one loop where left out.

    Returns
    -------
    NoisyMaps
    """
    seen = wall_points(spacing_m, noise, seed, iterations)
    truth = seen.walls_truth
    planes, points = (_placed(*map_of(method, seen), truth) for method in ("planes", "points"))
    return NoisyMaps(planes, points, truth.ends)


def _placed(result: Result, run: CrossingRow, truth: Truth) -> NoisyMap:
    """Bring a map into the frame of the truth."""
    if isinstance(result, PlaneResult):
        shapes = result.planes.ends[result.planes.status == "static"]
    else:
        shapes = result.landmarks.position[result.mapped, :2]
    motion = fit_to_truth(result.stamps_s, result.poses, truth)
    if motion is None:
        return NoisyMap(run, shapes, np.empty((0, 2)))
    R, t = motion
    path = broken_at_gaps(result.stamps_s, result.poses[:, :2, 3] @ R.T + t)
    return NoisyMap(run, shapes @ R.T + t, path)


def _judge(maps: NoisyMaps) -> Outcome:
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


def _plot(maps: NoisyMaps) -> Figure:
    """Draw the map of planes, and that of points, over the true walls."""
    limits = limits_of(maps.true_walls.reshape(-1, 2), np.empty((0, 2)), 1.0)
    width, height = limits[1] - limits[0]
    scale = min(6.2 / width, 7.0 / height)
    figure = blank(2 * scale * width + 1.6, scale * height + 1.9)
    planes, points = figure.subplots(1, 2, sharey=True)
    for axes, each in ((planes, maps.planes), (points, maps.points)):
        draw_true_walls(axes, maps.true_walls)
        draw_limits(axes, limits)
        if axes is planes or len(each.shapes):
            axes.plot(*each.path.T, color=GREY, linewidth=0.9, zorder=2, label="path from the map")
    draw_walls(planes, maps.planes.shapes)
    finish(planes, f"planes: {maps.planes.said}", "x [m]", "y [m]")
    _draw_points(points, maps.points.shapes)
    finish(points, f"points: {maps.points.said}", "x [m]", "")
    style: dict[str, Any] = {"fontsize": 8, "frameon": False, "bbox_to_anchor": (0.5, -0.1)}
    for axes in (planes, points):
        axes.legend(ncols=4, loc="upper center", **style)
    run = maps.planes.run
    figure.suptitle(
        f"Figure 7: noise of {run.sigma:.3g} m, {run.noise:g} of the {run.spacing_m:g} m "
        f"between the points, seed {run.seed}"
    )
    return figure


def _draw_points(axes: Axes, points: NDArray[np.float64]) -> None:
    if len(points):
        axes.plot(*points.T, ".", color=WALL, markersize=1.5, label="mapped point")
        return
    said = "no map: no point is recognised\noften enough to be placed"
    box = {"facecolor": "white", "edgecolor": "none"}
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 11, "zorder": 10}
    axes.text(0.5, 0.5, said, transform=axes.transAxes, bbox=box, **style)


def _run(quick: bool, data: Path | None, watch: Watch) -> NoisyMaps:
    return run_noisy_maps(iterations=QUICK_ITERATIONS if quick else None)


FIGURE = PaperFigure(
    name="7",
    title="planes under noise that points do not survive",
    claim=(
        "With a noise so large that no point can be told from its neighbours, the map of planes "
        "has some error, much less than with points, which could not be mapped at all."
    ),
    criterion=(
        f"planes: {HALF:.0%} of the corners seen ten times are mapped, and points: less than "
        f"{HALF:.0%} of them are, or they are {MUCH:g} times as far off; partly where one holds"
    ),
    unit="RMSE of the corners in m",
    run=_run,
    judge=_judge,
    draw=_plot,
)
