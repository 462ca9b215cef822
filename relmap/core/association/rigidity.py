"""Consistency check of scans with known ids: their constellations must agree.

Static landmarks keep their relative locations, so one rotation and translation, never a reflection,
brings most of them from the last scan to this one. A scan without such a motion, for example one
that is mirrored or has shuffled ids, is rejected; a single observation far from its prediction is
left out until it occurs twice. The usual misfit between scans is estimated from the scans, and so
is the noise by direction and distance; no map and no pose is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import UNIDENTIFIED, middle
from relmap.core.association.metric import RayNoise, scaled
from relmap.core.association.placement import trimmed_fit
from relmap.core.geometry.alignment import extent_of

PLENTY = 6
"""Minimum number of common landmarks to judge a scan."""
SAMPLE = 32
"""Maximum number of landmarks used to fit a placement."""
UNLIKE = 12.0
"""Median misfit, in units of the usual one, above which a scan is rejected. Values up to 8 occur in
real logs; a mirrored scan of the figure eight has 24 or more."""
CLEAR, FIRST = 0.02, 0.05
"""The same as a fraction of the extent of the scan, below which nothing is rejected; and the limit
while the usual misfit is unknown."""
FAR = 0.02
"""Largest distance of an observation from its prediction, as a fraction of that extent."""
SLOWNESS = 0.1
"""Weight of the latest scan in the usual misfit."""
DOUBT = 2.0
"""Factor by which each rejection raises the limit until a scan fits: the noise may have grown."""
MOST_DOUBTED = 1000
"""Number of rejections from which it stays: with more the factor overflows."""
CARRIED = 5
"""Scans for which a missed landmark is still predicted."""
WARY, MOST_WARY = 10, 60
"""Scans for which an inconsistent observation makes new ids doubtful, and the maximum total."""
SURE = 3
"""Observations a landmark needs before the observation of another id is assigned to it."""
WITHIN = 4.0
"""Misfit, in units of the median, up to which landmarks determine a placement by unequal noise."""
NEAR, ALONE = 4.0, 2.0
"""Misfit, in units of the usual one, up to which an observation is assigned to the landmark
expected there; and the minimum ratio of the distance to any other landmark."""


@dataclass(eq=False)
class _Places:
    """Positions of landmarks in the frame of one scan.

    ``ids`` (n,) int64 ascend; ``points`` (n, d), robot frame, metres; ``missed`` (n,) int64 scans
    since each was seen; ``times`` (n,) int64 number of observations, under the given id.
    """

    ids: Ints
    points: Floats
    missed: Ints
    times: Ints

    @classmethod
    def begun(cls, ids: Ints, points: Floats) -> _Places:
        """Return the places of a single scan."""
        return cls(ids, points, np.zeros_like(ids), np.ones_like(ids))

    @property
    def parts(self) -> tuple[Ints, Floats, Ints, Ints]:
        """The arrays in the order used by the kernels."""
        return self.ids, self.points, self.missed, self.times


class _Scan(NamedTuple):
    """The landmarks of a scan: ids (n,), ascending, and points (n, d), robot frame, metres."""

    ids: Ints
    points: Floats


class _Fit(NamedTuple):
    """Places aligned to a scan: rows of both (k,), R and t, misfits (k,), their median and maximum.

    In metres; if too few agree there are no misfits, and the last two are infinite.
    """

    rows: Ints
    shared: Ints
    R: Floats
    t: Floats
    misfit_m: Floats
    usual_m: float
    largest_m: float

    def apply(self, points: Floats) -> Floats:
        """Transform points (n, d) into the frame of the scan."""
        return points @ self.R.T + self.t


class Rigidity:
    """Checks scans with known ids, one after the other.

    `rays`: noise of the observations as a function of direction and distance.
    """

    _last: _Places | None
    _doubted: _Places | None
    _strayed: _Places | None
    _usual_m: float | None
    STATE = "rays _last _doubted _strayed _usual_m _n_doubted _wary _extent_m"

    def __init__(self) -> None:
        self.rays = RayNoise()
        self._last = self._doubted = self._strayed = None
        self._usual_m = None
        self._n_doubted = 0
        self._wary = 0
        self._extent_m = 0.0

    def checked(self, ids: Ints, points_robot: Floats) -> Ints | None:
        """Return the landmarks of the observations.

        `ids` (n,): all different; `points_robot` (n, d), metres. Returns (n,): the ids, replaced
        where inconsistent, or `UNIDENTIFIED`; None if the whole scan is rejected.
        """
        scan, fit = self._fit(self._last, ids, points_robot)
        if fit is None:
            if self._last is None or len(ids) >= PLENTY:
                self._begin_with(scan)
            return ids
        if fit.usual_m > self._limit_m():
            return ids if self._fits_the_doubted(scan) else None
        self._learn(fit.usual_m)
        far = self._far(fit, scan)
        if self.rays.given is None and self.rays.is_due():
            self._learn_rays(fit, scan)
        self._wary = min(max(self._wary - 1, 0) + WARY * len(far), MOST_WARY)
        if not len(far) and not self._wary:
            self._carry(fit, *scan)
            return ids
        named = self._named(fit, scan, far)
        self._go_on(fit, scan, far, named)
        checked = np.empty_like(ids)
        checked[np.argsort(ids)] = named
        return checked

    def _named(self, fit: _Fit, scan: _Scan, far: Ints) -> Ints:
        """Return the ids (n,) of a scan, doubtful ones replaced by the landmarks expected there.

        Doubtful are observations far from their prediction and, after such observations, new ids.
        """
        assert self._last is not None
        last, named = self._last, scan.ids.copy()
        named[fit.shared[far]] = UNIDENTIFIED
        doubtful = named == UNIDENTIFIED
        if self._wary:
            doubtful |= ~np.isin(scan.ids, last.ids)
        free = last.times >= SURE
        free[np.delete(fit.rows, far)] = False
        rows, candidates = np.flatnonzero(doubtful), np.flatnonzero(free)
        if not len(rows) or not len(candidates):
            return named
        expected = fit.apply(last.points[candidates])
        apart = np.linalg.norm(scan.points[rows][:, None] - expected, axis=2)
        reach_m = NEAR * self._usual() * (1 + last.missed[candidates])
        for k, distances in enumerate(apart):
            nearest = int(np.argmin(distances))
            others = np.append(np.delete(distances, nearest), np.inf).min()
            own = distances[nearest] <= reach_m[nearest] and others > ALONE * reach_m[nearest]
            if own and apart[:, nearest].argmin() == k:
                named[rows[k]] = last.ids[candidates[nearest]]
        return named

    def _fit(self, places: _Places | None, ids: Ints, points: Floats) -> tuple[_Scan, _Fit | None]:
        """Align places to a scan; None if they have too few landmarks in common.

        `ids` (n,) and `points` (n, d) of the scan are returned in ascending order.
        """
        import relmap.core.association.rigidity_kernels as kernels

        order = ids.argsort(kind="stable")  # the fastest if they ascend already
        if places is None or len(ids) < PLENTY:
            self._extent_m = extent_of(points)
            return _Scan(ids[order], points[order]), None
        # The least tolerance, metres, and relative to the extent of the scan.
        least_m, share = 0.0, 2 * (FIRST / UNLIKE)
        if self._usual_m is not None:
            least_m, share = 2 * self._usual_m, CLEAR / UNLIKE
        limits = PLENTY, SAMPLE, least_m, share
        found = kernels.fitted(places.ids, places.points, ids, points, order, limits)
        self._extent_m = found[2]
        return _Scan(*found[:2]), _Fit(*found[3:]) if len(found[3]) else None

    def _usual(self) -> float:
        """Return the usual median misfit, metres."""
        return FIRST / UNLIKE * self._extent_m if self._usual_m is None else self._usual_m

    def _limit_m(self) -> float:
        """Return the median misfit up to which a scan is accepted."""
        in_doubt = UNLIKE * self._usual() * DOUBT ** min(self._n_doubted, MOST_DOUBTED)
        return max(in_doubt, CLEAR * self._extent_m)

    def _fits_the_doubted(self, scan: _Scan) -> bool:
        """Return whether a scan fits the one just rejected: then the earlier scans were wrong."""
        _, fit = self._fit(self._doubted, *scan)
        if fit is not None and fit.usual_m <= self._limit_m():
            self._begin_with(scan)
            return True
        self._doubted = _Places.begun(*scan)
        self._n_doubted += 1
        return False

    def _begin_with(self, scan: _Scan) -> None:
        self._last, self._n_doubted = _Places.begun(*scan), 0
        self._doubted = self._strayed = None

    def _learn(self, usual_m: float) -> None:
        if self._usual_m is None:
            self._usual_m = usual_m
        self._usual_m += SLOWNESS * (usual_m - self._usual_m)
        self._doubted, self._n_doubted = None, 0

    def _learn_rays(self, fit: _Fit, scan: _Scan) -> None:
        """Update the noise by direction from the landmarks of a fit that the last scan showed.

        Where it is unequal, it weights them: the noise of the placement would pass for theirs.
        """
        assert self._last is not None
        fresh = self._last.missed[fit.rows] == 0
        before, found = self._last.points[fit.rows[fresh]], scan.points[fit.shared[fresh]]
        expected, metric = fit.apply(before), self.rays.metric(found)
        if metric is not None:
            off = np.linalg.norm(scaled(metric, expected - found), axis=1)
            placement = trimmed_fit(before, found, WITHIN * middle(off), metric)
            expected = expected if placement is None else placement.apply(before)
        self.rays.learn(expected, found, np.ones(len(found), dtype=np.int64))

    def _far(self, fit: _Fit, scan: _Scan) -> Ints:
        """Return the pairs of a fit that are inconsistent for the first time.

        A landmark found twice at the same new position has moved there.
        """
        assert self._last is not None
        gate_m = max(UNLIKE * self._usual(), FAR * self._extent_m)
        if fit.largest_m <= gate_m:
            return np.empty(0, dtype=np.int64)
        # While ids are doubtful, a wide gate would accept a misread one far from its landmark.
        missed = self._last.missed[fit.rows] * (self._wary == 0)
        far = np.flatnonzero(fit.misfit_m > gate_m * (1 + missed))
        if self._strayed is None:
            return far
        ids = scan.ids[fit.shared[far]]
        at = np.searchsorted(self._strayed.ids, ids).clip(0, len(self._strayed.ids) - 1)
        there = fit.apply(self._strayed.points[at]) - scan.points[fit.shared[far]]
        gone = (self._strayed.ids[at] == ids) & (np.linalg.norm(there, axis=1) <= gate_m)
        return np.asarray(far[~gone])

    def _go_on(self, fit: _Fit, scan: _Scan, far: Ints, named: Ints) -> None:
        """Store this as the last scan, with final ids; other landmarks are predicted in it."""
        rows = fit.shared[far]
        rows = rows[named[rows] == UNIDENTIFIED]
        good = np.flatnonzero(named != UNIDENTIFIED)
        good = good[np.argsort(named[good])]
        self._carry(fit, named[good], scan.points[good])
        if len(rows):
            self._strayed = _Places.begun(scan.ids[rows], scan.points[rows])
        renamed = named[good][named[good] != scan.ids[good]]
        assert self._last is not None
        self._last.times[np.searchsorted(self._last.ids, renamed)] -= 1

    def _carry(self, fit: _Fit, ids: Ints, points: Floats) -> None:
        """Make landmarks of a scan, ids ascending, the last; others are predicted in its frame."""
        import relmap.core.association.rigidity_kernels as kernels

        assert self._last is not None
        self._last = _Places(*kernels.carry(self._last.parts, ids, points, fit.R, fit.t, CARRIED))
        self._strayed = None
