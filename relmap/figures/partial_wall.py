"""A run along one wall of which only a part is ever seen: the motion model's case (Fig. 6).

No corner is in view then: how far the robot is from the wall, and how it is turned to it, is seen,
but not how far it goes along.  Such links are weak, and the speed is carried on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.scans import stored_scans
from relmap.evaluation import metrics
from relmap.evaluation.run import Progress, run_mapper
from relmap.figures.pose_fit import fit_poses
from relmap.planes import PlaneMapper
from relmap.planes.table import PlaneTable
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import Building, simulate_building
from relmap.simulation.sensor import DEPTH_SENSOR

BESIDE = 60
"""So many scans more are mapped on either side."""


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
    def shift(self) -> NDArray[np.float64]:
        """How far the pose after the weak stretch is off: ahead and to the left, (2,) metres."""
        end = min(self.stretch[1], len(self.poses) - 1)
        off = self.in_truth(self.poses[end, :2, 3]) - self.true_poses[end, :2, 3]
        return np.asarray(off @ self.true_poses[end, :2, :2])

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
        before, after = slice(0, begin), slice(end, None)
        return (
            metrics.ate(self.poses[before], self.true_poses[before], planar=True),
            metrics.ate(self.poses[after], self.true_poses[after], planar=True),
        )

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield a line for each scan, as `COLUMNS` name them; metres, frame of the truth."""
        path = self.in_truth(self.poses[:, :2, 3])
        for k, weak in enumerate(self.weak.tolist()):
            yield k, *path[k].tolist(), *self.true_poses[k, :2, 3].tolist(), int(weak)


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
