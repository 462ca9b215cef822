"""The placement of the tracks' frame in a laser scan: motions from walls, verified by beams.

Pairs of walls and corners imply motions, many of them wrong. Those that bring most points of one
scan onto surfaces of the other are fitted to the walls that match, and the one with the best
agreement of beams is accepted, unless beams contradict it or a rival comes near.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relmap.core.arrays import Floats
from relmap.planes.beams import NEAR_M, Beams, compared
from relmap.planes.judging import (
    MEASURED,
    NO_CANDIDATES,
    NO_MATCH,
    Candidates,
    Found,
    Judged,
    View,
)
from relmap.planes.motions import after, distinct, others, planar
from relmap.planes.observation import PlaneObservation
from relmap.planes.odometry import OTHERWISE, Expected
from relmap.planes.placement import ROUNDS, STILL, Match, PlanarMotion, settled, worth
from relmap.planes.tracks import PlaneTracks, wrapped

REACH_M = 3.5
REACH_RAD = np.deg2rad(120.0)
"""Largest distance between two scans that are linked."""
TURNS, EACH = 8, 25
"""Number of rotations, and motions for each, evaluated coarsely."""
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
JUDGES = 200
"""Approximate number of beams used to verify a motion."""
SLID, PEAKS, SLIDE_M = 2, 2, 0.1
"""Number of motions slid along a wall, of places kept for each, and the step."""
SLIDE_NEAR_M, SLIDE_STEP, SLIDE_CONTRADICTS = 0.15, 6, 4.0
"""Tolerance there, subsampling of beams, and weight of a contradicting beam."""
USUAL_M, USUAL_RAD = 1.5, np.deg2rad(45.0)
"""Typical difference between consecutive motions."""
CANDIDATES, WITHIN = 6, 8.0
"""Number of motions compared with those of other scans, and largest difference to the best, in log
odds."""
BETTER = 1.25
"""Lead of a usual motion slid along a wall over the one fitted to walls, as a fraction of points,
times the root of their number: three standard deviations where a tenth disagrees."""
EXPLAINS = 0.05
"""Fraction of points by which another motion must exceed the agreement of odometry."""
CONTRADICTS = 0.1
"""Fraction of contradicting points above which odometry is rejected."""
FREE_M, FREE = 0.3, 0.01
"""A motion along a wall is undetermined if the beams agree almost as well at this distance."""
FREE_REACH_M = 1.0
"""Motions nearer than this are no rivals if the motion along a wall is undetermined: the previous
motion decides."""


class Search:
    """The search for the motion of the tracks' frame into that of one scan.

    Parameters
    ----------
    tracks : PlaneTracks
    seen : PlaneObservation
    beams : Beams
        Beams of the same scan.
    views : sequence of View
        Earlier scans, the last one first.
    before : PlanarMotion
        Usual motion of the robot.
    expected : Expected, optional
        Motion expected from odometry.
    firm : bool
        Whether to leave out walls and beams on small things that stand free.
    """

    def __init__(
        self,
        tracks: PlaneTracks,
        seen: PlaneObservation,
        beams: Beams,
        views: Sequence[View],
        before: PlanarMotion,
        expected: Expected | None = None,
        firm: bool = True,
    ) -> None:
        self._beams, self._views = beams, views
        self._before = planar(expected.motion) if expected else before
        self._expected = expected
        self._firm = firm
        kept, own = ~(tracks.loose & firm), ~(seen.loose & firm)
        self._rows, self._walls = np.flatnonzero(kept), np.flatnonzero(own)
        self._tracks, self._seen = tracks.kept(kept), seen.only(own)

    @property
    def _is_empty(self) -> bool:
        """Whether there is nothing to compare."""
        return not min(len(self._tracks), len(self._seen), len(self._beams))

    def _named(self, match: Match) -> Match:
        """Return a match with the numbers of all tracks and walls."""
        return Match(self._rows[match.tracks], self._walls[match.walls], match.score)

    def found(self) -> Found | None:
        """Find the motion implied by walls and supported by beams.

        Returns
        -------
        Found or None
            None if beams contradict all motions, or a rival comes near.
        """
        if self._is_empty:
            return None
        every = self._judged([self._before, STILL])
        best = int(np.argmax(every.evidence))
        clear = every.agree[best] > CLEARLY and every.contradict[best] < HARDLY
        if not clear or not self._measured(every, best):
            every = every.and_those(self._judged(self._guesses()))
            for k in np.argsort(-every.evidence, kind="stable")[:SLID]:
                every = every.and_those(self._slid(every, k))
            best = int(np.argmax(every.evidence))
        if every.evidence[best] < ACCEPTED:
            return None
        motion = every.motions[best]
        if self._expected and self._explains(self._expected, motion):
            return None
        likely = every.evidence > every.evidence[best] - RIVAL
        rivals = likely & others(every.motions, motion)
        measured = self._measured(every, best)
        if not measured:
            rivals &= np.hypot(*(every.motions[:, 1:] - motion[1:]).T) > FREE_REACH_M
        if rivals.any():
            return None
        if not measured and self._expected:
            return self._by_odometry(every, self._expected)
        if not measured:
            off_m = np.hypot(*(every.motions[:, 1:] - self._before.t).T)
            best = int(np.argmin(np.where(likely, off_m, np.inf)))
            motion = every.motions[best]
        match = self._named(every.matches[best])
        return Found(planar(motion), match, measured, float(every.evidence[best]))

    def _explains(self, expected: Expected, motion: Floats) -> bool:
        """Return whether beams agree with odometry almost as well as with another motion (3,)."""
        motions = np.array([expected.motion, motion])
        if expected.off(motions)[1] < OTHERWISE:
            return False
        sums = self._compared(self._views[:1], motions, NEAR_M, 1)
        value = (sums[:, 0] - SLIDE_CONTRADICTS * sums[:, 1]) / np.maximum(sums.sum(axis=1), 1.0)
        return bool(value[0] > value[1] - EXPLAINS)

    def _by_odometry(self, every: Judged, expected: Expected) -> Found | None:
        """Return the likely motion nearest to odometry; None if none is near."""
        off = expected.off(every.motions)
        near = np.where(off < OTHERWISE, every.evidence, -np.inf)
        if near.max() < ACCEPTED:
            return None
        best = int(np.argmin(np.where(near > near.max() - RIVAL, off, np.inf)))
        evidence = float(every.evidence[best])
        match = self._named(every.matches[best])
        return Found(planar(every.motions[best]), match, False, evidence)

    def candidates(self, guesses: Sequence[PlanarMotion] = ()) -> Candidates:
        """Return the plausible motions between these scans by walls and beams, likeliest first.

        Parameters
        ----------
        guesses : sequence of PlanarMotion
            Candidates in addition to those implied by walls.
        """
        if self._is_empty:
            return NO_CANDIDATES
        every = self._judged([self._before, STILL, *guesses, *self._guesses()])
        for k in np.argsort(-every.of_pair, kind="stable")[:SLID]:
            every = every.and_those(self._slid(every, k))
        evidence = every.of_pair
        order = np.argsort(-evidence, kind="stable")
        order = order[np.isfinite(evidence[order]) & (evidence[order] > evidence.max() - WITHIN)]
        best = distinct(every.motions, order, CANDIDATES)
        measured = np.array([self._measured(every, k) for k in best], dtype=np.bool_)
        matches = [self._named(every.matches[k]) for k in best]
        evidence = evidence[best] + MEASURED * measured
        return Candidates(every.motions[best], evidence, measured, matches)

    def judged(self, motion: Floats) -> tuple[float, float, bool]:
        """Return the evidence of the scans for a motion (3,), after local optimisation.

        Returns
        -------
        evidence : float
            Log odds that it is right.
        contradict : float
            Fraction of contradicting points.
        stays : bool
            Whether it converges to the given motion.
        """
        if self._is_empty:
            return -np.inf, 0.0, True
        found = self._judged([planar(motion)])
        evidence = float(found.of_pair[0]) + MEASURED * self._measured(found, 0)
        return evidence, float(found.contradict[0]), not others(found.motions, motion)[0]

    def bridged(self, expected: Expected) -> Found | None:
        """Return the motion expected from odometry, unless beams contradict it.

        It is refined by walls that match nearby.
        """
        found = self._judged([planar(expected.motion)])
        motions = np.array([expected.motion, found.motions[0]])
        sums = self._compared(self._views[:1], motions, NEAR_M, 1 + len(self._beams) // JUDGES)
        is_near = expected.off(motions)[1] < OTHERWISE
        by_walls = is_near and sums[1, 0] >= sums[0, 0] and sums[1, 1] <= sums[0, 1]
        if sums[int(by_walls), 1] > CONTRADICTS * sums[0].sum():
            return None
        match = self._named(found.matches[0]) if by_walls else NO_MATCH
        return Found(planar(motions[int(by_walls)]), match, False, float(found.evidence[0]), True)

    def _guesses(self) -> list[PlanarMotion]:
        """Return the motions implied by walls with the best coarse agreement of beams."""
        from relmap.planes.guess_kernels import implied

        recent = self._tracks.kept(self._tracks.missed == self._tracks.missed.min(initial=0))
        walls = recent.arrays, self._seen.arrays
        motions = implied(*walls, 0.0, REACH_M, REACH_RAD, TURNS, EACH)
        sums = self._compared(self._views[:1], motions, ROUGH_M, ROUGH_STEP)
        order = np.argsort(sums[:, 1] - sums[:, 0], kind="stable")
        best = distinct(motions, order, CLOSELY, ALIKE_M, ALIKE_RAD)
        return [planar(motion) for motion in motions[best]]

    def _along(self, match: Match) -> Floats:
        """Return the direction of the longest wall that matches."""
        sizes = self._seen.size[match.walls]
        return np.asarray(self._seen.along[match.walls[np.argmax(sizes)]])

    def _slides(self, judged: Judged, k: int, way_m: Floats) -> tuple[Floats, Floats]:
        """Return a motion slid along the longest wall that matches, and the agreement of beams."""
        motions = np.tile(judged.motions[k], (len(way_m), 1))
        motions[:, 1:] += way_m[:, None] * self._along(judged.matches[k])
        return motions, self._value(motions, SLIDE_STEP)

    def _value(self, motions: Floats, step: int) -> Floats:
        """Return the agreement of beams along walls for motions (k, 3)."""
        sums = self._compared(self._views[:1], motions, SLIDE_NEAR_M, step)
        in_view = np.maximum(sums[:, :3].sum(axis=1), 1.0)
        return np.asarray((sums[:, 0] - SLIDE_CONTRADICTS * sums[:, 1]) / in_view)

    def _slid(self, judged: Judged, k: int) -> Judged:
        """Return a motion slid along the longest wall to the best agreement of beams.

        With short steps, one near the usual motion with which beams agree clearly better is also
        compared as it is: fitted to walls, a wrong corner may pull it back.
        """
        if not len(judged.matches[k].walls):
            return self._judged([])
        n = int(REACH_M / SLIDE_M)
        way_m = SLIDE_M * np.arange(-n, n + 1.0)
        motions, value = self._slides(judged, k, way_m)
        inner = value[1:-1]
        peaks = 1 + np.flatnonzero((inner >= value[:-2]) & (inner > value[2:]))
        peaks = peaks[np.argsort(-value[peaks], kind="stable")][:PEAKS]
        motions = motions[peaks[np.abs(way_m[peaks]) > SLIDE_M / 2]]
        off_m, step_m = np.hypot(*(motions[:, 1:] - self._before.t).T), np.hypot(*self._before.t)
        usual = motions[np.maximum(off_m, step_m) < FREE_M]
        lead = self._value(usual, 1) - self._value(judged.motions[k : k + 1], 1)
        usual = usual[lead > BETTER / np.sqrt(len(self._beams))]
        slid = self._judged([planar(motion) for motion in motions])
        return slid.and_those(self._judged([planar(motion) for motion in usual], 0))

    def _measured(self, judged: Judged, k: int) -> bool:
        """Return whether beams agree less if a motion is slid along the longest wall."""
        if not len(judged.matches[k].walls):
            return False
        value = self._slides(judged, k, FREE_M * np.array([-1.0, 0.0, 1.0]))[1]
        return bool(max(value[0], value[2]) < value[1] - FREE)

    def _judged(self, guesses: Sequence[PlanarMotion], rounds: int = ROUNDS) -> Judged:
        """Fit motions to the walls that match in some rounds, and compare the beams."""
        tracks, seen = self._tracks, self._seen
        found = [settled(tracks, seen, guess, rounds) for guess in guesses]
        motions = np.array([[motion.yaw, *motion.t] for motion, _ in found]).reshape(-1, 3)
        step = 1 + len(self._beams) // JUDGES
        sums = np.array([self._compared([view], motions, NEAR_M, step) for view in self._views])
        possible = max(min(worth(tracks, seen, np.ones(len(tracks), dtype=np.bool_))), 1.0)
        total = sums.sum(axis=2)
        return Judged(
            motions,
            [match for _, match in found],
            (sums[..., 0] / np.maximum(total, 1.0)).max(axis=0),
            sums[..., 1].sum(axis=0) / np.maximum(total.sum(axis=0), 1.0),
            np.array([match.score / possible for _, match in found]),
            self._surprise(motions),
        )

    def _surprise(self, motions: Floats) -> Floats:
        """Return the prior improbability of motions (k, 3), given the usual motion."""
        way = np.hypot(*(motions[:, 1:] - self._before.t).T) / USUAL_M
        turn = wrapped(motions[:, 0] - self._before.yaw) / USUAL_RAD
        support = self._expected.supports(motions) if self._expected else 0.0
        return np.asarray((way**2 + turn**2) / 2 - support)

    def _compared(self, views: Sequence[View], motions: Floats, near_m: float, step: int) -> Floats:
        """Return the number of points of the scan and of views that agree etc.; see `compared`."""
        sums = np.zeros((len(motions), 4))
        for view in views:
            sums += compared(
                view.beams, self._beams, after(view.motion, motions), near_m, step, self._firm
            )
        return sums
