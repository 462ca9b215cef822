"""Distances in units of the noise, which differs by direction and by distance from the sensor.

Radar, stereo cameras and bearing sensors measure one direction many times better than another, and
distant landmarks worse than near ones. The gate of data association is then an ellipse rather than
a circle (Bar-Shalom and Fortmann, "Tracking and Data Association", 1988).  The noise is that of the
covariances that come with a scan, or else it is estimated from the residuals of matches.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import middle

EVERY, SETTLED = 4, 150
"""Interval of updates, in scans, and number of first scans that are all used."""
RARELY = 16
"""Interval of updates, in scans, while the noise is isotropic and constant."""
ENOUGH, RECENT = 200, 400
"""Minimum number of residuals for an estimate, and number of the latest ones that it rests on."""
MEMORY = 8
"""Maximum number of observations averaged into a prediction."""
UNEQUAL = 2.0
"""Ratio of standard deviations below which the noise counts as isotropic and constant."""
WORST = 10.0
"""Largest standard deviation, relative to that of the median point: beyond it a point would be the
nearest to every track."""
NEGLIGIBLE = 1e-4
"""Noise, relative to the distance, that is too small to matter to association."""
CHI2_MEDIAN = 0.455
"""Median of the square of a standard normal."""
OUTLIER = 16.0
"""Largest squared residual, in variances: a larger one is a wrong match."""
LEAST = 1e-4
"""Minimum variance, relative to the largest coefficient."""
TINY = 1e-100
"""Minimum variance of a fit: divided by it, no term overflows where residuals are 0."""
TYPICAL = (0.1, 0.9)
"""Quantiles of the distance between which the noise is compared."""
TERMS = 3
"""Coefficients of the variance, a polynomial in the squared distance."""
SETS = np.array([*product([0.0, 1.0], repeat=TERMS)][1:])
"""Sets (s, t) of coefficients that may be above 0: 1 for each."""
PAIRS = SETS[:, :, None] * SETS[:, None]
"""Which entries of the moments a set needs (s, t, t)."""
RIDGE = 1e-12
"""Keeps a system of terms that are proportional to each other solvable."""
BELOW = 0.7
"""Largest ratio of the smallest standard deviation to that of static landmarks, if unequal."""
ROUNDS = 3
"""Rounds of reweighting the residuals by their variances."""
WAIT = 1000
"""Observations before it is decided whether the noise is unequal."""
LONGEST = 20 * WAIT
"""Observations after which the noise counts as equal if scans are too small to estimate it."""


class RayNoise:
    """The variance of matches along and across the ray as a function of the distance.

    Each is ``c0 + c1 r^2 + c2 r^4`` with nonnegative coefficients: constant range noise is the
    first term, bearing noise the second, the depth noise of a stereo camera the third.

    `given` (n, d, d): covariances of the current scan, robot frame, square metres; they replace the
    estimate. `is_unequal`: whether the noise differs by direction or distance; None before it is
    known. `weighs`: whether the refinement weights observations by the estimate; None before it
    is decided, once and for all.
    """

    is_unequal: bool | None
    weighs: bool | None
    STATE = "_squares _n_scans _coefficients _unit_m is_unequal weighs"

    def __init__(self) -> None:
        self.given: Floats | None = None
        self._squares = np.empty((0, 3))  # distance; squared residual along and across the ray
        self._n_scans = 0
        self._coefficients = np.zeros((2, TERMS))
        self._unit_m = 0.0
        self.is_unequal = self.weighs = None

    def is_due(self) -> bool:
        """Count a scan; return whether `learn` should be called with it."""
        self._n_scans += 1
        often = EVERY if self._n_scans > SETTLED else 1
        return self._n_scans % (RARELY if self.is_unequal is False else often) == 0

    def learn(self, expected: Floats, found: Floats, n_seen: Ints) -> None:
        """Update the estimate from static landmarks.

        `expected`, `found` (n, d), robot frame, metres: predicted and observed; `n_seen` (n,):
        observations before.
        """
        squares = _residuals(expected, found, n_seen)
        self._unit_m = self._unit_m or float(squares[:, 0].max())
        self._squares = np.concatenate([self._squares, squares])[-RECENT:]
        if len(self._squares) >= ENOUGH and self._unit_m > 0:
            self._update()
            sigma = self._typical()
            is_negligible = sigma.max() < NEGLIGIBLE * self._unit_m
            self.is_unequal = bool(sigma.max() >= UNEQUAL * sigma.min() and not is_negligible)

    def _update(self) -> None:
        """Fit the coefficients to the residuals, weighted by the variances of the fit before."""
        terms, squares = self._terms(self._squares[:, 0]), self._squares.T[1:]
        typical = np.array([[middle(of)] for of in squares]) / CHI2_MEDIAN
        least = np.maximum(LEAST * typical, TINY)
        for _ in range(ROUNDS):
            is_known = self._coefficients.any(axis=1, keepdims=True)
            floor = np.where(is_known, least, typical + least)
            variance = np.maximum(self._coefficients @ terms.T, floor)
            clipped = np.minimum(squares, OUTLIER * variance)
            self._coefficients = nonnegative(terms / variance[:, :, None], clipped / variance)

    def metric(self, points: Floats) -> Floats | None:
        """Return the metric at the points of the current scan; None if the noise is isotropic.

        `points` (n, d), robot frame, metres. Returns (n, d, d): symmetric matrices that scale
        differences such that their noise is isotropic and the same at each point, with a mean log
        determinant of 0.
        """
        if not len(points):
            return None
        if self.given is not None:
            values, vectors = np.linalg.eigh(self.given)
            farthest_m = np.linalg.norm(points, axis=1).max()
            sigma = np.maximum(np.sqrt(values), NEGLIGIBLE * farthest_m)
            if sigma.max() < UNEQUAL * sigma.min():
                return None
        elif self.is_unequal:
            sigma, vectors = self._estimated(points)
        else:
            return None
        sigma = np.minimum(sigma, WORST * middle(sigma.max(axis=1)))
        scale = np.exp(np.mean(np.log(sigma))) / sigma
        return np.asarray((vectors * scale[:, None]) @ np.swapaxes(vectors, 1, 2))

    def decide(self, n_observations: int, noise_m: float) -> None:
        """Decide after enough observations whether they are weighted by the estimate.

        Where many landmarks move, their motion may pass for unequal noise; then even the smallest
        estimate is not below the noise of static landmarks, `noise_m`; NaN if unknown.
        """
        enough = LONGEST if self.is_unequal is None else WAIT
        if self.weighs is None and n_observations >= enough:
            self.weighs = bool(self.is_unequal) and not self._typical().min() > BELOW * noise_m

    def _typical(self) -> Floats:
        """Return standard deviations (2, 2) along and across the ray, near and far."""
        ordered = np.sort(self._squares[:, 0])  # `numpy.quantile` takes ten times as long
        at = np.array(TYPICAL) * (len(ordered) - 1)
        return self._sigmas(np.interp(at, np.arange(len(ordered)), ordered))

    def covariances(self, points: Floats) -> Floats:
        """Return estimated covariances (n, d, d) of points (n, d), robot frame, square metres."""
        sigma, vectors = self._estimated(points)
        return np.asarray((vectors * sigma[:, None] ** 2) @ np.swapaxes(vectors, 1, 2))

    def _estimated(self, points: Floats) -> tuple[Floats, Floats]:
        """Return standard deviations (n, d) and directions (n, d, d), in columns, of the noise."""
        d = points.shape[1]
        distance = np.linalg.norm(points, axis=1)
        ray = points / np.maximum(distance, 1e-12)[:, None]
        outer = ray[:, :, None] * ray[:, None]
        vectors = np.linalg.eigh(-outer)[1]  # the ray comes first
        return self._sigmas(distance)[:, [0] + [1] * (d - 1)], vectors

    def _sigmas(self, distance: Floats) -> Floats:
        """Return standard deviations (n, 2) along and across the ray at distances (n,), metres."""
        variances = self._terms(distance) @ self._coefficients.T
        return np.asarray(np.sqrt(np.maximum(variances, LEAST * self._coefficients.max() + 1e-300)))

    def _terms(self, distance: Floats) -> Floats:
        """Return the powers (n, t) of squared distances of which the variance is a sum."""
        square = (distance / self._unit_m) ** 2
        return np.column_stack([np.ones(len(square)), square, square**2])


def _residuals(expected: Floats, found: Floats, n_seen: Ints) -> Floats:
    """Return the distance (n, 3) of each point, metres, and its squared residuals.

    Along and across the ray, of one observation: the prediction averages those before.
    """
    distance = np.linalg.norm(found, axis=1)
    off = (expected - found) / np.sqrt(1 + 1 / np.minimum(n_seen, MEMORY))[:, None]
    along = np.sum(off * found, axis=1) / np.maximum(distance, 1e-12)
    across = np.maximum(np.sum(off**2, axis=1) - along**2, 0.0) / (found.shape[1] - 1)
    return np.column_stack([distance, along**2, across])


def nonnegative(terms: Floats, values: Floats) -> Floats:
    """Return the coefficients (k, t), 0 or more, of terms (k, n, t) nearest to values (k, n).

    Least squares with each set of coefficients above 0; 1e-300 serves terms that are 0.
    """
    moments, right = np.swapaxes(terms, 1, 2) @ terms, values[:, None] @ terms
    unit = np.eye(TERMS)
    moments += unit * (RIDGE * moments + 1e-300)
    matrices = PAIRS * moments[:, None] + unit * (1 - PAIRS)
    found = np.linalg.solve(matrices, (SETS * right)[..., None])[..., 0]
    gains = np.where(found.min(axis=2) >= 0, np.sum(found * right, axis=2), -1.0)
    return np.asarray(found[np.arange(len(found)), gains.argmax(axis=1)])


def rows_of(metric: Floats | None, rows: Ints) -> Floats | None:
    """Return some rows of a metric (n, d, d); None if there is none."""
    return None if metric is None else metric[rows]


def farthest(reach: float, metric: Floats | None) -> float:
    """Return the largest distance within a reach in units of a metric (n, d, d), metres."""
    return reach if metric is None else reach / float(np.linalg.eigvalsh(metric)[:, 0].min())


def scaled(metric: Floats | None, differences: Floats) -> Floats:
    """Return differences (n, d) in units of a metric (n, d, d); unchanged without one."""
    if metric is None:
        return differences
    return np.asarray(np.einsum("nij,nj->ni", metric, differences))
