"""The map from groups: walls, association and moving landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.map.pose import trajectory
from relmap.core.mapper import RelativeMapper
from relmap.planes.linking.registration import PlaneRegistration
from relmap.planes.submaps.submap import WallSubmap, among_all, chained_poses
from relmap.planes.walls.assembly import WallNumbers, assemble
from relmap.planes.walls.history import PlaneHistory, first_of


@dataclass(frozen=True, eq=False)
class KeptFrame:
    """The frame of the map to which another log is added.

    `scan`: its first scan; `pose` (4, 4): ``T_map_robot`` of that scan; `begun_at`: first iteration
    of the log.
    """

    scan: int
    pose: Floats
    begun_at: int

    @classmethod
    def of(cls, submaps: Sequence[WallSubmap], begun_at: int) -> KeptFrame | None:
        """Return the frame of the first submap; None without submaps."""
        if not submaps:
            return None
        row = int(submaps[0].known[0])
        return cls(submaps[0].first_iteration + row, submaps[0].poses[row], begun_at)

    def moved(self, poses: Floats, span: tuple[int, int]) -> Floats:
        """Return the poses (k, 4, 4) of a span in this frame, if the scan is one of them."""
        row = self.scan - span[0]
        if not 0 <= row < len(poses) or not np.isfinite(poses[row, 0, 3]):
            return poses
        return np.asarray(self.pose @ np.linalg.inv(poses[row]) @ poses)


@dataclass(frozen=True, eq=False)
class GroupedMap:
    """Results of the engine for corners, converted to walls.

    `known`, sequence of (i, 4, 4): poses in joined submaps, in one frame each, that take
    precedence; NaN for other scans. `frame`: that of the submap with its scan, if any.
    """

    engine: RelativeMapper
    walls: PlaneRegistration
    history: PlaneHistory
    known: Sequence[Floats] = ()
    frame: KeptFrame | None = None

    @property
    def numbers(self) -> WallNumbers:
        """The association: walls whose corners the engine merged are one wall."""
        wall_end = self.walls.wall_end
        corner_of, merged = np.arange(len(wall_end)), self.engine.table.landmark_of[::2] // 2
        corner_of[: len(merged)] = merged
        same = np.column_stack([wall_end, wall_end[corner_of]]) // 2
        return WallNumbers(first_of(self.walls.n_planes, same), corner_of)

    @property
    def unmerged(self) -> WallNumbers:
        """The association before any merge, except for joined submaps."""
        wall_of = first_of(self.walls.n_planes, self.walls.links.same_walls)
        return WallNumbers(wall_of, np.arange(len(self.walls.wall_end)))

    def at_rest(self, numbers: WallNumbers) -> WallNumbers:
        """Return the association without corners that were seen moving (-1)."""
        corner_of = numbers.corner_of.copy()
        corner_of[self.moving_corners] = -1
        return WallNumbers(numbers.wall_of, corner_of)

    @property
    def moving_corners(self) -> Ints:
        """Corners (k,) that were seen moving."""
        return np.flatnonzero(self.engine.table.dynamic[::2])

    @property
    def moving_walls(self) -> Bools:
        """Whether plane tracks were seen moving: all their known corners move; (p,)."""
        table, n = self.engine.table, self.walls.n_planes
        dynamic = table.dynamic[::2] | table.dynamic[1::2]
        at_rest = (table.weight[::2] > 0) & ~dynamic
        planes = self.walls.wall_end[: len(dynamic)] // 2
        moves = np.bincount(planes[dynamic], minlength=n) > 0
        return np.asarray(moves & (np.bincount(planes[at_rest], minlength=n) == 0))

    def submaps(self, numbers: WallNumbers, moving: Bools) -> list[WallSubmap]:
        """Return the submaps without moving plane tracks (p,), those with most scans first.

        Scan-to-scan motions bridge between groups; a submap without any group maps nothing.
        """
        history, paths, found = self.history, self._paths, list[WallSubmap]()
        for span in history.spans:
            poses, assembled = chained_poses(paths, span, history), None
            poses = self.frame.moved(poses, span) if self.frame else poses
            if any(np.isfinite(path[slice(*span), 0, 0]).any() for path in paths):
                assembled = assemble(history, numbers, among_all(poses, span, history), moving)
            found.append(WallSubmap.of(span, poses, assembled))
        return found

    @cached_property
    def _paths(self) -> list[Floats]:
        """The poses (i, 4, 4) that are known, and from each of the engine's submaps."""
        table, rows = self.engine.table, self.engine.rows
        paths = list(self.known)
        for submap in table.submaps:
            positions = np.where((table.submap == submap)[:, None], table.position, np.nan)
            paths.append(trajectory(rows, positions, table.landmark_of))
        return paths
