"""Figure 6: without noise the map is exact, past a stretch with a single partial wall too.

The robot drives along one wall of which only a part is ever seen: the motion model's case.  No
corner is in view then: how far the robot is from the wall, and how it is turned to it, is seen, but
not how far it goes along.  Such links are weak, and the speed is carried on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.scans import stored_scans
from relmap.evaluation import metrics
from relmap.evaluation.feeding import Progress
from relmap.evaluation.run import run_mapper
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.planes import PlaneMapper
from relmap.planes.table import PlaneTable
from relmap.plots.path import fit_poses
from relmap.plots.planes import CORNER, PATH, WALL, draw_true_walls, draw_walls
from relmap.plots.sheet import ORANGE, RED, blank, draw_limits, finish, limits_of
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import Building, simulate_building
from relmap.simulation.sensor import DEPTH_SENSOR

EXACT_M = 1e-6
QUICK_POINTS, QUICK_BESIDE = 250, 30
BESIDE = 60
"""So many scans more are mapped on either side."""
MARGIN_M = 1.5


@dataclass(frozen=True, eq=False)
class PartialWall:
    """A map with a stretch that hangs on one partial wall.

    Attributes
    ----------
    planes : PlaneTable
    poses : (k, 4, 4) float64
        ``T_map_robot``.
    true_poses : (k, 4, 4) float64
        ``T_truth_robot``.
    weak : (k,) bool
        Whether the link from the scan before to each leaves the way along a wall open.
    true_walls : (w, 2, 2) float64, frame of the truth, metres
        All that were ever in view.
    R, t : (2, 2), (2,) float64
        From the map to the truth, as the poses before the longest weak stretch have it.
    """

    COLUMNS: ClassVar = ("iteration", "x", "y", "true_x", "true_y", "weak")

    planes: PlaneTable
    poses: NDArray[np.float64]
    true_poses: NDArray[np.float64]
    weak: NDArray[np.bool_]
    true_walls: NDArray[np.float64]
    R: NDArray[np.float64]
    t: NDArray[np.float64]

    def in_truth(self, points_map: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bring points (..., 2) of the map into the frame of the truth."""
        return np.asarray(points_map @ self.R.T + self.t)

    @property
    def stretch(self) -> tuple[int, int]:
        """The longest run of weak links: first, and one after the last."""
        return longest(self.weak)

    @property
    def path(self) -> NDArray[np.float64]:
        """Where the robot was, in the frame of the truth, (k, 2) metres."""
        return self.in_truth(self.poses[:, :2, 3])

    @property
    def off(self) -> NDArray[np.float64]:
        """How far the path is off, (k, 2) metres."""
        return np.asarray(self.path - self.true_poses[:, :2, 3])

    @property
    def shift(self) -> NDArray[np.float64]:
        """How far the pose after the weak stretch is off: ahead and to the left, (2,) metres."""
        end = min(self.stretch[1], len(self.poses) - 1)
        return np.asarray(self.off[end] @ self.true_poses[end, :2, :2])

    @property
    def weak_m(self) -> float:
        """True length of the weak stretch, metres."""
        begin, end = self.stretch
        way = self.true_poses[max(begin - 1, 0) : end, :2, 3]
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())

    @property
    def errors_m(self) -> tuple[float | None, float | None]:
        """ATE of the path before the weak stretch, and of that after it, each aligned alone."""
        begin, end = self.stretch
        before, after = (
            metrics.ate(self.poses[part], self.true_poses[part], planar=True)
            for part in (slice(0, begin), slice(end, None))
        )
        return before, after

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield a line for each scan, as `COLUMNS` name them; metres, frame of the truth."""
        places = np.column_stack([self.path, self.true_poses[:, :2, 3]]).tolist()
        for k, weak in enumerate(self.weak.tolist()):
            yield k, *places[k], int(weak)


def run_partial_wall(
    points: int = 1000,
    sigma: float = 0.0,
    seed: int = 0,
    beside: int = BESIDE,
    progress: Progress | None = None,
) -> PartialWall:
    """Drive past a long wall that stands alone, and map it.

    Parameters
    ----------
    points : int
        Points of a scan.
    sigma : float
        Standard deviation of each coordinate, metres.
    seed : int
    beside : int
        Scans before and after those in which the wall stands alone in view.
    progress : callable, optional
        Wraps the iterable of scans.
    """
    building = simulate_building(
        points, sigma, seed=seed, world="long-wall", sample_ends=sigma == 0.0
    )
    part = _beside_the_wall(building, beside)
    scans = [building.scans[k].points for k in part]
    offsets = np.concatenate([[0], np.cumsum([len(scan) for scan in scans])]).astype(np.int64)
    true_poses = building.trajectory[part]
    log = stored_scans(np.concatenate(scans), offsets, building.stamps_s[: len(part)])
    # The ends of a wall that stands alone in view tell nothing of the limits of the sensor.
    segmenter = PlaneSegmenter(view_rad=DEPTH_SENSOR.view_rad, range_m=DEPTH_SENSOR.range_m)
    mapper = PlaneMapper()
    run = run_mapper(mapper, log, progress=progress, refine=True, segmenter=segmenter)
    weak = np.isin(np.arange(len(part)), mapper.weak_links)
    before = slice(0, longest(weak)[0])
    R, t = fit_poses(mapper.trajectory[before], true_poses[before])
    seen = np.unique(np.concatenate([building.scans[k].seen.wall for k in part]))
    walls = building.walls[seen, :4].reshape(-1, 2, 2)
    return PartialWall(run.planes, mapper.trajectory, true_poses, weak, walls, R, t)


def longest(held: NDArray[np.bool_]) -> tuple[int, int]:
    """Return where the longest run of true begins, and one after its end.

    Raises
    ------
    RelmapError
        Where nothing is true.
    """
    if not held.any():
        raise RelmapError("no link is weak: no stretch hangs on a single partial wall")
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(np.int8), [0]])))
    begin, end = edges[::2], edges[1::2]
    k = int(np.argmax(end - begin))
    return int(begin[k]), int(end[k])


def _beside_the_wall(building: Building, beside: int) -> NDArray[np.int64]:
    """Return the scans in which one wall alone is seen, without an end, and those beside them."""
    alone = np.array(
        [len(scan.seen.wall) == 1 and "corner" not in scan.seen.end_type for scan in building.scans]
    )
    n = len(alone)
    twice = np.concatenate([alone, alone])  # the way is closed
    begin, end = longest(twice)
    return np.arange(begin - beside, min(end, begin + n) + beside) % n


def _run(quick: bool, data: Path | None, watch: Watch) -> Outcome:
    """Drive past the wall and map it."""
    size = {"points": QUICK_POINTS, "beside": QUICK_BESIDE} if quick else {}
    return outcome(run_partial_wall(**size, progress=lambda scans: watch(list(scans))))


def outcome(run: PartialWall) -> Outcome:
    """Judge a run."""
    worst_m = max(np.inf if error is None else error for error in run.errors_m)
    ahead_m, left_m = np.abs(run.shift)
    farthest_m = np.linalg.norm(run.off[slice(*run.stretch)], axis=1).max()
    return Outcome(
        lambda: plot_partial_wall(run),
        Table(run.COLUMNS, list(run.rows())),
        float(ahead_m),
        "m off along the single partial wall",
        f"Before and after the single wall the path is {worst_m:.0e} m off. Along it, for "
        f"{run.weak_m:.1f} m, nothing that is seen tells how far the robot goes; the motion model "
        f"bridges this; at its end it is {ahead_m:.3f} m off along the wall, {left_m:.4f} m "
        f"across, and on the way at most {farthest_m:.3f} m off.",
        judged(worst_m < EXACT_M, max(ahead_m, left_m) < EXACT_M),
    )


def plot_partial_wall(run: PartialWall) -> Figure:
    """Draw the map over the truth, weak links marked, and how far the path is off."""
    figure = blank(11.0, 8.0)
    above, below = figure.subplots(2, 1, height_ratios=[2.6, 1.0])
    _draw_map(above, run)
    _draw_errors(below, run)
    before_m, after_m = run.errors_m
    ahead_m, left_m = run.shift
    figure.suptitle(
        f"Figure 6: {run.weak_m:.1f} m along one partial wall, bridged by the motion model: "
        f"{_length(abs(ahead_m))} off along it, {_length(abs(left_m))} across\n"
        f"path before it {_length(before_m)} off, path after it {_length(after_m)}, "
        "each aligned alone",
        fontsize=11,
    )
    return figure


def _length(metres: float | None) -> str:
    if metres is None:
        return "unknown"
    if metres < 1e-6:
        return f"{metres:.0e} m"
    return f"{1000 * metres:.1f} mm" if metres < 0.1 else f"{metres:.2f} m"


def _draw_map(axes: Axes, run: PartialWall) -> None:
    mapped = run.planes.status == "static"
    ends, path = run.in_truth(run.planes.ends[mapped]), run.path
    corners = ends[run.planes.corner[mapped] >= 0]
    weak = np.where(run.weak[:, None], path, np.nan)
    draw_true_walls(axes, run.true_walls)
    draw_walls(axes, ends)
    axes.plot(*corners.T, "o", color=CORNER, markersize=3.5, linestyle="", label="mapped corner")
    axes.plot(*path.T, color=PATH, linewidth=1.2, label="path of the robot, from the map")
    axes.plot(*weak.T, color=ORANGE, linewidth=4.0, alpha=0.8, label="weak: nothing fixes it along")
    axes.plot(*path[0], "o", color=PATH, markersize=6, linestyle="", label="start")
    draw_limits(axes, limits_of(ends.reshape(-1, 2), path, MARGIN_M))
    finish(axes, f"{mapped.sum()} walls mapped, {len(corners)} corners", "x [m]", "y [m]")
    axes.legend(fontsize=8, ncols=2, loc="lower center")


def _draw_errors(axes: Axes, run: PartialWall) -> None:
    begin, end = run.stretch
    along, across = 1000 * (run.off @ run.true_poses[(begin + end) // 2, :2, :2]).T
    axes.axvspan(begin - 0.5, end - 0.5, color=ORANGE, alpha=0.25, linewidth=0, label="weak links")
    axes.plot(along, color=RED, label="along the wall")
    axes.plot(across, color=WALL, label="across it")
    finish(axes, "error of the path, aligned before the wall", "iteration", "error [mm]")
    axes.set_xlim(0, len(along) - 1)
    axes.legend(fontsize=8, loc="best")


FIGURE = PaperFigure(
    name="6",
    title="without noise: partial planes, and only one of them",
    claim=(
        "Without noise the map comes out without error, though walls are seen in part and at one "
        "place a single partial wall is all that is in view."
    ),
    criterion=(
        f"errors below {EXACT_M:g} m, before and after the single wall, and from the one side of "
        "it to the other; partly where one of the two holds"
    ),
    run=_run,
)
