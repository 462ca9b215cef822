"""How reliable the association of a map is: `association_trust` in ``summary.json``."""

from __future__ import annotations

from typing import Any

import numpy as np

from relmap.core.association.registering import BLIND
from relmap.core.readout import added_lengths, creep, gaps
from relmap.core.refinement.hinges import Hinges
from relmap.io.results import Result
from relmap.planes import PlaneMapper
from relmap.points import PointMapper

MANY = 100
"""Maximum number of iterations, observations and gaps listed individually."""
NOTED = 0.1
"""Least part of the expected squared error of a map due to a gap that is listed."""
OF_POINTS = ("contradicting", "seen_twice_at_most", "creep_m", "added_lengths")
BRIDGED, OF_HINGES = ("gaps", "longest_gap", "leaps"), ("expected_error_m", "hinges")
"""Of maps of points only."""


def trust_of(
    mapper: PointMapper | PlaneMapper, result: Result, n_observations: int, offset: int
) -> dict[str, Any]:
    """Return what speaks for and against the association of a map, JSON serialisable.

    `n_observations`: of the log; `offset`: log number of the mapper's first iteration.
    """
    trust = {
        "tied_scans": mapper.tied_share,
        "unique_scans": mapper.unique_share,
        "undone_merges": mapper.n_undone,
        "submaps": len(result.submaps),
    }
    if not isinstance(mapper, PointMapper):
        return trust | dict.fromkeys((*OF_POINTS, *BRIDGED, *OF_HINGES))
    seen = mapper.landmarks.observations
    seldom = float(seen[seen <= 2].sum() / max(seen.sum(), 1)) if len(seen) else None
    contradicting = _contradicting(mapper, n_observations)
    of_map = (contradicting, seldom, creep(mapper.engine), added_lengths(mapper.engine))
    trust |= dict(zip(OF_POINTS, of_map, strict=True))
    return trust | _bridged_by_look(mapper, result, offset)


def _bridged_by_look(mapper: PointMapper, result: Result, offset: int) -> dict[str, Any]:
    """Return the long gaps of a log that only places which look the same bridge, and the leaps.

    Also how much of the expected error of the map is due to its gaps. None with ids and with
    odometry.
    """
    assert result.iterations is not None
    found = gaps(mapper.engine, result.iterations - offset, result.poses[:, :3, 3])
    if found is None:
        return dict.fromkeys((*BRIDGED, *OF_HINGES))
    which, longest = found.leaps[:MANY], int(found.missed.max(initial=0))
    steps = np.column_stack([found.before, found.after])[which] + offset
    way_m = found.way_m[which].tolist()
    leaps = {"count": len(found.leaps), "steps": steps.tolist(), "way_m": way_m}
    n_gaps = int(np.sum(found.missed > BLIND))
    found_gaps = {"gaps": n_gaps, "longest_gap": longest, "leaps": leaps}
    return found_gaps | _hinges(mapper.engine.hinges, offset)


def _hinges(found: Hinges | None, offset: int) -> dict[str, Any]:
    """Return the expected error of a map, and which gaps it is due to; None if not known."""
    if found is None:
        return dict.fromkeys(OF_HINGES)
    own = np.flatnonzero(found.shares >= NOTED)[:MANY]
    steps = np.column_stack([found.before, found.after])[own] + offset
    hinges = {"share": found.share, "steps": steps.tolist(), "shares": found.shares[own].tolist()}
    return {"expected_error_m": found.expected_error_m, "hinges": hinges}


def _contradicting(mapper: PointMapper, n_observations: int) -> float | None:
    """Return the fraction of the observations that contradict their ids or the refined map.

    None for a map without ids that is not refined.
    """
    if not mapper.engine.association.is_known and not mapper.refined:
        return None
    n_wrong = len(mapper.rejected_observations) + sum(one.n_outliers for one in mapper.refined)
    # The mapper may have earlier logs, too; overruled observations may belong to no landmark.
    return n_wrong / max(n_observations, int(mapper.landmarks.observations.sum()), 1)
