"""Submaps that show the same place: aligned by their walls, verified by their beams.

Each pair of submaps is aligned by overlapping walls (`wall_tie`). An alignment is scored by the
beams of all scans of both: those that end on the walls of the other support it, those that pass
through them contradict it. The best pair is joined to one map, and the search repeated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.motions import rotations
from relmap.planes.places.map_part import MapPart
from relmap.planes.places.wall_tie import (
    ALIKE_M,
    LEAST_M,
    WallTie,
    coinciding,
    coinciding_ends,
    wall_ties,
)
from relmap.planes.plan.evidence import BIN_M

ALIGNMENTS = 12
"""Number of alignments of a pair that are scored, those with the longest overlap first."""
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
OPENING = 2
"""Ends that coincide and do not count for each opening, which may be counted once for each of the
walls beside it: a few doors may have been opened or closed, but in places that only look alike most
differ."""
SYMMETRIC = 0.02
"""Largest contradicted fraction if the robot must have been carried, or scans are missing, between
submaps: a corridor round a building looks the same after half a turn (0.037 and more)."""
RIVAL = 0.5
"""Largest support of another alignment, or number of ends that coincide in it, as a fraction of the
best: along a corridor, walls support many alignments, and the ends at its doors only one."""
TURNS_RAD = np.deg2rad(np.arange(15, 346, 15))
"""Turns about the middle of the walls in common that beams must exclude: a round room looks much
the same after each of them, while its walls suggest only some."""


class SubmapTie(NamedTuple):
    """An alignment of a part to another one, and the wall length that supports it."""

    tie: WallTie
    support_m: float
    contradicted: float


Beams = tuple[Floats, Floats]
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
    supported = best.support_m >= SUPPORTED_M and best.contradicted <= CONTRADICTED
    if not supported or not _crosses(best.tie):
        return None
    walls, ends = coinciding_ends(other.ends, part.ends, best.tie)
    elsewhere = [each for each in others if not _alike(best.tie, each.tie, other.ends)]
    alone = best.contradicted <= HARDLY and all(each.support_m <= 0 for each in elsewhere)
    sigmas = LOW_SIGMAS if alone else SIGMAS
    if walls < WALLS:
        return None
    own, its = _beams_of_both(part, other, best.tie)  # one is closed where the other is open
    openings = other.longer.openings(*own) + part.longer.openings(*its)
    if ends - OPENING * openings < ends_by_chance(walls, sigmas):
        return None
    rivals = (each.tie for each in elsewhere if each.support_m > RIVAL * best.support_m)
    if any(coinciding_ends(other.ends, part.ends, tie)[1] > RIVAL * ends for tie in rivals):
        return None
    if best.contradicted > SYMMETRIC and part.jumps_to(other, best.tie):
        return None
    turned = (_judged(part, other, tie) for tie in _turned(part, other, best.tie))
    return None if any(each.support_m > RIVAL * best.support_m for each in turned) else best


def ends_by_chance(walls: int, sigmas: float) -> float:
    """Return at how many places ends of walls that coincide do too by chance, at most."""
    return CHANCE * walls + sigmas * math.sqrt(CHANCE * (1 - CHANCE) * walls)


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
    own, its = _beams_of_both(part, other, tie)
    support_m, against_m = np.add(other.judged(*own), part.judged(*its))
    share = against_m / max(support_m + against_m, BIN_M)
    return SubmapTie(tie, float(support_m - AGAINST * against_m) / 2, float(share))


def _beams_of_both(part: MapPart, other: MapPart, tie: WallTie) -> tuple[Beams, Beams]:
    """Return the beams of the first part in the frame of the second, and the other way round."""
    R, t = tie.R, tie.t
    begins, stops = part.beams_from(other.ends @ R.T + t)
    own = (begins - t) @ R, (stops - t) @ R
    begins, stops = other.beams_from((part.ends - t) @ R)
    return own, (begins @ R.T + t, stops @ R.T + t)
