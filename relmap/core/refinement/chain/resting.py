"""Whether a landmark keeps its place in a solved map: scatter is noise, a trend is motion."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.refinement.extending import AGREEING, LEAST_STEADY, STEADY
from relmap.core.refinement.joint import SURELY
from relmap.core.state.kept import KeptObservations


def placed_observations(kept: KeptObservations, poses: Floats) -> Floats:
    """Return the place (n, d) of each observation in the map, metres.

    `poses` (k, 4, 4): ``T_map_robot`` of each iteration; NaN where there is none.
    """
    d, own = kept.location.shape[1], poses[kept.iteration]
    return np.asarray(np.einsum("nij,nj->ni", own[:, :d, :d], kept.location) + own[:, :d, 3])


def scattered(landmark: Ints, places: Floats, m: int) -> Floats:
    """Return the typical distance of each landmark (m,) from its median place, metres; or NaN.

    `landmark` (n,): 0 to m - 1. `places` (n, d), metres: of the observations; NaN where unknown.
    """
    found = np.full(m, np.nan)
    for one, rows in by_landmark(landmark, places):
        off = np.linalg.norm(places[rows] - np.median(places[rows], axis=0), axis=1)
        found[one] = np.quantile(off, AGREEING)
    return found


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


def at_rest(landmark: Ints, places: Floats, static: Bools) -> Bools:
    """Return which landmarks (m,) keep their place as well as static ones do.

    They scatter as most do, or as the worst do and without a trend: landmarks are not equally
    noisy.

    `landmark`, `places`: as for `drifting`; `static` (m,): landmarks known to be static.
    """
    scatter = scattered(landmark, places, len(static))
    usual = scatter[static & np.isfinite(scatter)]
    if not len(usual):
        return np.zeros(len(static), dtype=bool)
    steady = scatter <= STEADY * float(np.median(usual))
    noisy = scatter <= STEADY * float(np.quantile(usual, LEAST_STEADY))
    return np.asarray(steady | (noisy & ~drifting(landmark, places, len(static))))


def by_landmark(landmark: Ints, places: Floats) -> list[tuple[int, Ints]]:
    """Return each landmark with its placed observations, in order."""
    known = np.flatnonzero(np.isfinite(places[:, 0]))
    known = known[np.argsort(landmark[known], kind="stable")]
    own, first = np.unique(landmark[known], return_index=True)
    return list(zip(own.tolist(), np.split(known, first[1:]), strict=False))
