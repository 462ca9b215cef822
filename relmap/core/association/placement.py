"""The placement of one frame in another, from landmarks with consistent relative locations.

A set of matches is consistent if the mutual distances, and in space the handedness, agree: if one
rigid placement brings all of them together. No pose, map or earlier motion is used. Scan
registration, re-observation, place recognition and joining of submaps differ only in the candidate
matches; this module finds the largest consistent set, its placement and its rivals.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints

DISTINCT = 0.8
"""Fraction of the matches of the best placement that a rival may have."""
MOST_STEPS = 2000
"""Maximum steps of the search for a largest set of matches: 0.1 s at 900 candidates."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A rigid motion from the robot frame of one iteration to that of another.

    `R` (d, d); `t` (d,), metres; `n_agreeing`: number of matches that it brings together.
    """

    R: Floats
    t: Floats
    n_agreeing: int

    def apply(self, points: Floats) -> Floats:
        """Transform points (n, d) into the other frame."""
        return points @ self.R.T + self.t


def trimmed_fit(
    source: Floats, target: Floats, tolerance_m: float, metric: Floats | None = None
) -> Placement | None:
    """Fit matches that are mostly correct, leaving out inconsistent ones.

    Least squares over all matches, then over those with less than 1.5 times the median error,
    repeated until only matches within the tolerance are left.

    `source`, `target` (n, d), metres; `metric` (n, d, d): of the targets: misfits and the tolerance
    are in its units. Returns None if fewer than d matches are left.
    """
    if len(source) < source.shape[1]:
        return None
    if metric is None:
        import relmap.core.geometry.fitting_kernels as fitting

        R, t, n_agreeing = fitting.trimmed_fit_rows(source, target, tolerance_m)
    else:
        import relmap.core.geometry.weighted_kernels as weighted

        R, t, n_agreeing = weighted.weighted_fit_rows(source, target, tolerance_m, metric)
    return Placement(R, t, n_agreeing) if n_agreeing >= 0 else None


def consistent_set(source: Floats, target: Floats, pairs: Ints, tolerance_m: float) -> Ints:
    """Return the largest set of candidate matches whose mutual distances agree.

    This is a maximum clique of the graph of candidates, with edges between candidates that agree
    (Bailey et al., 2000). If the search takes too long, the largest clique found so far is
    returned.

    `source` (n, d), metres; `target` (m, d), metres; `pairs` (p, 2): candidates: row of `source`,
    row of `target`; `tolerance_m`: largest difference between two distances that agree. Returns
    (k,): rows of `pairs`, ascending.
    """
    import relmap.core.association.clique_kernels as kernels

    a, b = np.ascontiguousarray(pairs.T)
    return kernels.largest_clique(
        kernels.agreeing(source[a], target[b], a, b, tolerance_m), MOST_STEPS
    )


def consistent_placements(
    source: Floats, target: Floats, pairs: Ints, tolerance_m: float
) -> Iterator[tuple[Placement, Ints]]:
    """Yield the placement of the largest consistent set of candidates, then its rivals.

    Each rival is the placement of the largest consistent set among the candidates not explained by
    the earlier ones.

    `source` (n, d), metres; `target` (m, d), metres; `pairs` (p, 2): candidates: row of `source`,
    row of `target`; `tolerance_m`: largest difference between two distances that agree, and largest
    distance between the points of a match after placement. Yields `matches` (k, 2): the pairs of
    the set, in the order given.
    """
    while len(pairs):
        chosen = consistent_set(source, target, pairs, tolerance_m)
        here, there = source[pairs[:, 0]], target[pairs[:, 1]]
        placement = trimmed_fit(here[chosen], there[chosen], tolerance_m)
        if placement is None:
            return
        yield placement, pairs[chosen]
        rest = np.linalg.norm(placement.apply(here) - there, axis=1) > tolerance_m
        rest[chosen] = False
        pairs = pairs[rest]
