"""Submaps: unconnected parts of a run, each with its own frame, and where these are torn.

Refinement tears a map where its steps deviate from the links between scans. The motion from one
scan to the next is known approximately where too few static landmarks are in view, as along a
single partial wall: along it from constant motion (`placement`). Such weak links only give the
initial placement of a submap, and are not used in the refinement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.landmarks import Submap
from relmap.planes.linking.placement import LEVER_M
from relmap.planes.motions import APART_M, APART_RAD, matrices, motion_over, wrapped
from relmap.planes.walls.assembly import Assembled
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.table import corner_map

FEW, ASTRAY_M = 5, 0.3
"""Maximum number of consecutive misplaced scans, and minimum distance from the others."""
LOST = 2
"""Number of consecutive scans without a pose across which a path must follow its links."""
TORN_M = 1.0
"""Disagreement of a map with a link above which the map is torn."""


def stitched(submaps: Sequence[Floats], motions: Floats) -> Floats:
    """Return the path in the frame of the first submap.

    `submaps`, sequence of (n, 4, 4): ``T_submap_robot`` of every iteration in each submap, the most
    important one first; NaN if undetermined. `motions` (n, 3): yaw, x, y of the motion from the
    previous robot frame to that of each iteration. Returns (n, 4, 4): ``T_map_robot``; if no submap
    determines any, in the frame of the first iteration.
    """
    n = len(motions)
    steps = np.linalg.inv(matrices(motions))
    poses = np.full((n, 4, 4), np.nan)
    submap = np.full(n, -1)
    for number, own in enumerate(submaps):
        free = (submap < 0) & np.isfinite(own[:, 0, 0])
        submap[free], poses[free] = number, own[free]
    if n and not (submap == 0).any():
        submap[0], poses[0] = 0, np.eye(4)
    fixed = np.flatnonzero(submap == 0)
    if not len(fixed):
        return poses
    placed: dict[int, Floats] = {}
    for i in fixed[0] + np.flatnonzero(submap[fixed[0] :]):
        poses[i] = _placed(placed, submap[i], poses[i], poses[i - 1] @ steps[i])
    for i in reversed(range(fixed[0])):
        back = poses[i + 1] @ np.linalg.inv(steps[i + 1])
        poses[i] = _placed(placed, submap[i], poses[i], back)
    return poses


def _placed(placed: dict[int, Floats], submap: int, own: Floats, expected: Floats) -> Floats:
    """Return the pose of an iteration; place its submap at the predicted pose if necessary."""
    if submap < 0:
        return expected
    if submap not in placed:
        placed[submap] = expected @ np.linalg.inv(own)
    return np.asarray(placed[submap] @ own)


def with_strays_put_back(poses: Floats, motions: Floats) -> Floats:
    """Return the poses (n, 4, 4) with the few misplaced ones corrected.

    Misplaced poses deviate from both neighbours according to the motions (n, 3) from scan to scan:
    scans with hardly any known wall, or a wrong one. They are kept if the motions across them do
    not lead to the next pose either: then the map is torn.
    """
    broken = np.concatenate([[False], _astray(poses, motions)])
    run = np.cumsum(broken)
    size = np.bincount(run)
    beside = np.concatenate([[0], size, [0]])
    stray = (size <= FEW) & (size < np.maximum(beside[:-2], beside[2:]))
    led = stitched([np.where(stray[run][:, None, None], np.nan, poses)], motions)
    ends = 1 + np.flatnonzero(_astray(led, motions))
    stray[run[ends] - 1] = False
    return np.where(stray[run][:, None, None], led, poses)


def _astray(poses: Floats, motions: Floats) -> Bools:
    """Return which poses after the first one (n - 1,) do not follow from the motions (n, 3)."""
    way_m, turn = deviations(poses, motions)
    return way_m + LEVER_M * turn > ASTRAY_M


@dataclass(frozen=True, eq=False, repr=False)
class WallSubmap(Submap):
    """A submap of walls: its corners are its landmarks.

    `poses` (k, 4, 4): ``T_submap_robot`` of its iterations; NaN for iterations in between that
    belong to others. `assembled`: None if no wall was seen often enough. `refined`: whether its
    walls and poses were refined. `torn` (t,): scans before which a rejected refinement
    deviated from the links.
    """

    poses: Floats
    assembled: Assembled | None
    refined: bool
    torn: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @classmethod
    def of(
        cls,
        span: tuple[int, int],
        poses: Floats,
        assembled: Assembled | None,
        refined: bool = False,
    ) -> WallSubmap:
        """Return the submap of the iterations of a span: the first, and the end."""
        corners = corner_map(assembled, None)
        begin, end = span
        return cls(
            corners.landmark_ids, corners.positions, begin, end - 1, poses, assembled, refined
        )

    @property
    def span(self) -> tuple[int, int]:
        """Its first iteration, and the end."""
        return self.first_iteration, self.last_iteration + 1

    @property
    def known(self) -> Ints:
        """Rows (n,) of `poses` of its scans."""
        return np.flatnonzero(np.isfinite(self.poses[:, 0, 3]))

    @property
    def n_scans(self) -> int:
        """Number of scans in it."""
        return len(self.known)

    @property
    def path(self) -> Floats:
        """Number of each of its scans, and the position of the robot (n, 3)."""
        known = self.known
        return np.column_stack([self.first_iteration + known, self.poses[known, :2, 3]])

    def length_m(self, begun: Ints | tuple[()] = ()) -> float:
        """Return the length of the path, metres, without the ways from log to log.

        `begun` (r,): first iterations of the logs after the first.
        """
        scan, position = self.path[:, 0], self.path[:, 1:]
        steps_m = np.linalg.norm(np.diff(position, axis=0), axis=1)
        return float(steps_m[~between_logs(begun, scan[:-1], scan[1:])].sum())


def between_logs(begun: Ints | tuple[()], before: NDArray[Any], after: NDArray[Any]) -> Bools:
    """Return whether pairs of scans (k,), (k,) are of two logs; see `WallSubmap.length_m`."""
    first, second = (np.searchsorted(begun, scans, side="right") for scans in (before, after))
    return np.asarray(first != second)


def among_all(poses: Floats, span: tuple[int, int], history: PlaneHistory) -> Floats:
    """Return the poses of a submap among those of all iterations (i, 4, 4), NaN elsewhere."""
    every = np.full((history.n_iterations, 4, 4), np.nan)
    every[slice(*span)] = poses
    return every


def chained_poses(paths: list[Floats], span: tuple[int, int], history: PlaneHistory) -> Floats:
    """Return the poses of a submap from the paths (i, 4, 4) of the engine's submaps.

    Stretches of few landmarks connected by odometry are checked against the links between scans.
    """
    rows, own = slice(*span), history.own(span)[:, None, None]
    there = [np.where(own, path[rows], np.nan) for path in paths]
    there = [path for path in there if np.isfinite(path[:, 0, 0]).any()]
    motions = history.motion[rows]
    poses = np.where(own, stitched(there, motions), np.nan)
    if history.odometry and disagreement(poses, motions)[0]:
        poses = np.where(own, stitched([], motions), np.nan)
    return poses


def torn_in(submaps: Sequence[WallSubmap], history: PlaneHistory) -> Ints:
    """Return the scans (t,) before which submaps deviate from the links between scans.

    Deviations in a rejected refinement count too.
    """
    torn = [np.empty(0, dtype=np.int64)]
    for submap in submaps:
        begin, end = submap.span
        way_m, turn = deviations(submap.poses, history.motion[begin:end])
        torn.append(begin + 1 + np.flatnonzero((way_m > APART_M) | (turn > APART_RAD)))
        torn.append(submap.torn)
    return np.unique(np.concatenate(torn))


def disagreement(poses: Floats, motions: Floats) -> tuple[int, float]:
    """Return the number of links at which a path is torn, and the mean error at the others.

    Compared with the motions measured from scan to scan; metres.

    `poses` (k, 4, 4); `motions` (k, 3): yaw, x, y from the previous robot frame to that of each
    iteration.
    """
    way_m, turn = deviations(poses, motions)
    off_m = way_m + LEVER_M * turn
    off_m = off_m[np.isfinite(off_m)]
    torn = off_m > TORN_M
    n_torn = int(torn.sum())
    return n_torn, float(off_m[~torn].sum() / max(len(off_m) - n_torn, 1))


def deviations(poses: Floats, motions: Floats) -> tuple[Floats, Floats]:
    """Return how far the steps of a path are off its links (k - 1,), metres and radians.

    Across a few lost scans, the motions from the scan before to the one after are composed. NaN
    where unknown; the arguments are those of `disagreement`.
    """
    motions, before = motions[1:].copy(), poses[:-1].copy()
    known = np.flatnonzero(np.isfinite(poses[:, 0, 0]))
    lost = np.diff(known) - 1
    for k in np.flatnonzero((lost > 0) & (lost <= LOST)).tolist():
        first, last = int(known[k]), int(known[k + 1]) - 1
        motions[last], before[last] = motion_over(motions[first : last + 1]), poses[first]
    relative = np.linalg.inv(poses[1:]) @ before
    turn = np.arctan2(relative[:, 1, 0], relative[:, 0, 0]) - motions[:, 0]
    way_m = np.hypot(*(relative[:, :2, 3] - motions[:, 1:]).T)
    return way_m, np.abs(wrapped(turn))
