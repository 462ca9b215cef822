"""Joint refinement of all submaps of a map."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.metric import UNEQUAL
from relmap.core.gaps import bridge_gaps, is_bridged
from relmap.core.keeping import weigh_by_estimate
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.assignment.reassigning import reassign
from relmap.core.refinement.chain.weighed import refine_weighed
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.joint import refine as refine_jointly
from relmap.core.refinement.observations import observations_of
from relmap.core.refinement.powers import refine_by_powers
from relmap.core.state.table import NONE


def refine_map(engine: RelativeMapper, to_the_last: bool = True) -> None:
    """Refine the map; `to_the_last`, as for `refine_submaps`, is for the last time."""
    if bridge_gaps(engine, to_the_last):
        return
    weigh_by_estimate(engine)
    engine.refined = refine_submaps(engine, engine.rows, to_the_last)


def ambiguous(engine: RelativeMapper) -> tuple[Floats, Ints, Ints, Floats | None] | None:
    """Return points, landmarks and iterations of all observations where matches are ambiguous.

    Also their covariances, if any; without those of landmarks that move. None if the noise is
    small.
    """
    kept, table = engine.kept, engine.table
    if not (engine.association.current.is_blurred and len(kept)):
        return None
    seen = table.now(kept.landmark)
    static = ~table.dynamic[seen]
    covariances = kept.covariance[static] if len(kept.covariance) else None
    return kept.location[static], seen[static], kept.iteration[static], covariances


def is_unequal(engine: RelativeMapper) -> bool:
    """Return whether observations are weighted by unequal noise, estimated or given.

    Given noise weights the chain of odometry, where there is one.
    """
    covariance, estimates = engine.kept.covariance, engine.association.current.estimates_covariances
    if estimates or is_bridged(engine) or not len(covariance):
        return estimates
    variances = np.linalg.eigvalsh(covariance)
    return bool(variances.max() >= UNEQUAL**2 * variances.min())


def refine_submaps(
    engine: RelativeMapper, rows: SegmentRows, to_the_last: bool = False
) -> list[Refined]:
    """Move all landmarks to the joint optimum; return the refined submaps, in order.

    `to_the_last`: whether single observations are used, where they are kept: for ambiguous matches
    and bounded noise.
    """
    table, kept = engine.table, engine.store
    of, submaps = table.landmark_of, table.submap
    others = (submaps == NONE) & ~table.dynamic
    rays = engine.association.current.estimated
    estimated = rays.covariances if rays is not None and rays.weighs else None
    has_all = to_the_last and engine.config.keep_observations
    found, end = [], kept.n_iterations
    for submap in sorted(table.submaps):
        chosen, since = submaps == submap, engine.map.kept_anchor
        is_known = bool(engine.association.is_known)
        refined = refine_jointly(rows, table.position, chosen, of, others, since, is_known)
        weighed = len(engine.kept.covariance) > 0
        if refined is not None and weighed:
            refined = refine_weighed(refined, engine.kept, of, estimated, is_known)
        seen = ambiguous(engine) if to_the_last else None
        if refined is not None and seen is not None:
            refined = reassign(refined, *seen)
        elif refined is not None and has_all and not weighed:
            points, (shown, when) = kept.points(0, end), kept.seen(0, end)
            own = refined.landmarks, refined.positions
            refined = refine_by_powers(refined, observations_of(points, of[shown], when, *own)[0])
        if refined is not None:
            # What no segment ties to the others would keep its place in the former frame.
            table.take_off_map(np.setdiff1d(np.flatnonzero(chosen), refined.landmarks))
            engine.map.move(refined.landmarks, refined.positions)
            found.append(refined)
    return found
