"""Places of a landmark that change gradually: motion, whereas noise is independent."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints

SURELY = 3.0
"""Standard deviations by which a variance must differ from another to count as different."""


def drifting(landmark: Ints, places: Floats, m: int) -> Bools:
    """Return which landmarks (m,) are seen at places that change gradually.

    The squared steps from one observation to the next are on average twice the variance if the
    places scatter independently, and much less if a landmark moves (von Neumann, 1941).

    `landmark` (n,): 0 to m - 1. `places` (n, d), metres: of the observations in the order of time;
    NaN where unknown.
    """
    found = np.zeros(m, dtype=bool)
    for one, rows in by_landmark(landmark, places):
        n, d = len(rows), places.shape[1]
        if n < 3:
            continue
        steps = np.sum(np.diff(places[rows], axis=0) ** 2) / (n - 1)
        variance = np.sum((places[rows] - places[rows].mean(axis=0)) ** 2) / (n - 1)
        deviation = np.sqrt((n - 2) / ((n**2 - 1) * d))
        found[one] = steps / 2 < (1 - SURELY * deviation) * variance
    return found


def by_landmark(landmark: Ints, places: Floats) -> list[tuple[int, Ints]]:
    """Return each landmark with its placed observations, in order."""
    known = np.flatnonzero(np.isfinite(places[:, 0]))
    known = known[np.argsort(landmark[known], kind="stable")]
    own, first = np.unique(landmark[known], return_index=True)
    return list(zip(own.tolist(), np.split(known, first[1:]), strict=False))
