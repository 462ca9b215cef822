"""Deforming a map to close a loop: an initial estimate for the refinement."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import expm, logm
from scipy.sparse.linalg import splu

from relmap.core.arrays import Floats, Ints
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SegmentRows

STIFF = 1e4
"""Weight of the loop constraints, in observations."""
SLACK = 1e-9
"""Weight of the prior on the current positions, which fixes the frame."""


def bend(global_map: GlobalMap, rows: SegmentRows, pairs: Ints, R: Floats, t: Floats) -> None:
    """Distribute the drift that a closed loop reveals over the part in between.

    Linear least squares on the logarithms of the motions of segments and landmarks: a segment and
    the landmarks that it saw should move alike.

    `pairs` (k, 2): landmarks, and the older ones they are identified with; `R` (d, d), `t` (d,):
    motion of the first landmark of each pair to the second.
    """
    table = global_map.table
    landmark = table.landmark_of[rows.landmark]
    on = table.submap[landmark] == table.submap[pairs[0, 0]]
    members, column = np.unique(landmark[on], return_inverse=True)
    m, n = len(members), len(members) + rows.n_segments
    seen, known = rows.n_seen[on].astype(np.float64), np.isin(pairs, members).all(axis=1)
    later, older = np.searchsorted(members, pairs[known]).T
    stiff = np.full(len(later), STIFF)
    one, other = np.append(column, later), np.append(m + rows.segment[on], older)
    weight = np.append(seen, stiff)
    coupling = sparse.coo_array((weight, (one, other)), shape=(n, n))
    coupling = coupling + coupling.T
    laplacian = sparse.diags_array(coupling.sum(axis=1) + SLACK) - coupling
    motion = np.eye(len(t) + 1)
    motion[:-1, :-1], motion[:-1, -1] = R, t
    twist = np.real(logm(motion))
    right = STIFF * (np.bincount(later, minlength=n) - np.bincount(older, minlength=n))
    share = splu(laplacian.tocsc()).solve(right)[:m]
    positions = table.position[members].copy()
    levels, of = np.unique(np.round(share, 3), return_inverse=True)
    moved = np.array([expm(level * twist) for level in levels])[of]
    positions = np.einsum("nij,nj->ni", moved[:, :-1, :-1], positions) + moved[:, :-1, -1]
    global_map.move(members, positions)
