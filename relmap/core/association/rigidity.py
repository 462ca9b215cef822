"""Whether scans of known landmarks can be right: their constellations must fit one another.

An id says who was seen; where it was seen must agree with where the others were.  Landmarks at rest
keep their relative locations, so that one rotation and translation, never a reflection, brings most
of them from the last scan to this one.  A scan that none does, as one mirrored or mixed up, is
rejected; a single observation far from where it should be is left out until it comes twice.  How
far apart scans usually are is learnt from the scans; no map and no pose is asked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.association.base import UNIDENTIFIED

PLENTY = 6
"""Landmarks in common that a scan is judged by at least."""
SAMPLE = 32
"""Landmarks that a placement is fitted to at most."""
UNLIKE = 12.0
"""Middle misfit, in units of the usual one, above which a scan is rejected.

Up to 8 was found in real logs; a mirrored scan of the figure eight has 24 and more."""
CLEAR, FIRST = 0.02, 0.05
"""The same as a share of the extent of the scan, below which nothing is rejected; and below which
nothing is rejected while the usual misfit is not known."""
FAR = 0.02
"""How far from where it should be an observation may be, as a share of that extent."""
SLOWNESS = 0.1
"""Share of the latest scan in the usual misfit."""
DOUBT = 2.0
"""What each rejection raises the limit by until a scan fits: the noise may have grown instead."""
CARRIED = 5
"""Scans for which a landmark that is not seen is carried along."""
WARY, MOST_WARY = 10, 60
"""Scans for which an observation that strays makes new ids doubtful, and most that this lasts."""
SURE = 3
"""How often a landmark must have been seen before another's observation is taken for its own."""
NEAR, ALONE = 4.0, 2.0
"""Misfit, in units of the usual one, up to which an observation is that of a landmark expected
there; and how many times as far away any other must be."""


