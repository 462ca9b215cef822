"""The placement of the tracks' frame in a laser scan: motions from walls, verified by beams.

Pairs of walls and corners imply motions, many of them wrong. Those that bring most points of one
scan onto surfaces of the other are fitted to the walls that match, and the one with the best
agreement of beams is accepted, unless beams contradict it or a rival comes near.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.judging import (
    MEASURED,
    NO_CANDIDATES,
    NO_MATCH,
    Candidates,
    Found,
    Judged,
)
from relmap.planes.linking.links import CROSSING
from relmap.planes.linking.placement import STILL, Match
from relmap.planes.linking.scan_comparison import CONTRADICTING, ScanComparison
from relmap.planes.motions import distinct, others, wrapped
from relmap.planes.odometry.prediction import OTHERWISE, Expected

ROUGH_M, ROUGH_STEP = 0.3, 12
"""Tolerance of the coarse evaluation, and subsampling of beams."""
CLOSELY = 8
ALIKE_M, ALIKE_RAD = 0.2, np.deg2rad(5.0)
"""Number of motions fitted to walls and evaluated with all beams, and the distance of
duplicates."""
ACCEPTED = 1.5
"""Log odds above which a motion is accepted."""
CLEARLY, HARDLY = 0.75, 0.01
"""Agreeing and contradicting fractions for which a usual motion is accepted at once."""
RIVAL = 1.7
"""Log odds by which a motion must exceed any other."""
CANDIDATES, WITHIN = 6, 8.0
"""Number of motions compared with those of other scans, and largest difference to the best, in log
odds."""
EXPLAINS = 0.05
"""Fraction of points by which another motion must exceed the agreement of odometry."""
CONTRADICTS = 0.1
"""Fraction of contradicting points above which odometry is rejected."""
TIE_AGREES, TIE_CONTRADICTS, TIE_TURN = 0.36, 0.01, 1.2
"""Smallest fraction of points that must agree to tie two scans; and, if only parallel walls match,
which look the same farther along and from the other end, the largest fraction that may contradict
and the largest rotation, radians."""
SLID, SAME = 2, 1e-6
"""Number of motions slid along a wall; of those that differ by less than this, metres and radians,
as several guesses often lead to one motion, only the first."""
TURNS_RAD = np.deg2rad(2.5)
"""Largest difference of the turn from the usual one if the usual step decides between motions along
parallel walls: steps vary with the turns."""
USUALLY = 2.0
"""Largest difference from the usual step then, as a multiple of its variation."""
FREE_REACH_M = 1.0
"""Motions nearer than this are not rivals if the motion along a wall is undetermined: the previous
motion decides."""


class Search(ScanComparison):
    """The search for the motion of the tracks' frame into that of one scan."""

    def found(self) -> Found | None:
        """Find the motion implied by walls and supported by beams.

        Returns None if beams contradict all motions, or a rival comes near.
        """
        if self._is_empty:
            return None
        every = self._judged([self._usual, STILL])
        best = int(np.argmax(every.evidence))
        is_usual = not others(every.motions[[best]], self._usual)[0]
        clear = is_usual and every.agree[best] > CLEARLY and every.contradict[best] < HARDLY
        clear = clear and self._measured(every, best)
        if not clear:
            every = every.and_those(self._judged(self._guesses()))
            every = self._with_slid(every, every.evidence)
            best = int(np.argmax(every.evidence))
        if every.evidence[best] < ACCEPTED:
            return None
        motion = every.motions[best]
        if self._expected and self._explains(self._expected, motion):
            return None
        likely = np.flatnonzero(every.evidence > every.evidence[best] - RIVAL)
        best, one, rivals = self._outstanding(every, likely)
        stays = clear and np.array_equal(one.motions[0], motion)
        measured = stays or self._measured(one, 0)
        unusual = self._unusual_along(one, every.motions[best], rivals)
        ambiguous = bool(unusual.any())
        rivals, measured = rivals[~unusual], measured and not ambiguous
        if not measured:
            rivals = rivals[np.hypot(*(rivals - every.motions[best])[:, 1:].T) > FREE_REACH_M]
        if len(rivals) or (self._expected and not measured):  # odometry bridges, see `bridged`
            return None
        one = one if measured else self._steady(one)
        if ambiguous and not self._is_usual(one):
            return None
        match, evidence = self._named(one.matches[0]), float(every.evidence[best])
        return Found(one.motions[0], match, measured, evidence, ambiguous=ambiguous)

    def near(self, motion: Floats) -> Found | None:
        """Return a given motion (3,), fitted to walls that match nearby; None if none does."""
        if self._is_empty:
            return None
        one = self._judged([motion])
        if others(one.motions, motion, ALIKE_M)[0]:
            one = self._judged([motion], 0)
        if not len(one.matches[0].walls):
            return None
        match = self._named(one.matches[0])
        return Found(one.motions[0], match, self._measured(one, 0), np.inf)

    def _with_slid(self, every: Judged, evidence: Floats) -> Judged:
        """Return motions (k, 3), and those of most evidence (k,) slid along walls."""
        most = np.argsort(-evidence, kind="stable")[:SLID]
        for k in distinct(every.motions, most, SLID, SAME, SAME):
            every = every.and_those(self._slid(every, k))
        return every

    def _outstanding(self, every: Judged, likely: Ints) -> tuple[int, Judged, Floats]:
        """Return the likely motion that the beams of the last scans prefer.

        `likely` (k,): rows of the likely motions. Returns the row, the motion, corrected, and the
        others (n, 3), unless the beams exclude them all.
        """
        order = likely[np.argsort(-every.evidence[likely], kind="stable")]
        rows = distinct(every.motions, order, CANDIDATES)
        corrected = {k: self._corrected(every, k) for k in rows.tolist()}
        motions = np.vstack([one.motions for one in corrected.values()])
        best = int(rows[self._preferred(self._deciding, motions)[0] if len(rows) > 1 else 0])
        one = corrected[best]
        apart = others(every.motions[likely], every.motions[best])
        rivals = likely[apart & others(every.motions[likely], one.motions[0])]
        other = [corrected.get(k) or self._corrected(every, k) for k in rivals.tolist()]
        motions = np.vstack([one.motions, *(each.motions for each in other)])
        if len(rivals) and self._excluded(motions[1:], one.motions[0]).all():
            rivals = rivals[:0]
        return best, one, every.motions[rivals]

    def _explains(self, expected: Expected, motion: Floats) -> bool:
        """Return whether beams agree with odometry almost as well as with another motion (3,)."""
        motions = np.array([expected.motion, motion])
        if expected.off(motions)[1] < OTHERWISE:
            return False
        sums = self._counted(motions, step=1)
        value = (sums[:, 0] - CONTRADICTING * sums[:, 1]) / np.maximum(sums.sum(axis=1), 1.0)
        return bool(value[0] > value[1] - EXPLAINS)

    def candidates(self, guesses: Sequence[Floats] = ()) -> Candidates:
        """Return the plausible motions between these scans by walls and beams, likeliest first.

        `guesses`: candidates in addition to those implied by walls.
        """
        if self._is_empty:
            return NO_CANDIDATES
        every = self._judged([self._usual, STILL, *guesses, *self._guesses()])
        every = self._with_slid(every, every.of_pair)
        evidence = every.of_pair
        order = np.argsort(-evidence, kind="stable")
        order = order[np.isfinite(evidence[order]) & (evidence[order] > evidence.max() - WITHIN)]
        best = distinct(every.motions, order, CANDIDATES)
        each = [self._corrected(every, k, False) for k in best]
        measured = np.array([self._measured(one, 0) for one in each], dtype=np.bool_)
        doubtful = np.array([self._is_doubtful(one) for one in each], dtype=np.bool_)
        matches = [self._named(one.matches[0]) for one in each]
        motions = np.array([one.motions[0] for one in each]).reshape(-1, 3)
        evidence = evidence[best] + MEASURED * measured
        parallel = np.array([self._is_parallel(one) for one in each], dtype=np.bool_)
        if parallel.any():  # then walls hardly distinguish them
            odds = self._preferred(self._views[:1], motions[parallel])[1]
            evidence[parallel] += np.clip(odds, -WITHIN, 0.0)
        return Candidates(motions, evidence, measured, doubtful, matches)

    def _is_parallel(self, one: Judged) -> bool:
        """Return whether the walls that match are parallel."""
        return bool(self._crossing(one.matches[0]) < CROSSING)

    def _unusual_along(self, one: Judged, motion: Floats, rivals: Floats) -> Bools:
        """Return which rivals (k, 3) of a motion (3,) the usual step refutes.

        Those that differ along parallel walls only, if the robot turns as usual.
        """
        turns = abs(float(wrapped(one.motions[0, 0] - self._usual[0]))) > TURNS_RAD
        if turns or self._expected or not self._is_parallel(one):
            return np.zeros(len(rivals), dtype=np.bool_)
        across_m = self._across_m(rivals - motion, one.matches[0])
        turned = np.abs(wrapped(rivals[:, 0] - motion[0]))
        return np.asarray((across_m <= ALIKE_M) & (turned <= ALIKE_RAD))

    def _across_m(self, motions: Floats, match: Match) -> Floats:
        """Return how far motions (k, 3) lead across the longest wall that matches (k,), metres."""
        x, y = self._along_longest(match)
        return np.asarray(np.abs(motions[:, 1] * y - motions[:, 2] * x))

    def _is_usual(self, one: Judged) -> bool:
        """Return whether a motion is about as long as the usual one, and hardly aside."""
        motion, match = one.motions[0], one.matches[0]
        if self._across_m(one.motions - self._usual, match)[0] > ALIKE_M:
            return False
        most_m = USUALLY * (self._scale_m + self._varies_m())
        return abs(self._usual_m(motion, match)) <= most_m

    def _is_doubtful(self, one: Judged) -> bool:
        """Return whether too few points support a motion to tie two scans."""
        parallel = self._is_parallel(one)
        turned = abs(one.motions[0, 0]) > TIE_TURN
        either = parallel and (turned or one.contradict[0] > TIE_CONTRADICTS)
        return bool(one.agree[0] < TIE_AGREES or either)

    def judged(self, motion: Floats) -> tuple[float, float, bool]:
        """Return the evidence of the scans for a motion (3,), after local optimisation.

        Returns `evidence`: log odds that it is right, `contradict`: fraction of contradicting
        points and `stays`: whether it converges to the given motion.
        """
        if self._is_empty:
            return -np.inf, 0.0, True
        found = self._judged([motion])
        evidence = float(found.of_pair[0]) + MEASURED * self._measured(found, 0)
        return evidence, float(found.contradict[0]), not others(found.motions, motion)[0]

    def matched(self, motion: Floats) -> Match:
        """Return the walls that match at a motion (3,), as it is."""
        return self._named(self._judged([motion], 0).matches[0])

    def bridged(self, expected: Expected) -> Found | None:
        """Return the motion expected from odometry, unless beams contradict it.

        It is refined by walls that match nearby.
        """
        found = self._judged([expected.motion])
        motions = np.array([expected.motion, found.motions[0]])
        sums = self._counted(motions)
        is_near = expected.off(motions)[1] < OTHERWISE
        by_walls = is_near and sums[1, 0] >= sums[0, 0] and sums[1, 1] <= sums[0, 1]
        if sums[int(by_walls), 1] > CONTRADICTS * sums[0].sum():
            return None
        match = self._named(found.matches[0]) if by_walls else NO_MATCH
        return Found(motions[int(by_walls)], match, False, float(found.evidence[0]), True)

    def _guesses(self) -> Floats:
        """Return the motions implied by walls with the best coarse agreement of beams."""
        from relmap.planes.linking.guess_kernels import implied

        tracks = self._tracks
        recent = tracks.kept(tracks.missed == tracks.missed.min(initial=0))
        motions = implied(recent.arrays, self._seen.arrays, np.inf)
        sums = self._counted(motions, ROUGH_M, ROUGH_STEP)
        order = np.argsort(sums[:, 1] - sums[:, 0], kind="stable")
        best = distinct(motions, order, CLOSELY, ALIKE_M, ALIKE_RAD)
        return np.asarray(motions[best])
