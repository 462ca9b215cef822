"""Submaps in one frame: their walls and beams, and how other beams fit the walls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes.linking.links import JUMP, JUMP_M
from relmap.planes.places.wall_tie import WallTie, coinciding
from relmap.planes.plan.evidence import BIN_M, Stretches, grid_over
from relmap.planes.scans.beam_store import PlacedBeams

NEAR_M = 0.25
"""Largest distance of a beam's end from the wall it hits: submaps are bent a little. One that ends
farther in front of a wall does not count: something else may stand there."""
OFTEN = 3
"""Beams that support or contradict a stretch of wall."""
BESIDE_M = 1.0
"""Length by which walls go on at a door: closed doors are often not mapped."""
OPEN_M, CLEARLY, UNSEEN = 0.5, 4, 2
"""Smallest width of an opening; how many times as many beams must pass through as end there, and
end there as pass through in the map in which it is closed; and largest number of stretches in a row
without such beams within it. Of 118 right alignments of submaps two have one."""


@dataclass(frozen=True, eq=False)
class MapPart:
    """Submaps in one frame.

    `members`, tuple of (int, (4, 4)): each submap, and the motion (4, 4) from its frame to this
    one; `ends` (w, 2, 2), metres: right and left end of each wall, as seen from its front;
    `begins`, `stops` (n, 2), metres: of each beam; `walls` (w,): number of each wall; `same`
    (k, 2): pairs of numbers of the same wall in two members; `path` (s, 3): number of each scan,
    and the position of the robot, metres.
    """

    members: tuple[tuple[int, Floats], ...]
    ends: Floats
    begins: Floats
    stops: Floats
    walls: Ints
    same: Ints
    path: Floats

    @classmethod
    def of(
        cls, number: int, ends: Floats, walls: Ints, beams: PlacedBeams, path: Floats
    ) -> MapPart:
        """Return one submap, given its number, its walls, its beams and its path."""
        motion, none = np.eye(4), np.empty((0, 2), dtype=np.int64)
        return cls(((number, motion),), ends, beams.begins, beams.ends, walls, none, path)

    def with_that(self, other: MapPart, tie: WallTie) -> MapPart:
        """Return this and another part, moved to this frame."""
        ends, begins, stops = (
            each @ tie.R.T + tie.t for each in (other.ends, other.begins, other.stops)
        )
        rows = coinciding(other.ends, self.ends, tie)
        same = np.column_stack([other.walls[rows[:, 0]], self.walls[rows[:, 1]]])
        return MapPart(
            self.members + tuple((number, tie.matrix @ motion) for number, motion in other.members),
            np.concatenate([self.ends, ends]),
            np.concatenate([self.begins, begins]),
            np.concatenate([self.stops, stops]),
            np.concatenate([self.walls, other.walls]),
            np.concatenate([self.same, other.same, same]),
            self._both_paths(other, tie),
        )

    def _both_paths(self, other: MapPart, tie: WallTie) -> Floats:
        """Return the path, and that of another part after a motion."""
        moved = other.path[:, 1:] @ tie.R.T + tie.t
        return np.concatenate([self.path, np.column_stack([other.path[:, :1], moved])])

    def jumps_to(self, other: MapPart, tie: WallTie) -> bool:
        """Return whether an alignment implies a jump between a scan and the next one."""
        path = self._both_paths(other, tie)
        order = np.argsort(path[:, 0], kind="stable")
        steps = np.abs(np.diff(path[order], axis=0))
        between = np.diff(order >= len(self.path))
        way_m, scans = np.hypot(*steps[:, 1:].T), np.maximum(steps[:, 0], 1.0)
        usual_m = float(np.median(way_m[~between])) if not between.all() else 0.0
        return bool((way_m > JUMP_M + JUMP * usual_m * scans)[between].any())

    @cached_property
    def crossing_m(self) -> float:
        """Length of the walls across the others, metres: 0 if all are parallel."""
        along = self.ends[:, 1] - self.ends[:, 0]
        outer = np.einsum("wi,wj->ij", along, along / np.maximum(np.hypot(*along.T), 1e-9)[:, None])
        return float(np.linalg.eigvalsh(outer)[0])

    @cached_property
    def stretches(self) -> Stretches:
        """The walls, in stretches, without any observation."""
        along = self.ends[:, 1] - self.ends[:, 0]
        length = np.maximum(np.hypot(*along.T), 1e-9)
        along = along / length[:, None]
        first = np.concatenate([[0], np.cumsum(np.maximum(np.ceil(length / BIN_M), 1))])
        first = first.astype(np.int64)
        none = np.zeros(first[-1], dtype=np.int64)
        normal = np.column_stack([-along[:, 1], along[:, 0]])
        low = np.zeros(len(length))
        return Stretches(self.ends[:, 0], normal, along, low, first, none, none, none)

    @cached_property
    def grid(self) -> tuple[Floats, Ints, Ints, Ints, float]:
        """A grid over the walls."""
        return grid_over(self.stretches)

    @cached_property
    def longer(self) -> MapPart:
        """The same part, with walls that are longer at both ends."""
        along = self.ends[:, 1] - self.ends[:, 0]
        out = BESIDE_M * along / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
        return replace(self, ends=self.ends + np.stack([-out, out], axis=1))

    def crossed(self, begins: Floats, stops: Floats) -> tuple[Ints, Ints]:
        """Return how many beams (n, 2) end on each stretch of the walls, and pass through it."""
        from relmap.planes.plan.plan_kernels import beams_on_walls

        walls = self.stretches
        lines = walls.base, walls.normal, walls.low, walls.first
        hits, against, _ = beams_on_walls((begins, stops), lines, self.grid, NEAR_M, 0.0)
        return hits, against

    def openings(self, begins: Floats, stops: Floats) -> int:
        """Return the number of openings through which beams (n, 2) pass where its own end."""
        ending, passing = self.crossed(self.begins, self.stops)
        hits, against = self.crossed(begins, stops)
        closed = (ending > 1) & (ending > CLEARLY * passing)
        through = np.flatnonzero(closed & (against > hits))
        begin = np.diff(through, prepend=-UNSEEN) > UNSEEN + 1
        run = np.cumsum(begin | (np.diff(self.stretches.wall[through], prepend=-1) != 0))
        hits, against = (np.bincount(run, each[through]) for each in (hits, against))
        wide = np.bincount(run) >= OPEN_M / BIN_M
        return int((wide & (against > CLEARLY * hits)).sum())

    def judged(self, begins: Floats, stops: Floats) -> tuple[float, float]:
        """Return the length of wall that beams (n, 2) support, and contradict; metres."""
        hits, against = self.crossed(begins, stops)
        support = (hits > against) & (hits >= OFTEN)
        contradict = (against > hits) & (against >= OFTEN)
        return BIN_M * float(support.sum()), BIN_M * float(contradict.sum())

    def beams_from(self, ends: Floats) -> tuple[Floats, Floats]:
        """Return start and end points of the beams from within the extent of walls (w, 2, 2)."""
        low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
        there = ((self.begins >= low) & (self.begins <= high)).all(axis=1)
        return self.begins[there], self.stops[there]
