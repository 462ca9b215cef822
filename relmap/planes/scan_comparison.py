"""The walls and beams of a scan and of earlier ones, compared under motions between them.

A motion is fitted to the walls that match, slid along the longest of them, and verified by beams.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relmap.core.arrays import Floats
from relmap.planes.beams import NEAR_M, Beams, compared
from relmap.planes.judging import Judged, View
from relmap.planes.motions import after, planar
from relmap.planes.observation import PlaneObservation
from relmap.planes.odometry import Expected
from relmap.planes.placement import ROUNDS, Match, PlanarMotion, settled, worth
from relmap.planes.tracks import PlaneTracks, wrapped

REACH_M = 3.5
"""Largest distance between two scans that are linked."""
JUDGES = 200
"""Approximate number of beams used to verify a motion."""
PEAKS, SLIDE_M = 2, 0.1
"""Number of places kept of a motion slid along a wall, and the step."""
SLIDE_NEAR_M, SLIDE_STEP, CONTRADICTING = 0.15, 6, 4.0
"""Tolerance there, subsampling of beams, and weight of a contradicting beam."""
USUAL_M, USUAL_RAD = 1.5, np.deg2rad(45.0)
"""Typical difference between consecutive motions."""
BETTER = 1.25
"""Lead of a usual motion slid along a wall over the one fitted to walls, as a fraction of points,
times the root of their number: three standard deviations where a tenth disagrees."""
FREE_M, FREE = 0.3, 0.01
"""A motion along a wall is undetermined if the beams agree almost as well at this distance."""


class ScanComparison:
    """A scan compared with tracks and earlier scans.

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
        self._expected, self._firm = expected, firm
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

    def _counted(self, motions: Floats, near_m: float = NEAR_M, step: int | None = None) -> Floats:
        """Return the number of points of the scan and the last one that agree etc. (k, 4).

        See `relmap.planes.beams.compared`; by default with some `JUDGES` of the beams.
        """
        step = 1 + len(self._beams) // JUDGES if step is None else step
        return self._counts(self._views[0], motions, near_m, step)

    def _judged(self, guesses: Sequence[PlanarMotion], rounds: int = ROUNDS) -> Judged:
        """Fit motions to the walls that match in some rounds, and compare the beams."""
        tracks, seen = self._tracks, self._seen
        found = [settled(tracks, seen, guess, rounds) for guess in guesses]
        motions = np.array([[motion.yaw, *motion.t] for motion, _ in found]).reshape(-1, 3)
        step = 1 + len(self._beams) // JUDGES
        sums = np.array([self._counts(view, motions, NEAR_M, step) for view in self._views])
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

    def _slid(self, judged: Judged, k: int) -> Judged:
        """Return a motion slid along the longest wall to the best agreement of beams.

        With short steps, one near the usual motion with which beams agree clearly better is also
        compared as it is: fitted to walls, a wrong corner may pull it back.
        """
        if not len(judged.matches[k].walls):
            return self._judged([])
        n = int(REACH_M / SLIDE_M)
        way_m = SLIDE_M * np.arange(-n, n + 1.0)
        motions, value = self._along(judged, k, way_m)
        inner = value[1:-1]
        peaks = 1 + np.flatnonzero((inner >= value[:-2]) & (inner > value[2:]))
        peaks = peaks[np.argsort(-value[peaks], kind="stable")][:PEAKS]
        motions = motions[peaks[np.abs(way_m[peaks]) > SLIDE_M / 2]]
        off_m, step_m = np.hypot(*(motions[:, 1:] - self._before.t).T), np.hypot(*self._before.t)
        usual = motions[np.maximum(off_m, step_m) < FREE_M]
        lead = self._value(usual, 1) - self._value(judged.motions[k : k + 1], 1)
        usual = usual[lead > BETTER / np.sqrt(len(self._beams))]
        fitted = self._judged([planar(motion) for motion in motions])
        return fitted.and_those(self._judged([planar(motion) for motion in usual], 0))

    def _measured(self, judged: Judged, k: int) -> bool:
        """Return whether beams agree less if a motion is slid along the longest wall."""
        if not len(judged.matches[k].walls):
            return False
        value = self._along(judged, k, FREE_M * np.array([-1.0, 0.0, 1.0]))[1]
        return bool(max(value[0], value[2]) < value[1] - FREE)

    def _along(self, judged: Judged, k: int, way_m: Floats) -> tuple[Floats, Floats]:
        """Return a motion slid along the longest wall that matches, and the agreement of beams."""
        walls = judged.matches[k].walls
        longest = walls[np.argmax(self._seen.size[walls])]
        motions = np.tile(judged.motions[k], (len(way_m), 1))
        motions[:, 1:] += way_m[:, None] * self._seen.along[longest]
        return motions, self._value(motions, SLIDE_STEP)

    def _value(self, motions: Floats, step: int) -> Floats:
        """Return the agreement of beams along walls for motions (k, 3)."""
        sums = self._counted(motions, SLIDE_NEAR_M, step)
        in_view = np.maximum(sums[:, :3].sum(axis=1), 1.0)
        return np.asarray((sums[:, 0] - CONTRADICTING * sums[:, 1]) / in_view)

    def _surprise(self, motions: Floats) -> Floats:
        """Return the prior improbability of motions (k, 3), given the usual motion."""
        way = np.hypot(*(motions[:, 1:] - self._before.t).T) / USUAL_M
        turn = wrapped(motions[:, 0] - self._before.yaw) / USUAL_RAD
        support = self._expected.supports(motions) if self._expected else 0.0
        return np.asarray((way**2 + turn**2) / 2 - support)

    def _counts(self, view: View, motions: Floats, near_m: float, step: int) -> Floats:
        there = after(view.motion, motions)
        return compared(view.beams, self._beams, there, near_m, step, self._firm)
