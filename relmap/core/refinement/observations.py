"""Every single observation of a run, as far as its landmarks are refined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.refinement.rows import numbered


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations of some landmarks, by iterations that these fix.

    Attributes
    ----------
    points : (n, d) float64, robot frame, metres
    landmark : (n,) int64
        0 to m - 1.
    iteration : (n,) int64, ascending
        0 to k - 1.
    iterations : (k,) int64
        Their numbers in the run.
    """

    points: Floats
    landmark: Ints
    iteration: Ints
    iterations: Ints

    @property
    def begin(self) -> Ints:
        """Where the rows of each iteration begin, and where the last ends; (k + 1,)."""
        return np.searchsorted(self.iteration, np.arange(len(self.iterations) + 1))

    def placed_on(self, positions: Floats) -> tuple[Floats, Floats, Bools]:
        """Return the placement of each iteration that fits landmarks (m, d) best.

        Returns
        -------
        R : (k, d, d) float64
        t : (k, d) float64
        fixed : (k,) bool
            Whether what was seen fixes it.
        """
        there, unit = positions[self.landmark], np.ones(len(self.points))
        return fit_rigid_each(self.points, there, unit, self.iteration, len(self.iterations))


def observations_of(
    points: Floats, seen: Ints, when: Ints, landmarks: Ints, positions: Floats
) -> tuple[Observations, Ints]:
    """Return the observations of landmarks (m,) at positions (m, d), and which (k,) of all.

    Parameters
    ----------
    points : (n, d) float64, robot frame, metres
        All observations.
    seen : (n,) int64
        Of which landmark each is, after merging.
    when : (n,) int64, ascending
        In which iteration each was made.
    landmarks : (m,) int64, ascending
    positions : (m, d) float64, metres
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
