"""Submaps that show the same place: aligned by their walls, verified by their beams.

Each pair of submaps is aligned by overlapping walls (`wall_tie`). An alignment is scored by the
beams of all scans of both: those that end on the walls of the other support it, those that pass
through them contradict it. The best pair is joined to one map, and the search repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import rotations
from relmap.planes.linking.links import JUMP, JUMP_M
from relmap.planes.places.wall_tie import (
    ALIKE_M,
    LEAST_M,
    WallTie,
    coinciding,
    coinciding_ends,
    wall_ties,
)
from relmap.planes.plan.evidence import BIN_M, Stretches, grid_over
from relmap.planes.scans.beams import PlacedBeams

NEAR_M = 0.25
"""Largest distance of a beam's end from the wall it hits: submaps are bent a little. One that ends
farther in front of a wall does not count: something else may stand there."""
ALIGNMENTS = 12
"""Number of alignments of a pair that are scored, those with the longest overlap first."""
OFTEN = 3
"""Beams that support or contradict a stretch of wall."""
AGAINST = 5.0
"""Weight of contradicted length."""
SUPPORTED_M, CONTRADICTED = 5.0, 0.06
"""Minimum supported length, less the contradicted one, and largest fraction that is contradicted.
Of 436 alignments of submaps, of eight logs and between buildings, right ones had at most 0.06,
wrong ones 0.10 or more."""
CROSSING_M = 3.0
"""Minimum length of overlapping wall that prevents sliding along the rest."""
WALLS, CHANCE, SIGMAS = 6, 0.3, 3.5
"""Minimum number of walls that coincide; share of places per wall where ends coincide by chance, as
along two corridors with doors, and by how many standard deviations of a binomial distribution there
must be more. A bend of a bare corridor has four walls, and looks like any other, as do crossings.
Of 140 alignments of submaps in 23 logs and worlds, the 9 wrong ones by more than 5 m had too few
such places."""
HARDLY, LOW_SIGMAS = 0.01, 2.5
"""The same if at most this fraction is contradicted, and of no other alignment a support remains:
where corridors look alike, wrong ones are supported too."""
SYMMETRIC = 0.02
"""Largest contradicted fraction if the robot must have been carried, or scans are missing, between
submaps: a corridor round a building looks the same after half a turn (0.037 and more)."""
RIVAL = 0.5
"""Largest support of another alignment, or number of ends that coincide in it, as a fraction of the
best: along a corridor, walls support many alignments, and the ends at its doors only one."""
TURNS_RAD = np.deg2rad(np.arange(15, 346, 15))
"""Turns about the middle of the walls in common that beams must exclude: a round room looks much
the same after each of them, while its walls suggest only some."""


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
    def grid(self) -> tuple[Floats, Ints, Ints, Ints]:
        """A grid over the walls."""
        return grid_over(self.stretches)

    def judged(self, begins: Floats, stops: Floats) -> tuple[float, float]:
        """Return the length of wall that beams (n, 2) support, and contradict; metres."""
        from relmap.planes.plan.evidence_kernels import beams_on_walls

        walls = self.stretches
        lines = walls.base, walls.normal, walls.low, walls.first
        hits, against, _ = beams_on_walls((begins, stops), lines, self.grid, NEAR_M, 0.0)
        support = (hits > against) & (hits >= OFTEN)
        contradict = (against > hits) & (against >= OFTEN)
        return BIN_M * float(support.sum()), BIN_M * float(contradict.sum())

    def beams_from(self, ends: Floats) -> tuple[Floats, Floats]:
        """Return start and end points of the beams from within the extent of walls (w, 2, 2)."""
        low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
        there = ((self.begins >= low) & (self.begins <= high)).all(axis=1)
        return self.begins[there], self.stops[there]


class SubmapTie(NamedTuple):
    """An alignment of a part to another one, and the wall length that supports it."""

    tie: WallTie
    support_m: float
    contradicted: float

    @property
    def is_sure(self) -> bool:
        """Whether the alignment is supported, hardly contradicted, and cannot slide."""
        supported = self.support_m >= SUPPORTED_M and self.contradicted <= CONTRADICTED
        return supported and _crosses(self.tie)


Refute = Callable[[MapPart, MapPart, WallTie], bool]


def tied_parts(parts: Sequence[MapPart], refute: Refute | None = None) -> list[MapPart]:
    """Join the parts that show the same place, while one alignment is certain and without rival.

    `refute`: returns whether something else speaks against an alignment of two parts.
    """

    def certain(a: int, b: int) -> SubmapTie | None:
        found = unrivalled(left[a], left[b])
        return None if found and refute and refute(left[a], left[b], found.tie) else found

    left = dict(enumerate(parts))
    found = {(a, b): certain(a, b) for a, b in combinations(left, 2)}
    while True:
        sure = {pair: tie for pair, tie in found.items() if tie is not None}
        if not sure:
            return list(left.values())
        (a, b), best = max(sure.items(), key=lambda each: each[1].support_m)
        left[a] = left[a].with_that(left.pop(b), best.tie)
        found = {pair: tie for pair, tie in found.items() if b not in pair}
        for c in left.keys() - {a}:
            first, second = sorted((a, c))
            found[first, second] = certain(first, second)


def unrivalled(part: MapPart, other: MapPart) -> SubmapTie | None:
    """Return the alignment of another part to this one, if it is certain and the only one."""
    if min(part.crossing_m, other.crossing_m) < CROSSING_M:
        return None
    ties = wall_ties(other.ends, part.ends)[:ALIGNMENTS]
    if not any(_crosses(tie) for tie in ties):
        return None
    judged = [_judged(part, other, tie) for tie in ties]
    best, *others = sorted(judged, key=lambda each: -each.support_m)
    if not best.is_sure:
        return None
    walls, ends = coinciding_ends(other.ends, part.ends, best.tie)
    elsewhere = [each for each in others if not _alike(best.tie, each.tie, other.ends)]
    alone = best.contradicted <= HARDLY and all(each.support_m <= 0 for each in elsewhere)
    sigmas = LOW_SIGMAS if alone else SIGMAS
    by_chance = CHANCE * walls + sigmas * (CHANCE * (1 - CHANCE) * walls) ** 0.5
    if walls < WALLS or ends < by_chance:
        return None
    rivals = (each.tie for each in elsewhere if each.support_m > RIVAL * best.support_m)
    if any(coinciding_ends(other.ends, part.ends, tie)[1] > RIVAL * ends for tie in rivals):
        return None
    if best.contradicted > SYMMETRIC and part.jumps_to(other, best.tie):
        return None
    turned = (_judged(part, other, tie) for tie in _turned(part, other, best.tie))
    return None if any(each.support_m > RIVAL * best.support_m for each in turned) else best


def _turned(part: MapPart, other: MapPart, tie: WallTie) -> Iterator[WallTie]:
    """Yield an alignment turned about the point that the coinciding walls face."""
    begin, end = part.ends[coinciding(other.ends, part.ends, tie)[:, 1]].transpose(1, 0, 2)
    along, middle = end - begin, (begin + end) / 2
    centre = np.linalg.lstsq(along, (along * middle).sum(axis=1))[0]
    for turn in rotations(TURNS_RAD[:, None]):
        yield replace(tie, R=turn @ tie.R, t=turn @ (tie.t - centre) + centre)


def _alike(one: WallTie, other: WallTie, ends: Floats) -> bool:
    """Return whether two alignments place walls (w, 2, 2) at nearly the same place."""
    apart = ends @ one.R.T + one.t - (ends @ other.R.T + other.t)
    return bool(np.linalg.norm(apart, axis=2).max() <= ALIKE_M)


def _crosses(tie: WallTie) -> bool:
    """Return whether enough walls overlap, some of them across the others."""
    return tie.length_m >= LEAST_M and tie.across * tie.length_m >= CROSSING_M


def _judged(part: MapPart, other: MapPart, tie: WallTie) -> SubmapTie:
    """Return an alignment of another part, scored by the beams of both."""
    R, t = tie.R, tie.t
    begins, stops = part.beams_from(other.ends @ R.T + t)
    own = other.judged((begins - t) @ R, (stops - t) @ R)
    begins, stops = other.beams_from((part.ends - t) @ R)
    its = part.judged(begins @ R.T + t, stops @ R.T + t)
    support_m, against_m = np.add(own, its)
    share = against_m / max(support_m + against_m, BIN_M)
    return SubmapTie(tie, float(support_m - AGAINST * against_m) / 2, float(share))
