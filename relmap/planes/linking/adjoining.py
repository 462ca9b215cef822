"""Ties of submaps that are adjacent in time, by several scans before and after the break.

What two scans leave open, several may determine: the candidate motions of the nearest ones are
compared by the beams of all pairs of scans across the break. If none of those implied by walls is
certain, the beams themselves supply candidates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.links import JUMP, JUMP_M
from relmap.planes.linking.placement import STILL
from relmap.planes.linking.scan_comparison import CONTRADICTING
from relmap.planes.linking.search import TIE_AGREES
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
NEAREST = 2
"""Number of scans on either side whose beams supply candidates."""
GRID_M, GRID_RAD, ROUGH_M, ROUGH_STEP = 0.25, np.deg2rad(5.0), 0.3, 8
"""Spacing of the motions first compared; their tolerance, and subsampling of beams."""
FEW = 6
"""Number of candidates that all beams improve."""
PEAKS, PEAK_M, PEAK_RAD = 16, 0.35, np.deg2rad(7.0)
"""Number of the best of them, and how far apart these are."""
LEAST_SEEN = 0.2
"""Fraction of the points taken to be in view at least."""
FINER, MOVES = (0.1, 0.05, 0.025), 6
"""Steps by which the beams improve a candidate, metres, and the largest number of each."""
FINER_RAD_PER_M = np.deg2rad(20.0)
"""Their rotation."""
_ROUND = np.arange(8) * np.pi / 4
BESIDE = np.concatenate(
    [
        0.3 * np.column_stack([0 * _ROUND, np.cos(_ROUND), np.sin(_ROUND)]),
        np.deg2rad([[5.0, 0.0, 0.0], [-5.0, 0.0, 0.0]]),
    ]
)
"""Changes (10, 3) of a motion that the beams must exclude, too."""
AROUND = np.array([one for one in product((-1.0, 0.0, 1.0), repeat=3) if any(one)])
"""Directions (26, 3) in which a candidate is improved."""


@dataclass(frozen=True, eq=False)
class Break:
    """A break and the scans (n,), (m,) on either side of it, ascending."""

    scans: Scans
    earlier: Ints
    later: Ints

    def link(self, most_m: float, most_rad: float) -> Link | None:
        """Return the link across the break if one is certain, given the bounds of the motion."""
        motions, walls = self._candidates(most_m, most_rad)
        best = self._certain(motions, AGREES)
        return None if best is None else self._linked(motions[best], walls[best])

    def link_by_beams(self, most_m: float, most_rad: float) -> Link | None:
        """Return the same with candidates by beams, too, at one of which some wall matches."""
        walls, rough = self._candidates(most_m, most_rad)[0], self._rough(most_m, most_rad)
        motions = np.array([climbed(one, FINER, self._better) for one in (*walls, *rough)])
        order = np.argsort(-self._value(motions, NEAR_M, 1), kind="stable")
        few = motions[distinct(motions, order, FEW, APART_M, APART_RAD)]
        few = np.array([climbed(one, FINER[1:], self._odds) for one in few])
        motions = np.vstack([walls, motions, few])
        best = self._certain(motions, TIE_AGREES)
        if best is None:
            return None
        link = self._linked(motions[best], self._walls_at(motions[best]))
        return link if len(link.walls) and _within(link.motion[None], most_m, most_rad)[0] else None

    def _linked(self, motion: Floats, walls: Ints) -> Link:
        return Link(int(self.earlier[-1]), int(self.later[0]), motion, walls, True)

    def _certain(self, motions: Floats, agrees: float) -> int | None:
        """Return which of some motions (k, 3) is certain, if one is; `agrees`: least agreement."""
        if not len(motions):
            return None
        best, odds = preferred(motions, partial(self._odds, motions))
        motion = motions[best]
        rivals = np.append(odds[others(motions, motion)], self._odds(motion + BESIDE, motion))
        sums = self._counted(self._pairs(), motion[None], NEAR_M, 1)[0]
        agree, contradict = (sums[:2] / max(float(sums[:3].sum()), 1.0)).tolist()
        if rivals.max() > -RIVAL or agree < agrees or contradict > CONTRADICTED:
            return None
        return best

    def _rough(self, most_m: float, most_rad: float) -> Floats:
        """Return the motions (k, 3) of a grid at which beams of the nearest scans agree best."""
        way_m = np.arange(-most_m, most_m + GRID_M, GRID_M)
        turn = np.arange(-most_rad, most_rad + GRID_RAD, GRID_RAD)
        motions = np.stack(np.meshgrid(turn, way_m, way_m), axis=-1).reshape(-1, 3)
        motions = motions[_within(motions, most_m, most_rad)]
        order = np.argsort(-self._value(motions, ROUGH_M, ROUGH_STEP), kind="stable")
        return np.asarray(motions[distinct(motions, order, PEAKS, PEAK_M, PEAK_RAD)])

    def _value(self, motions: Floats, near_m: float, step: int) -> Floats:
        """Return how well the beams of the nearest scans agree with motions (k, 3); (k,)."""
        sums = self._counted(self._pairs(NEAREST), motions, near_m, step)
        in_view = np.maximum(sums[:, :3].sum(axis=1), LEAST_SEEN * sums.sum(axis=1))
        return np.asarray((sums[:, 0] - CONTRADICTING * sums[:, 1]) / np.maximum(in_view, 1.0))

    def _better(self, motions: Floats, motion: Floats) -> Floats:
        """Return by how much motions (k, 3) agree better than one (3,); (k,)."""
        value = self._value(np.vstack([motion, motions]), NEAR_M, ROUGH_STEP)
        return np.asarray(value[1:] - value[0])

    def _walls_at(self, motion: Floats) -> Ints:
        """Return the walls (w, 2) of the nearest scans that match at a motion, by their numbers."""
        walls = [np.empty((0, 2), dtype=np.int64)]
        for i, j in self._pairs(NEAREST):
            search = self.scans.search(i, j, STILL)
            if search is not None:
                match = search.matched(self._between(i, j, motion[None])[0])
                both = self.scans.plane(i)[match.tracks], self.scans.plane(j)[match.walls]
                walls.append(np.column_stack(both))
        return np.unique(np.concatenate(walls), axis=0)

    def _pairs(self, most: int = SIDE) -> list[tuple[int, int]]:
        """Return the pairs of scans across the break, of so many on either side."""
        return [*product(self.earlier[-most:].tolist(), self.later[:most].tolist())]

    def _odds(self, motions: Floats, motion: Floats) -> Floats:
        """Return the log odds of motions (k, 3) across the break relative to one (3,)."""
        both, scans = np.vstack([motion, motions]), self.scans
        pairs = [
            (scans.beams_of(i), scans.beams_of(j), self._between(i, j, both))
            for i, j in self._pairs()
        ]
        odds, share = odds_over(pairs, scans.firm)
        return np.where(np.abs(share) < LEAST_SHARE, 0.0, odds)

    def _counted(
        self, pairs: list[tuple[int, int]], motions: Floats, near_m: float, step: int
    ) -> Floats:
        """Return how many points of some pairs of scans agree, contradict, etc.; (k, 4)."""
        sums = np.zeros((len(motions), 4))
        for i, j in pairs:
            beams = self.scans.beams_of(i), self.scans.beams_of(j)
            there = self._between(i, j, motions)
            sums += compared(*beams, there, near_m, step, self.scans.firm)
        return sums

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
        usual = _within(motions, most_m, most_rad)
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


def _within(motions: Floats, most_m: float, most_rad: float) -> Bools:
    """Return which motions (k, 3) are no longer and turn no more than given."""
    usual = np.hypot(*motions[:, 1:].T) <= most_m
    return np.asarray(usual & (np.abs(wrapped(motions[:, 0])) <= most_rad))


def climbed(
    motion: Floats, steps_m: Sequence[float], gain: Callable[[Floats, Floats], Floats]
) -> Floats:
    """Return the motion (3,) reached from another by smaller and smaller steps that gain.

    `gain`: returns that of motions (k, 3) over one (3,).
    """
    for step_m in steps_m:
        around = AROUND * [FINER_RAD_PER_M * step_m, step_m, step_m]
        for _ in range(MOVES):
            gains = gain(motion + around, motion)
            if gains.max() <= 0:
                break
            motion = motion + around[np.argmax(gains)]
    return motion


def tied_across(
    scans: Scans, submaps: Ints, scan: int, failed: set[tuple[int, ...]] | None = None
) -> Link | None:
    """Return the link into the first scan of a submap from the one before, if one is certain.

    With `failed`, motions that the beams suggest are candidates, too; it collects the breaks at
    which none is certain, which are not examined again.
    """
    if scans.expected(scan - 1, scan) is not None or not scans.of_one_run(scan - 1, scan):
        return None
    own, there = np.arange(max(scan - SIDE, 0), scan), np.arange(scan, len(submaps))[:SIDE]
    own, there = own[submaps[own] == submaps[scan - 1]], there[submaps[there] == submaps[scan]]
    between, bounds = Break(scans, own, there), usual_bounds(scans, submaps)
    if failed is None:
        return between.link(*bounds)
    same = (scan, len(own), len(there))
    link = None if same in failed else between.link_by_beams(*bounds)
    if link is None:
        failed.add(same)
    return link


def usual_bounds(scans: Scans, submaps: Ints) -> tuple[float, float]:
    """Return how far a robot may move from scan to scan, and turn; by the steps in submaps."""
    own = scans.motions[1:][(np.diff(submaps) == 0) & (submaps[1:] >= 0)]
    if not len(own):
        return 0.0, 0.0
    usual_m = float(np.median(np.hypot(*own[:, 1:].T)))
    turn = float(np.quantile(np.abs(wrapped(own[:, 0])), TURN))
    return JUMP_M + JUMP * usual_m, turn + TURN_RAD
