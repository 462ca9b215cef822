"""Covariances of observations that come without any, where their noise turns out to be unequal."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.metric import RayNoise
from relmap.core.state.kept import WeighedObservations

WAIT = 1000
"""Observations before it is decided whether the noise is unequal."""
LONGEST = 20 * WAIT
"""Observations after which the noise counts as equal if scans are too small to estimate it."""


class EstimatedCovariances:
    """Weights observations by the estimated noise if that differs by direction or distance.

    The first scans wait until there are enough residuals to decide; if the noise is isotropic and
    constant, nothing is kept of them.
    """

    _is_unequal: bool | None
    STATE = "_waiting _is_unequal"

    def __init__(self) -> None:
        self._waiting = WeighedObservations()
        self._is_unequal = None

    @property
    def is_in_use(self) -> bool:
        """Whether the noise is unequal."""
        return bool(self._is_unequal)

    def weigh(
        self,
        landmarks: Ints,
        points: Floats,
        iteration: int,
        rays: RayNoise,
        weighed: WeighedObservations,
    ) -> None:
        """Add the observations of a scan to the weighted ones if the noise is unequal.

        `landmarks` (n,); `points` (n, d), robot frame, metres.
        """
        if self._is_unequal:
            weighed.append(landmarks, points, rays.covariances(points), iteration)
        elif self._is_unequal is None and len(points):
            unknown = np.zeros((*points.shape, points.shape[1]))
            self._waiting.append(landmarks, points, unknown, iteration)
            if len(self._waiting) >= (LONGEST if rays.is_unequal is None else WAIT):
                self._decide(rays, weighed)

    def weigh_again(self, rays: RayNoise, weighed: WeighedObservations) -> None:
        """Replace the covariances by those that are estimated now, from more residuals."""
        if self._is_unequal:
            weighed.covariance[:] = rays.covariances(weighed.location)

    def _decide(self, rays: RayNoise, weighed: WeighedObservations) -> None:
        waiting, self._waiting = self._waiting, WeighedObservations()
        self._is_unequal = bool(rays.is_unequal)
        if not self._is_unequal:
            return
        covariances = rays.covariances(waiting.location)
        for iteration in np.unique(waiting.iteration).tolist():
            rows = waiting.iteration == iteration
            weighed.append(
                waiting.landmark[rows], waiting.location[rows], covariances[rows], iteration
            )
