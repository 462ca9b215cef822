"""Figure 7: planes hold at a noise at which points are lost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relmap.evaluation import metrics
from relmap.evaluation.truth import Truth
from relmap.figures.base import Outcome, PaperFigure, Table, judged
from relmap.figures.crossing import HALF, map_of, wall_points
from relmap.io.results import Result
from relmap.planes.files import PlaneResult
from relmap.plots.bench_recorder import COLUMNS, rows_of
from relmap.plots.path import broken_at_gaps, fit_poses
from relmap.plots.planes import WALL, draw_true_walls, draw_walls
from relmap.plots.sheet import GREY, blank, draw_limits, finish, limits_of

QUICK_ITERATIONS = 80
MUCH = 2.0
NOISE = 0.3
"""Sigma over the spacing: points are no longer distinguishable from one scan to the next."""


@dataclass(frozen=True, eq=False)
class NoisyMaps:
    """Two maps in the frame of the truth, metres.

    Attributes
    ----------
    spacing_m, noise, sigma : float
        Noise is sigma in units of the spacing.
    seed : int
    true_walls : (w, 2, 2) float64
    walls : (m, 2, 2) float64
    planes_path, points_path : (k, 2) float64
        NaN where they are not known.
    points : (p, 2) float64
        As far as they are mapped; from above.
    planes_rmse_m, points_rmse_m : float or None
        Of corners and of points.
    planes_coverage, points_coverage : float
        Share of corners and points seen ten times that stand in the map.
    """

    COLUMNS: ClassVar = COLUMNS

    spacing_m: float
    noise: float
    sigma: float
    seed: int
    true_walls: NDArray[np.float64]
    walls: NDArray[np.float64]
    planes_path: NDArray[np.float64]
    points_path: NDArray[np.float64]
    points: NDArray[np.float64]
    planes_rmse_m: float | None
    points_rmse_m: float | None
    planes_coverage: float
    points_coverage: float

    @property
    def said_of_planes(self) -> str:
        """What there is to say of the map of planes, in one line."""
        return self._said(self.planes_rmse_m, self.planes_coverage, "corner")

    @property
    def said_of_points(self) -> str:
        """What there is to say of the map of points, in one line."""
        return self._said(self.points_rmse_m, self.points_coverage, "point")

    def _said(self, rmse_m: float | None, coverage: float, what: str) -> str:
        if rmse_m is None:
            return f"{coverage:.0%} of the {what}s mapped"
        in_sigma = f" = {rmse_m / self.sigma:.2f} sigma" if self.sigma > 0 else ""
        return f"{what} RMSE {rmse_m:.3f} m{in_sigma}, {coverage:.0%} of the {what}s mapped"

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield a line for each wall, point and pose, as `COLUMNS` name them; metres."""
        shapes = {"true wall": self.true_walls, "mapped wall": self.walls}
        shapes |= {"mapped point": self.points}
        shapes |= {"pose, planes": self.planes_path, "pose, points": self.points_path}
        return rows_of(shapes)


def run_noisy_maps(
    spacing_m: float = 0.2, noise: float = NOISE, seed: int = 0, iterations: int | None = None
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
    """
    seen = wall_points(spacing_m, noise, seed, iterations)
    truth = seen.walls_truth
    result, planes = map_of("planes", seen, noise, seed)
    of_points, points = map_of("points", seen, noise, seed)
    assert isinstance(result, PlaneResult)
    walls = result.planes
    R, t, path = _placed(result, truth)
    R_points, t_points, points_path = _placed(of_points, truth)
    positions = of_points.landmarks.position[of_points.mapped, :2]
    return NoisyMaps(
        spacing_m,
        noise,
        seen.sigma,
        seed,
        truth.ends,
        walls.ends[walls.status == "static"] @ R.T + t,
        path,
        points_path,
        positions @ R_points.T + t_points,
        planes.map_rmse_m,
        points.map_rmse_m,
        planes.coverage,
        points.coverage,
    )


def _placed(
    result: Result, truth: Truth
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the planar motion of a map into the frame of the truth, and its path there."""
    mine, other = metrics.match_stamps(result.stamps_s, truth.stamps_s)
    if not len(mine):
        return np.eye(2), np.zeros(2), np.empty((0, 2))
    R, t = fit_poses(result.poses[mine], truth.poses[other])
    return R, t, broken_at_gaps(result.stamps_s, result.poses[:, :2, 3] @ R.T + t)


def outcome(maps: NoisyMaps) -> Outcome:
    """Judge two maps."""
    planes_m, points_m = maps.planes_rmse_m, maps.points_rmse_m
    hold = planes_m is not None and maps.planes_coverage >= HALF
    lost = points_m is None or maps.points_coverage < HALF
    worse = lost or (planes_m is not None and points_m is not None and points_m > MUCH * planes_m)
    return Outcome(
        lambda: plot_noisy_maps(maps),
        Table(maps.COLUMNS, list(maps.rows())),
        float("nan") if planes_m is None else planes_m,
        "RMSE of the corners in m",
        f"Noise {maps.sigma:.3g} m, {maps.noise:g} of the spacing of the points. "
        f"Planes: {maps.said_of_planes}. Points, without ids: {maps.said_of_points}.",
        judged(hold, worse),
    )


def plot_noisy_maps(maps: NoisyMaps) -> Figure:
    """Draw the map of planes, and that of points, over the true walls."""
    limits = limits_of(maps.true_walls.reshape(-1, 2), np.empty((0, 2)), 1.0)
    width, height = limits[1] - limits[0]
    scale = min(6.2 / width, 7.0 / height)
    figure = blank(2 * scale * width + 1.6, scale * height + 1.9)
    planes, points = figure.subplots(1, 2, sharey=True)
    for axes, path in ((planes, maps.planes_path), (points, maps.points_path)):
        draw_true_walls(axes, maps.true_walls)
        draw_limits(axes, limits)
        if axes is planes or len(maps.points):
            axes.plot(*path.T, color=GREY, linewidth=0.9, zorder=2, label="path from the map")
    draw_walls(planes, maps.walls)
    finish(planes, f"planes: {maps.said_of_planes}", "x [m]", "y [m]")
    _draw_points(points, maps)
    finish(points, f"points: {maps.said_of_points}", "x [m]", "")
    style: dict[str, Any] = {"fontsize": 8, "frameon": False, "bbox_to_anchor": (0.5, -0.1)}
    for axes in (planes, points):
        axes.legend(ncols=4, loc="upper center", **style)
    figure.suptitle(
        f"Figure 7: noise of {maps.sigma:.3g} m, {maps.noise:g} of the {maps.spacing_m:g} m "
        f"between the points, seed {maps.seed}"
    )
    return figure


def _draw_points(axes: Axes, maps: NoisyMaps) -> None:
    if len(maps.points):
        axes.plot(*maps.points.T, ".", color=WALL, markersize=1.5, label="mapped point")
        return
    said = "no map: no point is recognised\noften enough to be placed"
    box = {"facecolor": "white", "edgecolor": "none"}
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 11, "zorder": 10}
    axes.text(0.5, 0.5, said, transform=axes.transAxes, bbox=box, **style)


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
    run=lambda quick, data, watch: outcome(
        run_noisy_maps(iterations=QUICK_ITERATIONS if quick else None)
    ),
)
