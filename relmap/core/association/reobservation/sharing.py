"""Few landmarks that two parts of a map share, by covariances and by the robot's way.

Three or four landmarks do not identify a place by matching within a tolerance. But refined submaps
know their shapes far better than that, and where the robot goes from one part into another it moves
no farther than usual. The volume of what is compatible with both gives the expected number of sets
of random landmarks that would be.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from scipy.special import chdtri, gammaln

from relmap.core.arrays import Ints
from relmap.core.association.placement import Placement, consistent_placements
from relmap.core.association.reobservation.crossing import (
    Crossing,
    Part,
    crossing_of,
    log_turns,
    usual_steps,
)
from relmap.core.association.reobservation.few import FEWEST, RARE, log_volume
from relmap.core.association.reobservation.recognition import CLEAR, SIGMAS
from relmap.core.association.reobservation.shapes import compared
from relmap.core.map.pose import LOOSE_RAD, squares_across

SURE = 1e-5
"""Accepted expected number of random sets: of places that look alike, some pass a higher limit."""
SETS = 12
"""Number of sets of pairs that are compared, the largest first."""
NEAR_PAIRS, MOST_PAIRS = 1500, 500
"""Number of pairs above which sets are not searched, where the robot goes from one part into the
other, and anywhere: there may be hundreds of submaps."""


@dataclass(frozen=True, eq=False)
class Shared:
    """Landmarks of two parts that are the same.

    `log_chance`: log of the expected number of random ones; `placement`: of the one part in the
    other; `pairs` (k, 2): landmarks of both.
    """

    log_chance: float
    placement: Placement
    pairs: Ints


class FewShared:
    """Finds few landmarks that parts of a map share.

    `submaps`: refined ones; `strays`: unmatched scans, each a part.
    """

    def __init__(self, submaps: Sequence[Part], strays: Sequence[Part]) -> None:
        self._submaps = sorted(submaps, key=lambda part: len(part.landmarks))
        self._strays = strays
        self._step_m, self._step_rad = usual_steps(submaps)
        self._n = sum(len(part.landmarks) for part in submaps)
        n = len(submaps)
        self._log_searches = math.log(max(n * (n - 1) / 2 + len(strays), 1))

    def ties(self) -> list[Shared]:
        """Return what submaps and larger ones share; each submap occurs once."""
        every = []
        for k, part in enumerate(self._submaps):
            for other in self._submaps[k + 1 :]:
                shared = self._near(part, other) or self._anywhere(part, other)
                if shared is not None:
                    every.append((shared.log_chance, k, shared, {id(part), id(other)}))
        chosen, had = [], set[int]()
        for _, _, shared, both in sorted(every, key=lambda one: one[:2]):
            if had.isdisjoint(both):
                chosen.append(shared)
            had |= both
        return chosen

    def matches(self) -> list[Ints]:
        """Return pairs (k, 2) of landmarks of unmatched scans and of submaps nearby."""
        found = []
        for stray in self._strays:
            each = [self._near(stray, submap) for submap in self._submaps]
            shared = [one for one in each if one is not None]
            if shared:
                found.append(min(shared, key=lambda one: one.log_chance).pairs)
        return found

    def _near(self, part: Part, other: Part) -> Shared | None:
        """Return what a part shares with another one if the robot goes from one into the other."""
        crossing = crossing_of(part, other, self._step_m, self._step_rad)
        if crossing is None:
            return None
        pairs = crossing.within_reach(_all_pairs(part, other))
        if len(pairs) > NEAR_PAIRS:
            return None
        return self._likeliest(part, other, pairs, crossing.log_volume, crossing)

    def _anywhere(self, part: Part, other: Part) -> Shared | None:
        """Return what a part shares with another one, wherever it lies in it."""
        if len(part.landmarks) * len(other.landmarks) > MOST_PAIRS:
            return None
        log_where = math.log(self._n) - other.log_density + log_turns(part.positions.shape[1])
        return self._likeliest(part, other, _all_pairs(part, other), log_where, None)

    def _likeliest(
        self, part: Part, other: Part, pairs: Ints, log_where: float, crossing: Crossing | None
    ) -> Shared | None:
        """Return the set of pairs (p, 2) of rows least likely by chance, if it is clear.

        `log_where`: log of the volume of possible motions of the part, in metres and radians.
        """
        found: list[tuple[float, int, Shared]] = []
        for rows in _sets(part, other, pairs, is_near=crossing is not None):
            shared = self._shared(part, other, rows, log_where)
            if shared is not None and (crossing is None or crossing.allows(shared.placement)):
                found.append((shared.log_chance, len(found), shared))
        found.sort(key=lambda one: one[:2])
        if not found or found[0][0] > math.log(SURE):
            return None
        if len(found) > 1 and found[1][0] <= CLEAR * found[0][0]:
            return None
        return found[0][2]

    def _shared(self, part: Part, other: Part, rows: Ints, log_where: float) -> Shared | None:
        """Return pairs (k, 2) of rows with their chance; None if they do not agree."""
        here, there = rows.T
        if _turns_freely(part, here) or _turns_freely(other, there):
            return None
        agreement = compared(
            part.positions[here],
            part.covariance(here),
            other.positions[there],
            other.covariance(there),
        )
        if agreement.square > chdtri(agreement.freedom, RARE):
            return None
        n, k = len(part.landmarks), len(rows)
        log_chance = self._log_searches + log_where + k * other.log_density
        log_chance += gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
        radius = math.sqrt(max(agreement.square, agreement.freedom))
        log_chance += agreement.log_size + log_volume(agreement.freedom, radius)
        pairs = np.column_stack([part.landmarks[here], other.landmarks[there]])
        return Shared(float(log_chance), agreement.placement, pairs)


def _all_pairs(part: Part, other: Part) -> Ints:
    n, m = len(part.landmarks), len(other.landmarks)
    return np.stack(np.divmod(np.arange(n * m), m), axis=1)


def _sets(part: Part, other: Part, pairs: Ints, is_near: bool) -> Iterator[Ints]:
    """Yield sets of pairs (p, 2) of rows that agree, the largest first."""
    fewest = FEWEST if is_near else FEWEST + 1
    tolerance_m = SIGMAS * max(part.noise_m, other.noise_m)
    every = consistent_placements(part.positions, other.positions, pairs, tolerance_m)
    for _, rows in islice(every, SETS):
        if len(rows) < fewest:
            return
        yield rows


def _turns_freely(part: Part, rows: Ints) -> bool:
    """Return whether some landmarks (k,), nearly on a line in space, do not fix a rotation."""
    across = squares_across(part.positions[rows], np.zeros(len(rows), dtype=np.int64), 1)
    return bool(part.noise_m > LOOSE_RAD * np.sqrt(across[0]))
