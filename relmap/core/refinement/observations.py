"""The single observations of the refined landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.refinement.rows import numbered


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations of some landmarks, in iterations that these determine.

    `points` (n, d), robot frame, metres; `landmark` (n,): 0 to m - 1; `iteration` (n,), ascending:
    0 to k - 1; `iterations` (k,): iteration numbers in the run.
    """

    points: Floats
    landmark: Ints
    iteration: Ints
    iterations: Ints

    @property
    def begin(self) -> Ints:
        """First row of each iteration, and the end of the last; (k + 1,)."""
        return np.searchsorted(self.iteration, np.arange(len(self.iterations) + 1))

    def placed_on(self, positions: Floats) -> tuple[Floats, Floats, Bools]:
        """Return the pose of each iteration that best fits landmarks (m, d).

        Returns `R` (k, d, d), `t` (k, d) and `fixed` (k,): whether the observations determine it.
        """
        there, unit = positions[self.landmark], np.ones(len(self.points))
        return fit_rigid_each(self.points, there, unit, self.iteration, len(self.iterations))


def observations_of(
    points: Floats, seen: Ints, when: Ints, landmarks: Ints, positions: Floats
) -> tuple[Observations, Ints]:
    """Return the observations of landmarks (m,) at positions (m, d), and their rows (k,).

    `points` (n, d), robot frame, metres: all observations; `seen` (n,): landmark of each
    observation, after merging; `when` (n,), ascending: iteration of each observation; `landmarks`
    (m,), ascending; `positions` (m, d), metres.
    """
    at = np.searchsorted(landmarks, seen).clip(0, len(landmarks) - 1)
    rows = np.flatnonzero(landmarks[at] == seen)
    every = _observations(points[rows], at[rows], when[rows])
    fixed = every.placed_on(positions)[2][every.iteration]
    rows = rows[fixed]
    return _observations(points[rows], at[rows], when[rows]), rows


def _observations(points: Floats, landmark: Ints, when: Ints) -> Observations:
    iterations, iteration = numbered(when)
    return Observations(points, landmark, iteration, iterations)