@dataclass(eq=False)
class _Places:
    """Where landmarks are in the frame of one scan.

    ``ids`` (n,) int64 ascend; ``points`` (n, d), robot frame, metres; ``missed`` (n,) int64 scans
    since each was seen; ``times`` (n,) int64 how often it was, under the id that was given.
    """

    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    missed: NDArray[np.int64]
    times: NDArray[np.int64]

    @classmethod
    def begun(cls, ids: NDArray[np.int64], points: NDArray[np.float64]) -> _Places:
        """Return those of a scan by itself."""
        return cls(ids, points, np.zeros_like(ids), np.ones_like(ids))

    @property
    def parts(
        self,
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """All of it, as the kernels take it."""
        return self.ids, self.points, self.missed, self.times


@dataclass(eq=False)
class _Fit:
    """Places laid on a scan: rows of both (k,), R and t, misfits (k,), the middle, the largest one.

    Metres; where too few agree there are no misfits, and these two are infinite.
    """

    rows: NDArray[np.int64]
    shared: NDArray[np.int64]
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    misfit_m: NDArray[np.float64]
    usual_m: float
    largest_m: float

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bring points (n, d) to where the scan has them."""
        return points @ self.R.T + self.t


class Rigidity:
    """Judges scans of known landmarks, one after the other."""

    _last: _Places | None
    _doubted: _Places | None
    _strayed: _Places | None
    _usual_m: float | None
    STATE = "_last _doubted _strayed _usual_m _n_doubted _wary _extent_m"

    def __init__(self) -> None:
        self._last = self._doubted = self._strayed = None
        self._usual_m = None
        self._n_doubted = 0
        self._wary = 0
        self._extent_m = 0.0

    def believed(
        self, ids: NDArray[np.int64], points_robot: NDArray[np.float64]
    ) -> NDArray[np.int64] | None:
        """Return the landmarks of the observations.

        Parameters
        ----------
        ids : (n,) int64
            All different.
        points_robot : (n, d) float64, metres

        Returns
        -------
        (n,) int64 or None
            The ids, others where these cannot be right, or `UNIDENTIFIED`; None where the scan is
            rejected as a whole.
        """
        from relmap.core.association.rigidity_kernels import extent_of

        self._extent_m = extent_of(points_robot)
        order = np.argsort(ids)
        scan = _Places.begun(ids[order], points_robot[order])
        fit = self._fit(self._last, scan)
        if fit is None:
            if self._last is None or len(ids) >= PLENTY:
                self._begin_with(scan)
            return ids
        if fit.usual_m > self._limit_m():
            return ids if self._fits_the_doubted(scan) else None
        self._learn(fit.usual_m)
        far = self._far(fit, scan)
        self._wary = min(max(self._wary - 1, 0) + WARY * len(far), MOST_WARY)
        if not len(far) and not self._wary:
            self._carry(fit, scan.ids, scan.points)
            return ids
        named = self._named(fit, scan, far)
        self._go_on(fit, scan, far, named)
        believed = np.empty_like(ids)
        believed[order] = named
        return believed

    def _named(self, fit: _Fit, scan: _Places, far: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the ids (n,) of a scan, those in doubt by the landmarks that are expected there.

        In doubt are observations far from where they should be, and of late also new ids.
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
        for row, distances in zip(rows.tolist(), apart, strict=True):
            nearest = int(np.argmin(distances))
            others = np.append(np.delete(distances, nearest), np.inf).min()
            own = distances[nearest] <= reach_m[nearest] and others > ALONE * reach_m[nearest]
            if own and distances[nearest] == apart[:, nearest].min():
                named[row] = last.ids[candidates[nearest]]
        return named

    def _fit(self, places: _Places | None, scan: _Places) -> _Fit | None:
        """Lay places on a scan; None where they have too few landmarks in common."""
        from relmap.core.association.rigidity_kernels import lay_on

        if places is None or len(scan.ids) < PLENTY:
            return None
        limits = (self._tolerance_m(), SAMPLE, PLENTY)
        fit = _Fit(*lay_on(places.ids, places.points, scan.ids, scan.points, limits))
        return fit if len(fit.rows) >= PLENTY else None

    def _usual(self) -> float:
        """Return the usual middle misfit, metres."""
        return FIRST / UNLIKE * self._extent_m if self._usual_m is None else self._usual_m

    def _tolerance_m(self) -> float:
        """Return the misfit up to which landmarks are fitted to."""
        return max(2 * self._usual(), CLEAR / UNLIKE * self._extent_m)

    def _gate_m(self) -> float:
        """Return the misfit from which a landmark is far from where it should be."""
        return max(UNLIKE * self._usual(), FAR * self._extent_m)

    def _limit_m(self) -> float:
        """Return the middle misfit up to which a scan is believed."""
        in_doubt = UNLIKE * self._usual() * DOUBT**self._n_doubted
        return max(in_doubt, CLEAR * self._extent_m)

    def _fits_the_doubted(self, scan: _Places) -> bool:
        """Tell whether a scan fits the one rejected just now: then the scans before were wrong."""
        fit = self._fit(self._doubted, scan)
        if fit is not None and fit.usual_m <= self._limit_m():
            self._begin_with(scan)
            return True
        self._doubted = scan
        self._n_doubted += 1
        return False

    def _begin_with(self, scan: _Places) -> None:
        self._last, self._doubted, self._strayed, self._n_doubted = scan, None, None, 0

    def _learn(self, usual_m: float) -> None:
        if self._usual_m is None:
            self._usual_m = usual_m
        self._usual_m += SLOWNESS * (usual_m - self._usual_m)
        self._doubted, self._n_doubted = None, 0

    def _far(self, fit: _Fit, scan: _Places) -> NDArray[np.int64]:
        """Return the pairs of a fit that are far apart for the first time.

        One that is where it strayed to in the scan before has gone there.
        """
        assert self._last is not None
        gate_m = self._gate_m()
        if fit.largest_m <= gate_m:
            return np.empty(0, dtype=np.int64)
        far = np.flatnonzero(fit.misfit_m > gate_m * (1 + self._last.missed[fit.rows]))
        if self._strayed is None:
            return far
        ids = scan.ids[fit.shared[far]]
        at = np.searchsorted(self._strayed.ids, ids).clip(0, len(self._strayed.ids) - 1)
        there = fit.apply(self._strayed.points[at]) - scan.points[fit.shared[far]]
        gone = (self._strayed.ids[at] == ids) & (np.linalg.norm(there, axis=1) <= gate_m)
        return np.asarray(far[~gone])

    def _go_on(
        self, fit: _Fit, scan: _Places, far: NDArray[np.int64], named: NDArray[np.int64]
    ) -> None:
        """Make this the last scan, as it is named now; the rest is carried along into its frame."""
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

    def _carry(self, fit: _Fit, ids: NDArray[np.int64], points: NDArray[np.float64]) -> None:
        """Make landmarks of a scan, ids ascending, the last; others are carried into its frame."""
        from relmap.core.association.rigidity_kernels import carry

        assert self._last is not None
        self._last = _Places(*carry(self._last.parts, ids, points, fit.R, fit.t, CARRIED))
        self._strayed = None
