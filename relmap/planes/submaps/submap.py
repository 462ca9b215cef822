"""Submaps: unconnected parts of a run, each with its own frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import Submap
from relmap.planes.submaps.stitching import stitched
from relmap.planes.submaps.tearing import disagreement, torn_links
from relmap.planes.walls.assembly import Assembled
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.table import corner_map


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
    def n_scans(self) -> int:
        """Number of scans in it."""
        return int(np.isfinite(self.poses[:, 0, 3]).sum())

    @property
    def path(self) -> Floats:
        """Number of each of its scans, and the position of the robot (n, 3)."""
        known = np.flatnonzero(np.isfinite(self.poses[:, 0, 3]))
        return np.column_stack([self.first_iteration + known, self.poses[known, :2, 3]])

    @property
    def length_m(self) -> float:
        """Length of the path, metres."""
        return float(np.linalg.norm(np.diff(self.path[:, 1:], axis=0), axis=1).sum())


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
        torn.append(begin + torn_links(submap.poses, history.motion[begin:end]))
        torn.append(submap.torn)
    return np.unique(np.concatenate(torn))
