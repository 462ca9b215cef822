"""Where one frame lies in another: found from landmarks whose relative locations agree.

A set of matches is right where the mutual distances, and in space the handedness, agree: where one
rigid placement brings all of them together.  No pose, map or earlier motion is asked.  Registration
of scans, re-observation, recognition of a place and tying of submaps differ in the candidate
matches alone: the largest consistent set of them, its placement and its rivals are found here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints

DISTINCT = 0.8
"""Share of the matches of the best placement that a rival may have."""
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

    R: Floats
    t: Floats
    n_agreeing: int

    def apply(self, points: Floats) -> Floats:
        """Bring points (n, d) into the other frame."""
        return points @ self.R.T + self.t


def trimmed_fit(source: Floats, target: Floats, tolerance_m: float) -> Placement | None:
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

    R, t, n_agreeing = trimmed_fit_rows(source, target, tolerance_m)
    return Placement(R, t, n_agreeing) if n_agreeing >= 0 else None


def consistent_set(source: Floats, target: Floats, pairs: Ints, tolerance_m: float) -> Ints:
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

    a, b = np.ascontiguousarray(pairs.T)
    return largest_clique(agreeing(source[a], target[b], a, b, tolerance_m), MOST_STEPS)


def consistent_placements(
    source: Floats, target: Floats, pairs: Ints, tolerance_m: float, fit_m: float
) -> Iterator[tuple[Placement, Ints]]:
    """Yield the placement of the largest consistent set of candidates, and then its rivals.

    Each rival is that of the largest set of the candidates that no placement before explains.

    Parameters
    ----------
    source : (n, d) float64, metres
    target : (m, d) float64, metres
    pairs : (p, 2) int64
        Candidates: row of `source`, row of `target`.
    tolerance_m : float
        Largest difference of two distances that agree.
    fit_m : float
        How far apart the points of a match may lie once placed.

    Yields
    ------
    placement : Placement
    matches : (k, 2) int64
        The pairs of the set, in the order given.
    """
    while len(pairs):
        chosen = consistent_set(source, target, pairs, tolerance_m)
        here, there = source[pairs[:, 0]], target[pairs[:, 1]]
        placement = trimmed_fit(here[chosen], there[chosen], fit_m)
        if placement is None:
            return
        yield placement, pairs[chosen]
        rest = np.linalg.norm(placement.apply(here) - there, axis=1) > fit_m
        rest[chosen] = False
        pairs = pairs[rest]
