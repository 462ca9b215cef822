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
    from relmap.core.kernels.fitting import trimmed_fit_rows

    R, t, n_agreeing = trimmed_fit_rows(source, target, tolerance_m, TRIMMING_ROUNDS)
    return Placement(R, t, n_agreeing) if n_agreeing >= 0 else None


def agreeing_pairs(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    pairs: NDArray[np.int64],
    tolerance_m: float,
    n_starts: int = 8,
) -> NDArray[np.int64]:
    """Grow the largest set of candidate matches whose mutual distances agree.

    From each of the pairs that agree with most others, the set takes in, greedily, the pair that
    agrees with most of the rest.

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
        Rows of `pairs`.
    """
    a, b = pairs.T
    agree = np.abs(_distances(source[a]) - _distances(target[b])) <= tolerance_m
    agree &= (a[:, None] != a) & (b[:, None] != b)
    starts = np.argsort(-agree.sum(axis=1), kind="stable")[:n_starts]
    return max((_grow(agree, int(start)) for start in starts), key=len)


def _grow(agree: NDArray[np.bool_], start: int) -> NDArray[np.int64]:
    members, open_ = [start], agree[start].copy()
    while open_.any():
        support = np.where(open_, agree[:, open_].sum(axis=1), -1)
        best = int(np.argmax(support))
        members.append(best)
        open_ &= agree[best]
    return np.array(members)


def _distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(points[:, None] - points, axis=2))
