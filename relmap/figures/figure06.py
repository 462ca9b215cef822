"""Figure 6: without noise the map is exact, even past a stretch with a single partial wall.

The robot drives along one wall of which only a part is ever seen: the case of the motion model. No
corner is in view: the distance and orientation to the wall are observed, but not the motion along
it. Such links are weak, and constant speed is assumed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.geometry.motions import transforms
from relmap.datasets.scans import ScanLog
from relmap.evaluation import metrics
from relmap.evaluation.feeding import Through
from relmap.evaluation.run import run_mapper
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.planes import PlaneMapper
from relmap.plots.planes import CORNER, PATH, WALL, draw_true_walls, draw_walls
from relmap.plots.sheet import ORANGE, RED, blank, draw_limits, finish, limits_of
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import Building, simulate_building
from relmap.simulation.sensor import DEPTH_SENSOR

EXACT_M = 1e-6
QUICK_POINTS, QUICK_BESIDE = 250, 30
BESIDE = 60
"""Scans that are mapped before and after the single wall."""
MARGIN_M = 1.5
COLUMNS = ("iteration", "x", "y", "true_x", "true_y", "weak")


@dataclass(frozen=True, eq=False)
class PartialWall:
    """A map with a stretch that depends on one partial wall, in the frame of the truth, metres.

    Aligned by the poses before the longest weak stretch.

    `walls` (w, 2, 2), `corners` (c, 2): as mapped; `poses`, `true_poses` (k, 4, 4):
    ``T_truth_robot``, as mapped and true; `weak` (k,): whether the link from the previous scan
    leaves the motion along a wall undetermined; `true_walls` (w, 2, 2): all walls that were ever in
    view.
    """

    walls: Floats
    corners: Floats
    poses: Floats
    true_poses: Floats
    weak: Bools
    true_walls: Floats

    @property
    def stretch(self) -> tuple[int, int]:
        """The longest run of weak links: first, and end."""
        return longest(self.weak)

    @property
    def off(self) -> Floats:
        """Error of the path, (k, 2)."""
        return self.poses[:, :2, 3] - self.true_poses[:, :2, 3]

    @property
    def shift(self) -> Floats:
        """Error of the pose after the weak stretch: ahead and to the left, (2,)."""
        end = min(self.stretch[1], len(self.poses) - 1)
        return np.asarray(self.off[end] @ self.true_poses[end, :2, :2])

    @property
    def weak_m(self) -> float:
        """True length of the weak stretch."""
        begin, end = self.stretch
        way = self.true_poses[max(begin - 1, 0) : end, :2, 3]
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())

    @property
    def errors_m(self) -> tuple[float | None, float | None]:
        """ATE of the path before the weak stretch, and after it, aligned separately."""
        begin, end = self.stretch
        before, after = (
            metrics.ate(self.poses[part], self.true_poses[part], planar=True)
            for part in (slice(0, begin), slice(end, None))
        )
        return before, after


def run_partial_wall(
    points: int = 1000, sigma: float = 0.0, beside: int = BESIDE, through: Through = iter
) -> PartialWall:
    """Drive past a long wall that stands alone, and map it.

    `points`: points of a scan; `sigma`: standard deviation of each coordinate, metres; `beside`:
    scans before and after those with only the wall in view; `through`: wraps the iterable of scans.
    """
    building = simulate_building(points, sigma, world="long-wall", sample_ends=sigma == 0.0)
    part = _beside_the_wall(building, beside)
    scans, true_poses = [building.scans[k].points for k in part], building.trajectory[part]
    log = ScanLog(3, building.stamps_s[: len(part)], scans.__getitem__)
    # The ends of a wall alone in view do not show the limits of the sensor.
    segmenter = PlaneSegmenter(view_rad=DEPTH_SENSOR.view_rad, range_m=DEPTH_SENSOR.range_m)
    mapper = PlaneMapper()
    planes = run_mapper(mapper, log, through=through, refine=True, segmenter=segmenter).planes
    weak = np.isin(np.arange(len(part)), mapper.weak_links)
    before = slice(0, longest(weak)[0])
    T = transforms(*metrics.align_poses(mapper.trajectory[before], true_poses[before], 2))
    mapped = planes.status == "static"
    ends = planes.ends[mapped] @ T[:2, :2].T + T[:2, 3]
    corners = ends[planes.corner[mapped] >= 0]
    seen = np.unique(np.concatenate([building.scans[k].seen.wall for k in part]))
    walls = building.walls[seen, :4].reshape(-1, 2, 2)
    return PartialWall(ends, corners, T @ mapper.trajectory, true_poses, weak, walls)


def longest(held: Bools) -> tuple[int, int]:
    """Return start and end of the longest run of true values (k,); RelmapError if none is true."""
    if not held.any():
        raise RelmapError("no link is weak: no stretch depends on a single partial wall")
    edges = np.flatnonzero(np.diff(held.astype(np.int8), prepend=0, append=0))
    begin, end = edges[::2], edges[1::2]
    k = int(np.argmax(end - begin))
    return int(begin[k]), int(end[k])


def _beside_the_wall(building: Building, beside: int) -> Ints:
    """Return the scans in which only one wall is seen, without an end, and the adjacent ones."""
    alone = np.array(
        [len(scan.seen.wall) == 1 and "corner" not in scan.seen.end_type for scan in building.scans]
    )
    n = len(alone)
    begin, end = longest(np.tile(alone, 2))  # the path is closed
    return np.arange(begin - beside, min(end, begin + n) + beside) % n


def _run(quick: bool, data: Path | None, watch: Watch) -> PartialWall:
    size = {"points": QUICK_POINTS, "beside": QUICK_BESIDE} if quick else {}
    return run_partial_wall(**size, through=lambda scans: watch(list(scans)))


def _judge(run: PartialWall) -> Outcome:
    worst_m = max(np.inf if error is None else error for error in run.errors_m)
    ahead_m, left_m = np.abs(run.shift)
    farthest_m = np.linalg.norm(run.off[slice(*run.stretch)], axis=1).max()
    places = np.column_stack([run.poses[:, :2, 3], run.true_poses[:, :2, 3]]).tolist()
    links = enumerate(zip(places, run.weak.tolist(), strict=True))
    return Outcome(
        Table(COLUMNS, [(k, *place, int(weak)) for k, (place, weak) in links]),
        float(ahead_m),
        f"Before and after the single wall the path is {worst_m:.0e} m off. Along it, for "
        f"{run.weak_m:.1f} m, no observation shows how far the robot goes; the motion model "
        f"bridges this; at its end it is {ahead_m:.3f} m off along the wall, {left_m:.4f} m "
        f"across, and on the way at most {farthest_m:.3f} m off.",
        judged(worst_m < EXACT_M, max(ahead_m, left_m) < EXACT_M),
    )


def _plot(run: PartialWall) -> Figure:
    """Draw the map over the truth, weak links marked, and the error of the path."""
    figure = blank(11.0, 8.0)
    above, below = figure.subplots(2, 1, height_ratios=[2.6, 1.0])
    _draw_map(above, run)
    _draw_errors(below, run)
    ahead, left, before, after = map(_length, (*np.abs(run.shift), *run.errors_m))
    figure.suptitle(
        f"Figure 6: {run.weak_m:.1f} m along one partial wall, bridged by the motion model: "
        f"{ahead} off along it, {left} across\n"
        f"path before it {before} off, path after it {after}, each aligned alone",
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
    path = run.poses[:, :2, 3]
    weak = np.where(run.weak[:, None], path, np.nan)
    draw_true_walls(axes, run.true_walls)
    draw_walls(axes, run.walls)
    axes.plot(*run.corners.T, "o", color=CORNER, markersize=3.5, label="mapped corner")
    axes.plot(*path.T, color=PATH, linewidth=1.2, label="path of the robot, from the map")
    label = "weak: position along the wall not fixed"
    axes.plot(*weak.T, color=ORANGE, linewidth=4.0, alpha=0.8, label=label)
    axes.plot(*path[0], "o", color=PATH, markersize=6, linestyle="", label="start")
    draw_limits(axes, limits_of(run.walls.reshape(-1, 2), path, MARGIN_M))
    finish(axes, f"{len(run.walls)} walls mapped, {len(run.corners)} corners", "x [m]", "y [m]")
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
        "Without noise the map has no error, although walls are only partly visible and at one "
        "place only a single partial wall is in view."
    ),
    criterion=(
        f"errors below {EXACT_M:g} m, before and after the single wall, and from one side of it "
        "to the other; partly where one of the two holds"
    ),
    unit="m off along the single partial wall",
    run=_run,
    judge=_judge,
    draw=_plot,
)
