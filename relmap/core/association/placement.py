"""Where one iteration's robot frame lies in the next: found from landmarks that agree.

A set of matches between two iterations is right where the mutual distances, and in space the
handedness, agree: where one rigid placement brings all of them together.  No pose, map or earlier
motion is asked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TRIMMING_ROUNDS = 8
MOST_STEPS = 2000
"""Steps of the search for a largest set of matches: a tenth of a second at 900 candidates."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A rigid motion from the robot frame of one iteration into that of another.

    Attributes
    ----------
    R : (d, d) float64
    t : (d,) float64, metres
    n_agreeing : int
        Matches that it brings together.
    """

    R: NDArray[np.float64]
    t: NDArray[np.float64]
    n_agreeing: int

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bring points (n, d) into the other frame."""
        return points @ self.R.T + self.t


def trimmed_fit(
    source: NDArray[np.float64], target: NDArray[np.float64], tolerance_m: float
) -> Placement | None:
    """Fit matches that are mostly right, leaving out those that disagree.

    Least squares over all, then over those nearer than one and a half times the median error, and
    so on until only matches within the tolerance are left.

    Parameters
    ----------
    source, target : (n, d) float64, metres
    tolerance_m : float

    Returns
    -------
    Placement or None
        None where fewer than d matches are left.
    """
    from relmap.core.geometry.fitting_kernels import trimmed_fit_rows

    R, t, n_agreeing = trimmed_fit_rows(source, target, tolerance_m, TRIMMING_ROUNDS)
    return Placement(R, t, n_agreeing) if n_agreeing >= 0 else None


def agreeing_pairs(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    pairs: NDArray[np.int64],
    tolerance_m: float,
) -> NDArray[np.int64]:
    """Return the largest set of candidate matches whose mutual distances agree.

    It is a largest clique of the graph of the candidates, in which two are neighbours where they
    agree (Bailey et al., 2000).  Where the search takes too long it is the largest that was found.

    Parameters
    ----------
    source : (n, d) float64, metres
    target : (m, d) float64, metres
    pairs : (p, 2) int64
        Candidates: row of `source`, row of `target`.
    tolerance_m : float
        Largest difference of two distances that agree.

    Returns
    -------
    (k,) int64
        Rows of `pairs`, ascending.
    """
    from relmap.core.association.clique_kernels import agreeing, largest_clique

    a, b = pairs.T
    return largest_clique(agreeing(source[a], target[b], a, b, tolerance_m), MOST_STEPS)
