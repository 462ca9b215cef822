"""What a run with odometry or with known noise keeps beside the observation store."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.refinement.condensing import seen_from_first

if TYPE_CHECKING:
    from relmap.core.mapper import RelativeMapper


def keep_motion(engine: RelativeMapper, odometry: Floats | None) -> None:
    """Keep the odometry (4, 4) into the next scan, if any, before the scan is registered."""
    if odometry is not None and not len(engine.motions) and not engine.model.keeps_observations:
        _keep_earlier(engine)
    engine.motions.append(odometry, engine.store.n_iterations)


def keep_observations(
    engine: RelativeMapper, found: Ints, seen: Any, covariances: Floats | None
) -> None:
    """Keep what refinement needs of each observation of the scan that was stored last.

    `found` (n,): their landmarks; the others as given to `RelativeMapper.update`.
    """
    iteration, named = engine.store.n_iterations - 1, found >= 0
    estimated = engine.association.current.estimated
    if covariances is not None:
        engine.weighed.append(found[named], seen[named], covariances[named], iteration)
    elif estimated is not None:
        estimated.weigh(found, seen, iteration, engine.weighed)
    if len(engine.motions) and named.any() and not engine.model.keeps_observations:
        engine.kept.append(found[named], seen[named], iteration)


def _keep_earlier(engine: RelativeMapper) -> None:
    """Keep the observations of all iterations before the first odometry.

    Of the forgotten ones the condensed segments are kept, each as a scan that the first of its
    iterations made: otherwise the landmarks seen only before would not be in the map.
    """
    weighed, kept = engine.weighed, engine.kept
    if len(weighed) and not engine.association.current.estimates_covariances:
        ones = np.ones(len(weighed))
        kept.begin_with(weighed.landmark, weighed.location, weighed.iteration, ones)
        return
    condensed = engine.segments.rows
    if len(condensed.landmark):
        kept.begin_with(*seen_from_first(condensed))
    for i in range(engine.store.first_iteration, engine.store.n_iterations):
        landmarks = engine.store.column("landmark")[engine.store.rows(i)]  # Before merging.
        if len(landmarks):
            kept.append(landmarks, engine.store.points(i, i + 1), i)
