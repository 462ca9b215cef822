"""What a run with odometry, or with unequal noise, keeps beside the observation store."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from relmap.core.arrays import Floats, Ints, positions_of
from relmap.core.refinement.condensing import seen_from_first
from relmap.core.state.kept import KeptObservations

if TYPE_CHECKING:
    from relmap.core.mapper import RelativeMapper


def keep_motion(engine: RelativeMapper, odometry: Floats | None) -> None:
    """Keep the odometry (4, 4) into the next scan, if any, before the scan is registered."""
    begins = odometry is not None and not len(engine.motions) and not len(engine.kept)
    if begins and not engine.model.keeps_observations:
        _keep_earlier(engine)
    engine.motions.append(odometry, engine.store.n_iterations)


def keep_observations(
    engine: RelativeMapper, found: Ints, seen: Any, covariances: Floats | None
) -> None:
    """Keep what refinement needs of each observation of the scan that was stored last.

    The first scans are kept until it is known whether the noise is unequal; all are where it makes
    matches ambiguous.

    `found` (n,): their landmarks; the others as given to `RelativeMapper.update`.
    """
    if engine.model.keeps_observations:
        return
    moves = len(engine.motions) > 0
    rays = engine.association.current.estimated if covariances is None else None
    weighs = False if rays is None else rays.weighs  # None while it is not known
    if not (moves or weighs is not False or covariances is not None or len(engine.kept)):
        return
    named = found >= 0
    if not named.any():
        return
    if rays is not None and weighs:
        covariances = rays.covariances(seen)
    noise = None if covariances is None else covariances[named]
    engine.kept.append(found[named], seen[named], engine.store.n_iterations - 1, noise)
    if rays is not None and weighs is None:
        rays.decide(len(engine.kept), engine.averaging.noise.sigma_m)
        weigh_by_estimate(engine)
        if rays.weighs is False and not moves and not engine.association.current.is_blurred:
            engine.kept = KeptObservations()


def weigh_by_estimate(engine: RelativeMapper) -> None:
    """Weight the kept observations by the noise as estimated now, if it is unequal."""
    rays = engine.association.current.estimated
    if rays is not None and rays.weighs:
        engine.kept.weigh(rays.covariances(engine.kept.location))


def variances_of(engine: RelativeMapper, landmarks: Ints, begin: int) -> Floats | None:
    """Return the mean variance (k,) of a coordinate of landmarks (k,) seen from an iteration on.

    Square metres; None if observations are unweighted.
    """
    kept = engine.kept
    if not len(kept.covariance):
        return None
    rows = slice(int(np.searchsorted(kept.iteration, begin)), len(kept))
    covariances = kept.covariance[rows]
    at = positions_of(landmarks, engine.table.now(kept.landmark[rows]))
    own = at >= 0
    each = np.trace(covariances[own], axis1=1, axis2=2) / covariances.shape[1]
    counts, total = (np.bincount(at[own], by, len(landmarks)) for by in (None, each))
    return np.asarray(total / np.maximum(counts, 1))


def _keep_earlier(engine: RelativeMapper) -> None:
    """Keep the observations of all iterations before the first odometry.

    Of the forgotten ones the condensed segments are kept, each as a scan that the first of its
    iterations made: otherwise the landmarks seen only before would not be in the map.
    """
    kept, condensed = engine.kept, engine.segments.rows
    if len(condensed.landmark):
        landmark, location, iteration, count = seen_from_first(condensed)
        kept.append(landmark, location, iteration, count=count)
    for i in range(engine.store.first_iteration, engine.store.n_iterations):
        landmarks = engine.store.column("landmark")[engine.store.rows(i)]  # Before merging.
        if len(landmarks):
            kept.append(landmarks, engine.store.points(i, i + 1), i)
