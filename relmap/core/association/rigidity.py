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

PLENTY = 6
"""Landmarks in common that a scan is judged by at least."""
SAMPLE = 32
"""Landmarks that a placement is fitted to at most."""
UNLIKE = 12.0
"""Middle misfit, in units of the usual one, above which a scan is rejected.

Up to 8 was found in real logs; a mirrored scan of the figure eight has 24 and more."""
CLEAR, FIRST = 0.02, 0.05
"""The same as a share of the extent of the scan, below which nothing is rejected; and below which
nothing is where it is not known yet what is usual."""
FAR = 0.02
"""How far from where it should be an observation may be, as a share of that extent."""
SLOWNESS = 0.1
"""Share of the latest scan in the usual misfit."""
DOUBT = 2.0
"""What each rejection raises the limit by until a scan fits: the noise may have grown instead."""
CARRIED = 5
"""Scans for which a landmark that is not seen is carried along."""
WARY, MOST_WARY = 10, 60
"""Scans in which two observations stray before a new landmark must be seen twice to be believed,
and most that this lasts."""


@dataclass(eq=False)
class _Places:
    """Where landmarks are in the frame of one scan.

    ``ids`` (n,) int64 ascend; ``points`` (n, d), robot frame, metres; ``missed`` (n,) int64 scans
    since each was seen.
    """

    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    missed: NDArray[np.int64]


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
    ) -> NDArray[np.bool_] | None:
        """Tell which observations can be right.

        Parameters
        ----------
        ids : (n,) int64
            All different.
        points_robot : (n, d) float64, metres

        Returns
        -------
        (n,) bool or None
            None where the scan is rejected as a whole.
        """
        from relmap.core.association.rigidity_kernels import extent_of

        self._extent_m = extent_of(points_robot)
        order = np.argsort(ids)
        scan = _Places(ids[order], points_robot[order], np.zeros(len(ids), dtype=np.int64))
        good = np.ones(len(ids), dtype=bool)
        fit = self._fit(self._last, scan)
        if fit is None:
            if self._last is None or len(ids) >= PLENTY:
                self._begin_with(scan)
            return good
        if fit.usual_m > self._limit_m():
            return good if self._fits_the_doubted(scan) else None
        self._learn(fit.usual_m)
        far = self._far(fit, scan)
        self._wary = min(max(self._wary - 1, 0) + WARY * len(far), MOST_WARY)
        if self._wary > WARY:
            good[:] = False
            good[order[fit.shared]] = True
        if len(far):
            good[order[fit.shared[far]]] = False
        self._go_on(fit, scan, far)
        return good

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

    def _go_on(self, fit: _Fit, scan: _Places, far: NDArray[np.int64]) -> None:
        """Make this the last scan; what is not in it is carried along into its frame."""
        from relmap.core.association.rigidity_kernels import carry

        assert self._last is not None
        last, self._strayed = self._last, None
        if len(far):
            rows = fit.shared[far]
            self._strayed = _Places(scan.ids[rows], scan.points[rows], scan.missed[rows])
            scan.points[rows] = fit.apply(last.points[fit.rows[far]])
        carried = carry(
            last.ids, last.points, last.missed, scan.ids, scan.points, fit.R, fit.t, CARRIED
        )
        self._last = _Places(*carried)
