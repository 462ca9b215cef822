"""Joint refinement of all submaps of a map."""

from __future__ import annotations

import numpy as np

from relmap.core.gaps import bridge_gaps
from relmap.core.keeping import weigh_by_estimate
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.chain.weighed import refine_weighed
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.joint import refine as refine_jointly
from relmap.core.refinement.observations import observations_of
from relmap.core.refinement.powers import refine_by_powers
from relmap.core.state.store import ObservationStore
from relmap.core.state.table import NONE


def refine_map(engine: RelativeMapper, to_the_last: bool = True) -> None:
    """Refine the map, exploiting bounded noise if requested."""
    if bridge_gaps(engine, to_the_last):
        return
    kept = engine.store if to_the_last and engine.config.keep_observations else None
    weigh_by_estimate(engine)
    engine.refined = refine_submaps(engine, engine.rows, kept)


def refine_submaps(
    engine: RelativeMapper, rows: SegmentRows, kept: ObservationStore | None
) -> list[Refined]:
    """Move all landmarks to the joint optimum; return the refined submaps, in order.

    With every observation `kept`, bounded noise is exploited, unless observations have covariances.
    """
    table = engine.table
    of, submaps = table.landmark_of, table.submap
    others = (submaps == NONE) & ~table.dynamic
    found, end = [], 0 if kept is None else kept.n_iterations
    for submap in sorted(table.submaps):
        chosen, since = submaps == submap, engine.map.kept_anchor
        is_known = bool(engine.association.is_known)
        refined = refine_jointly(rows, table.position, chosen, of, others, since, is_known)
        if refined is not None and len(engine.kept.covariance):
            refined = refine_weighed(refined, engine.kept, of)
        elif refined is not None and kept is not None:
            points, (seen, when) = kept.points(0, end), kept.seen(0, end)
            own = refined.landmarks, refined.positions
            refined = refine_by_powers(refined, observations_of(points, of[seen], when, *own)[0])
        if refined is not None:
            # What no segment ties to the others would keep its place in the former frame.
            table.take_off_map(np.setdiff1d(np.flatnonzero(chosen), refined.landmarks))
            engine.map.move(refined.landmarks, refined.positions)
            found.append(refined)
    return found
