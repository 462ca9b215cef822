"""Whether a landmark keeps its place in a solved map: scatter is noise, a trend is motion."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.refinement.extending import AGREEING, LEAST_STEADY, STEADY
from relmap.core.refinement.trend import by_landmark, drifting
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
