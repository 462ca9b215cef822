"""Ties of submaps that are adjacent in time, by several scans before and after the break.

What two scans leave open, several may determine: the candidate motions of the nearest ones are
compared by the beams of all pairs of scans across the break.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes.linking.links import JUMP, JUMP_M
from relmap.planes.linking.placement import STILL
from relmap.planes.linking.tying import Link, Scans
from relmap.planes.motions import after, distinct, inverse, motion_over, others, wrapped
from relmap.planes.scans.beams import NEAR_M, compared, odds_over, preferred

SIDE = 4
"""Largest number of scans on either side of a break that are compared."""
APART_M, APART_RAD, CANDIDATES = 0.15, np.deg2rad(4.0), 12
"""Motions that differ by less are duplicates; and the largest number of candidates."""
TURN, TURN_RAD = 0.99, np.deg2rad(15.0)
"""Quantile of the rotations within submaps, and by how much more a robot may turn."""
RIVAL = 20.0
"""Log odds by which the beams must exclude every other motion."""
LEAST_SHARE = 0.01
"""Smaller differences in agreement, as a fraction of the points, are none: many tiny ones add up in
a bare corridor. Half of the ties there had less than 0.002, those of four real logs 0.02."""
AGREES, CONTRADICTED = 0.25, 0.05
"""Smallest fraction of the points in view that must agree, and largest that may contradict."""
_ROUND = np.arange(8) * np.pi / 4
BESIDE = np.concatenate(
    [
        0.3 * np.column_stack([0 * _ROUND, np.cos(_ROUND), np.sin(_ROUND)]),
        np.deg2rad([[5.0, 0.0, 0.0], [-5.0, 0.0, 0.0]]),
    ]
)
"""Changes (10, 3) of a motion that the beams must exclude, too."""


@dataclass(frozen=True, eq=False)
class Break:
    """A break and the scans (n,), (m,) on either side of it, ascending."""

    scans: Scans
    earlier: Ints
    later: Ints

    def link(self, most_m: float, most_rad: float) -> Link | None:
        """Return the link across the break if one is certain, given the bounds of the motion."""
        motions, walls = self._candidates(most_m, most_rad)
        if not len(motions):
            return None
        best, odds = preferred(motions, partial(self._odds, motions))
        motion = motions[best]
        rivals = np.append(odds[others(motions, motion)], self._odds(motion + BESIDE, motion))
        agree, contradict = self._agreement(motion)
        if rivals.max() > -RIVAL or agree < AGREES or contradict > CONTRADICTED:
            return None
        return Link(int(self.earlier[-1]), int(self.later[0]), motion, walls[best], True)

    def _odds(self, motions: Floats, motion: Floats) -> Floats:
        """Return the log odds of motions (k, 3) across the break relative to one (3,)."""
        both, scans = np.vstack([motion, motions]), self.scans
        pairs = [
            (scans.beams_of(i), scans.beams_of(j), self._between(i, j, both))
            for i, j in product(self.earlier.tolist(), self.later.tolist())
        ]
        odds, share = odds_over(pairs, scans.firm)
        return np.where(np.abs(share) < LEAST_SHARE, 0.0, odds)

    def _agreement(self, motion: Floats) -> tuple[float, float]:
        """Return the fractions of the points in view that agree with a motion, and contradict."""
        sums = np.zeros(4)
        for i, j in product(self.earlier.tolist(), self.later.tolist()):
            beams = self.scans.beams_of(i), self.scans.beams_of(j)
            there = self._between(i, j, motion[None])
            sums += compared(*beams, there, NEAR_M, 1, self.scans.firm)[0]
        agree, contradict = sums[:2] / max(float(sums[:3].sum()), 1.0)
        return float(agree), float(contradict)

    def _candidates(self, most_m: float, most_rad: float) -> tuple[Floats, list[Ints]]:
        """Return the distinct motions (k, 3) across the break that the nearest scans imply.

        No longer and turning no more than given; and the walls (w, 2) that match, by their numbers.
        """
        found = list[tuple[float, Floats, Ints]]()
        pairs = [*product(self.earlier[-2:].tolist(), self.later[:1].tolist())]
        pairs += [*product(self.earlier[-1:].tolist(), self.later[1:2].tolist())]
        for i, j in pairs:
            search = self.scans.search(i, j, STILL)
            if search is None:
                continue
            some = search.candidates()
            motions = self._between(i, j, some.motions, back=True)
            for motion, evidence, match in zip(motions, some.evidence, some.matches, strict=True):
                planes = self.scans.plane(i)[match.tracks], self.scans.plane(j)[match.walls]
                found.append((float(evidence), motion, np.column_stack(planes)))
        motions = np.array([each[1] for each in found]).reshape(-1, 3)
        usual = np.hypot(*motions[:, 1:].T) <= most_m
        usual &= np.abs(wrapped(motions[:, 0])) <= most_rad
        order = np.argsort([-each[0] for each in found], kind="stable")
        best = distinct(motions, order[usual[order]], CANDIDATES, APART_M, APART_RAD)
        return motions[best], [found[k][2] for k in best]

    def _between(self, i: int, j: int, motions: Floats, back: bool = False) -> Floats:
        """Return the motions (k, 3) of two scans for motions across the break; or the reverse."""
        first, last = int(self.earlier[-1]), int(self.later[0])
        before = motion_over(self.scans.motions[i + 1 : first + 1])
        behind = motion_over(self.scans.motions[last + 1 : j + 1])
        if back:
            before, behind = inverse(before), inverse(behind)
        return inverse(after(inverse(behind), inverse(after(before, motions))))


def tied_across(scans: Scans, submaps: Ints, scan: int) -> Link | None:
    """Return the link into the first scan of a submap from the one before, if one is certain."""
    if scans.expected(scan - 1, scan) is not None or not scans.of_one_run(scan - 1, scan):
        return None
    own, there = np.arange(max(scan - SIDE, 0), scan), np.arange(scan, len(submaps))[:SIDE]
    own, there = own[submaps[own] == submaps[scan - 1]], there[submaps[there] == submaps[scan]]
    return Break(scans, own, there).link(*usual_bounds(scans, submaps))


def usual_bounds(scans: Scans, submaps: Ints) -> tuple[float, float]:
    """Return how far a robot may move from scan to scan, and turn; by the steps in submaps."""
    own = scans.motions[1:][(np.diff(submaps) == 0) & (submaps[1:] >= 0)]
    if not len(own):
        return 0.0, 0.0
    usual_m = float(np.median(np.hypot(*own[:, 1:].T)))
    turn = float(np.quantile(np.abs(wrapped(own[:, 0])), TURN))
    return JUMP_M + JUMP * usual_m, turn + TURN_RAD
