"""Where a refined map is bent: beams prefer a link between two scans to the step of the map."""

from __future__ import annotations

from itertools import product

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes.linking.adjoining import LEAST_SHARE, RIVAL, SIDE
from relmap.planes.motions import from_matrices, matrices
from relmap.planes.scans.beams import BeamStore, leads, log_odds
from relmap.planes.submaps.submap import WallSubmap, deviations
from relmap.planes.submaps.undetermined import beams_of
from relmap.planes.walls.history import PlaneHistory

FAR_M, FAR_RAD = 0.1, np.deg2rad(1.0)
"""Deviation of a step from its link above which it is examined."""


def bent_steps(submap: WallSubmap, history: PlaneHistory, beams: BeamStore) -> Ints:
    """Return the scans (t,) whose links beams prefer to the steps of a refined map into them.

    A short wall, or one that is taken for another, may turn a step by degrees, and all later scans
    with it. Two scans hardly show it: the beams of up to four scans before and four after the step
    are compared, as in `adjoining`, the later ones moved as a whole.
    """
    motions = history.motion[slice(*submap.span)]
    way_m, turn = deviations(submap.poses, motions)
    far = 1 + np.flatnonzero((way_m > FAR_M) | (turn > FAR_RAD))
    links = np.linalg.inv(matrices(motions[far]))
    changes = submap.poses[far - 1] @ links @ np.linalg.inv(submap.poses[far])
    bent = [
        _is_better(change, row, submap, history, beams)
        for row, change in zip(far.tolist(), changes, strict=True)
    ]
    return submap.first_iteration + far[np.array(bent, dtype=np.bool_)]


def _is_better(
    change: Floats, row: int, submap: WallSubmap, history: PlaneHistory, beams: BeamStore
) -> bool:
    """Return whether beams prefer a change (4, 4) of the map from the scan of a row on."""
    poses, first = submap.poses, submap.first_iteration
    known = np.flatnonzero(np.isfinite(poses[:, 0, 3]))
    at = int(np.searchsorted(known, row))
    near = known[max(at - SIDE, 0) : at + SIDE].tolist()
    seen = {k: one for k in near if len(one := beams_of(first + k, history, beams))}
    pairs = list(product([k for k in seen if k < row], [k for k in seen if k >= row]))
    if not pairs:
        return False
    i, j = np.array(pairs).T
    both = np.stack([poses[j], change @ poses[j]], axis=1)
    motions = from_matrices(np.linalg.inv(poses[i])[:, None] @ both)
    lead, variance, n = np.zeros(1), np.zeros(1), 0
    for (earlier, later), (kept, moved) in zip(pairs, motions, strict=True):
        own, sd = leads(seen[later], seen[earlier], moved[None], kept)
        lead, variance, n = lead + own, variance + sd**2, n + len(seen[earlier]) + len(seen[later])
    return bool(log_odds(lead, variance)[0] > RIVAL and lead[0] > LEAST_SHARE * n)
