"""What a run with odometry or with known noise keeps beside the observation store."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from relmap.core.arrays import Floats, Ints

if TYPE_CHECKING:
    from relmap.core.mapper import RelativeMapper


def keep_motion(engine: RelativeMapper, odometry: Floats | None) -> None:
    """Keep the odometry (4, 4) into the next scan, if any, before the scan is registered."""
    iteration = engine.store.n_iterations
    if odometry is not None and not len(engine.motions) and not engine.model.keeps_observations:
        _keep_stored(engine, iteration)  # The first motion comes from the scan before.
    engine.motions.append(odometry, iteration)


def keep_observations(
    engine: RelativeMapper, found: Ints, seen: Any, covariances: Floats | None
) -> None:
    """Keep what refinement needs of each observation of the scan that was stored last.

    `found` (n,): their landmarks; the others as given to `RelativeMapper.update`.
    """
    iteration, named = engine.store.n_iterations - 1, found >= 0
    if covariances is not None:
        engine.weighed.append(found[named], seen[named], covariances[named], iteration)
    else:
        engine.association.current.weigh_own(found, seen, iteration, engine.weighed)
    if len(engine.motions) and named.any() and not engine.model.keeps_observations:
        engine.kept.append(found[named], seen[named], iteration)


def _keep_stored(engine: RelativeMapper, end: int) -> None:
    """Keep the observations of the stored iterations before `end`."""
    for i in range(engine.store.first_iteration, end):
        landmarks = engine.store.column("landmark")[engine.store.rows(i)]  # Before merging.
        if len(landmarks):
            engine.kept.append(landmarks, engine.store.points(i, i + 1), i)
