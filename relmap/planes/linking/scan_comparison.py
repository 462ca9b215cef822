"""The walls and beams of a scan and of earlier ones, compared under motions between them.

A motion is fitted to the walls that match, slid along the longest of them, and verified by beams.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.planes.linking.judging import Judged, View
from relmap.planes.linking.links import CROSSING, spread
from relmap.planes.linking.placement import ROUNDS, Match, PlaneTracks, settled, worth
from relmap.planes.motions import wrapped
from relmap.planes.odometry.prediction import Expected
from relmap.planes.scans.beams import NEAR_M, Beams, compared, odds_over, preferred
from relmap.planes.scans.observation import PlaneObservation

REACH_M = 3.5
"""Largest distance between two scans that are linked."""
VERIFYING = 2
"""Number of earlier scans whose beams verify a motion."""
NEARBY_M = 1.5
"""Farthest of the scans by which a motion along a wall is corrected."""
JUDGES = 200
"""Approximate number of beams used to verify a motion."""
PEAKS, SLIDE_M = 2, 0.1
"""Number of places kept of a motion slid along a wall, and the step."""
SLIDE_NEAR_M, SLIDE_STEP, CONTRADICTING = 0.15, 6, 4.0
"""Tolerance there, subsampling of beams, and weight of a contradicting beam."""
USUAL_M, USUAL_RAD = 1.5, np.deg2rad(45.0)
"""Typical difference between consecutive motions."""
COARSE_M, FINE_M = 0.1 * np.arange(-6.0, 7.0), 0.025 * np.arange(-3.0, 4.0)
"""Corrections of a motion along the longest wall."""
CROSSINGS = 4.0
"""Spread of the directions of matching walls above which they determine a motion well."""
PARALLEL, CERTAIN = 3.0, 40.0
"""Spread below which several earlier scans decide, not only the last one, and difference of log
odds at which that one suffices for the coarse correction."""
USUAL_SHARE, USUAL_LEAST_M = 0.1, 0.02
"""Scale of the differences between consecutive steps, as a fraction of the step and constant."""
LIKELIER = 3.0
"""Minimum log odds of a correction."""
FREE_M, FREE = 0.3, 0.01
"""A motion along a wall is undetermined if the beams agree almost as well at this distance."""
AWAY_M = np.array([-1.0, -0.8, -0.6, -0.45, -0.3, 0.3, 0.45, 0.6, 0.8, 1.0])
EXCLUDED, LEAST_SHARE = 6.0, 0.01
"""It is determined, too, if the beams of the last scans exclude these distances: by such log odds,
and such a fraction of the points that agree better, as many tiny differences along a bare corridor
are not independent."""
TINY_SHARE = 0.0025
"""Such a fraction below which they do not displace the usual step."""
USUAL_WEIGHT = 2.0
"""Weight of the usual step there: in a corridor few points are where others would be, by chance."""
STOPS, STOPS_VARY = 0.5, 4.0
"""A robot stops if a step is shorter than usual by this fraction, and multiple of the variation."""
TURNING_M = 1.0
"""Change of the step for each radian by which the rotation changes: robots turn slowly."""


class ScanComparison:
    """A scan compared with tracks and earlier scans.

    `beams`: beams of the same scan; `views`: the last scans, latest first, at most `VERIFYING`;
    `before`: recent motion of the robot; `expected`: motion expected from odometry; `firm`: whether
    to leave out walls and beams on small free-standing objects; `more`: the scans before `views`;
    `varies_m`: returns the variation of the last steps.
    """

    def __init__(
        self,
        tracks: PlaneTracks,
        seen: PlaneObservation,
        beams: Beams,
        views: Sequence[View],
        before: Floats,
        expected: Expected | None = None,
        firm: bool = True,
        more: Iterable[View] = (),
        varies_m: Callable[[], float] = float,
    ) -> None:
        self._beams, self._views, self._more = beams, views, more
        self._varies_m = varies_m
        self._recent, self._usual = before, expected.motion if expected else before
        self._expected, self._firm = expected, firm
        kept, own = ~(tracks.loose & firm), ~(seen.loose & firm)
        self._rows, self._walls = kept.nonzero()[0], own.nonzero()[0]
        self._tracks = tracks if len(self._rows) == len(tracks) else tracks.kept(kept)
        self._seen = seen if len(self._walls) == len(seen) else seen.only(own)

    @property
    def _deciding(self) -> list[View]:
        """The last scan, and those by which a motion along a wall is corrected."""
        return [*self._views[:1], *self._nearby]

    @cached_property
    def _nearby(self) -> list[View]:
        """The earlier scans by which a motion along a wall is corrected."""
        last = (*self._views[1:], *self._more)
        return [v for v in last if np.hypot(*v.motion[1:]) <= NEARBY_M]

    @property
    def _is_empty(self) -> bool:
        """Whether there is nothing to compare."""
        return not min(len(self._tracks), len(self._seen), len(self._beams))

    def _named(self, match: Match) -> Match:
        """Return a match with the numbers of all tracks and walls."""
        return Match(self._rows[match.tracks], self._walls[match.walls], match.score)

    def _counted(
        self, motions: Floats, near_m: float = NEAR_M, step: int = 0, view: View | None = None
    ) -> Floats:
        """Return the number of points of the scan and an earlier one that agree etc. (k, 4).

        See `relmap.planes.scans.beams.compared`; by default of the last one, and some `JUDGES`.
        """
        view, step = view or self._views[0], step or 1 + len(self._beams) // JUDGES
        return compared(view.beams, self._beams, view.then(motions), near_m, step, self._firm)

    def _judged(self, guesses: Sequence[Floats] | Floats, rounds: int = ROUNDS) -> Judged:
        """Fit motions to the walls that match in some rounds, and compare the beams."""
        tracks, seen = self._tracks, self._seen
        motions, matches = settled(tracks, seen, guesses, rounds)
        sums = np.array([self._counted(motions, view=view) for view in self._views])
        total = sums.sum(axis=2)
        agree = (sums[..., 0] / np.maximum(total, 1.0)).max(axis=0)
        contradict = sums[..., 1].sum(axis=0) / np.maximum(total.sum(axis=0), 1.0)
        score = np.array([match.score / self._possible for match in matches])
        return Judged(motions, agree, contradict, score, self._surprise(motions), matches)

    def _surprise(self, motions: Floats) -> Floats:
        """Return the prior improbability of motions (k, 3): log odds.

        By odometry, if there is any; but it may be wrong, and the robot go on as before.
        """
        surprise = _unusual(motions, self._usual)
        if self._expected is None:
            return surprise
        likelier = np.minimum(surprise, _unusual(motions, self._recent))
        return likelier - self._expected.supports(motions)

    @cached_property
    def _possible(self) -> float:
        """The maximum score of the walls, at least 1."""
        every = np.ones(len(self._tracks), dtype=np.bool_)
        return max(min(worth(self._tracks, self._seen, every)), 1.0)

    def _slid(self, judged: Judged, k: int) -> Judged:
        """Return a motion slid along the longest wall to the best agreement of beams."""
        if not len(judged.matches[k].walls):
            return self._judged([])
        n = int(REACH_M / SLIDE_M)
        way_m = SLIDE_M * np.arange(-n, n + 1.0)
        motions, value = self._along(judged, k, way_m)
        inner = value[1:-1]
        peaks = 1 + np.flatnonzero((inner >= value[:-2]) & (inner > value[2:]))
        peaks = peaks[np.argsort(-value[peaks], kind="stable")][:PEAKS]
        motions = motions[peaks[np.abs(way_m[peaks]) > SLIDE_M / 2]]
        return self._judged(motions)

    def _steady(self, one: Judged) -> Judged:
        """Return an undetermined motion at the likeliest place along the longest wall.

        Beams and the usual step decide: any place where a few points happen to agree would be
        taken otherwise. Steps vary as the last ones did, and more where the rotation changes.
        """
        motion, match = one.motions[0], one.matches[0]
        usual_m = self._usual_m(motion, match)
        turn = abs(float(wrapped(motion[0] - self._usual[0])))
        scale_m = self._scale_m + self._varies_m() + TURNING_M * turn
        way_m = np.append(COARSE_M, usual_m + COARSE_M)
        odds = self._clear_odds(motion, self._moved(motion, match, way_m))
        way_m = _likeliest(odds, way_m, usual_m, scale_m, USUAL_WEIGHT)[0] + FINE_M
        odds = self._clear_odds(motion, self._moved(motion, match, way_m))
        best_m, _ = _likeliest(odds, way_m, usual_m, scale_m, USUAL_WEIGHT)
        return self._judged(self._moved(motion, match, np.array([best_m])), 0)

    def _clear_odds(self, motion: Floats, motions: Floats) -> Floats:
        """Return the log odds of motions (k, 3) relative to one (3,), 0 for tiny differences."""
        odds, share = self._compared(self._deciding, motions, motion)
        return np.where(np.abs(share) < TINY_SHARE, 0.0, odds)

    def _usual_m(self, motion: Floats, match: Match) -> float:
        """Return the distance of the usual step from a motion (3,) along the longest wall."""
        return float((self._usual[1:] - motion[1:]) @ self._along_longest(match))

    @property
    def _scale_m(self) -> float:
        """Scale of the differences between consecutive steps."""
        return USUAL_SHARE * float(np.hypot(*self._usual[1:])) + USUAL_LEAST_M

    def _corrected(self, judged: Judged, k: int, far: bool = True) -> Judged:
        """Return a motion, moved along the longest wall if that is clearly likelier.

        Ends of walls seen at a grazing angle pull a fit to walls along them, and in a corridor
        nothing else may determine the motion. So where few walls cross, the beams and the usual
        step decide. With `far`, the usual step may lie out of the range of the search.
        """
        motion, match = judged.motions[k], judged.matches[k]
        crossing = self._crossing(match)
        if crossing >= CROSSINGS:
            return judged.only(k)
        usual_m = self._usual_m(motion, match)
        way_m = np.append(COARSE_M, usual_m) if far else COARSE_M
        views = list(self._views[:1])
        if crossing < PARALLEL and self._expected is None:
            views += self._nearby
        odds = self._odds(views[:1], self._moved(motion, match, way_m), motion)
        if len(views) > 1 and odds.max() - np.median(odds) < CERTAIN:
            odds = self._odds(views, self._moved(motion, match, way_m), motion)
        way_m = _likeliest(odds, way_m, usual_m, self._scale_m)[0] + FINE_M
        odds = self._odds(views, self._moved(motion, match, way_m), motion)
        best_m, best = _likeliest(odds, way_m, usual_m, self._scale_m)
        if best < LIKELIER:
            return judged.only(k)
        return self._judged(self._moved(motion, match, np.array([best_m])), 0)

    def _odds(self, views: Sequence[View], motions: Floats, motion: Floats) -> Floats:
        """Return the log odds of motions (k, 3) relative to one (3,), by the beams.

        Beams hit the same places of a wall again where the robot seems to stand still; the longer
        the way from an earlier scan, the less that matters.
        """
        return self._compared(views, motions, motion)[0]

    def _compared(
        self, views: Sequence[View], motions: Floats, motion: Floats
    ) -> tuple[Floats, Floats]:
        """Return the same, and the difference in agreement as a fraction of the points; (k,)."""
        both = np.vstack([motion[None], motions])
        pairs = [(view.beams, self._beams, view.then(both)) for view in views]
        return odds_over(pairs, self._firm)

    def _measured(self, judged: Judged, k: int) -> bool:
        """Return whether beams agree less if a motion is slid along the longest wall."""
        if not len(judged.matches[k].walls):
            return False
        value = self._along(judged, k, FREE_M * np.array([-1.0, 0.0, 1.0]))[1]
        if max(value[0], value[2]) < value[1] - FREE and not self._stops(judged, k):
            return True
        away = self._moved(judged.motions[k], judged.matches[k], AWAY_M)
        return bool(self._excluded(away, judged.motions[k]).all())

    def _stops(self, judged: Judged, k: int) -> bool:
        """Return whether a motion stops a moving robot between parallel walls.

        Beams seem to hit the same places there, wherever the robot is.
        """
        usual_m = float(np.hypot(*self._recent[1:]))
        slower_m = usual_m - float(np.hypot(*judged.motions[k, 1:]))
        if slower_m <= STOPS * usual_m or slower_m <= STOPS_VARY * self._varies_m():
            return False
        return bool(self._crossing(judged.matches[k]) < CROSSING)

    def _excluded(self, motions: Floats, motion: Floats) -> Bools:
        """Return which motions (k, 3) the beams of the last scans exclude in favour of one (3,)."""
        odds, share = self._compared(self._deciding, motions, motion)
        return np.asarray((odds < -EXCLUDED) & (share < -LEAST_SHARE))

    def _preferred(self, views: Sequence[View], motions: Floats) -> tuple[int, Floats]:
        """Return which motion (k, 3) beams prefer, and the log odds (k,) relative to it."""
        return preferred(motions, lambda one: self._odds(views, motions, one))

    def _along(self, judged: Judged, k: int, way_m: Floats) -> tuple[Floats, Floats]:
        """Return a motion slid along the longest wall that matches, and the agreement of beams."""
        motions = self._moved(judged.motions[k], judged.matches[k], way_m)
        sums = self._counted(motions, SLIDE_NEAR_M, SLIDE_STEP)
        in_view = np.maximum(sums[:, :3].sum(axis=1), 1.0)
        return motions, (sums[:, 0] - CONTRADICTING * sums[:, 1]) / in_view

    def _moved(self, motion: Floats, match: Match, way_m: Floats) -> Floats:
        """Return a motion (3,) moved along the longest wall that matches by distances (k,)."""
        x, y = self._along_longest(match)
        motions = np.empty((len(way_m), 3))
        motions[:, 0] = motion[0]
        motions[:, 1], motions[:, 2] = motion[1] + way_m * x, motion[2] + way_m * y
        return motions

    def _along_longest(self, match: Match) -> Floats:
        """Return the direction (2,) of the longest wall that matches; zero if there is none."""
        if not len(match.walls):
            return np.zeros(2)
        return np.asarray(self._seen.along[match.walls[np.argmax(self._seen.size[match.walls])]])

    def _crossing(self, match: Match) -> float:
        """Return the spread of the directions of the walls that match; 0 if they are parallel."""
        return float(spread(self._seen.along[match.walls], np.zeros_like(match.walls), 1)[0])


def _likeliest(
    odds: Floats, way_m: Floats, usual_m: float, scale_m: float, weight: float = 1.0
) -> tuple[float, float]:
    """Return the likeliest of some shifts (k,) along the longest wall, and its log odds.

    Compared with no shift, by the odds (k,) of the beams; `usual_m` leads to the usual step, from
    which others differ by about `scale_m`; `weight`: of its log odds.
    """
    usual = np.log1p((usual_m / scale_m) ** 2) - np.log1p(((way_m - usual_m) / scale_m) ** 2)
    both = odds + weight * usual
    at = int(np.argmax(both))
    return float(way_m[at]), float(both[at])


def _unusual(motions: Floats, usual: Floats) -> Floats:
    """Return the log odds against motions (k, 3) where another one (3,) is usual."""
    way = np.hypot(*(motions[:, 1:] - usual[1:]).T) / USUAL_M
    turn = wrapped(motions[:, 0] - usual[0]) / USUAL_RAD
    return np.asarray((way**2 + turn**2) / 2)
