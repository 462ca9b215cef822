"""Landmarks of a refined map that coincide: the same one, mapped twice."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from relmap.core.arrays import Ints
from relmap.core.association.revisits import TOLERANCE
from relmap.core.refinement.condensing import LENGTH
from relmap.core.state.table import NONE, LandmarkState

APART = 2.5
"""Least distance of any other landmark, relative to that of landmarks that are merged in place."""


def lying_together(table: LandmarkState, noise_m: float) -> Ints:
    """Return pairs (k, 2) of a newer and an older landmark that coincide.

    All others are much farther from both.

    Parameters
    ----------
    table : LandmarkState
        Of a refined map.
    noise_m : float
        Standard deviation of an observed coordinate.
    """
    own = np.flatnonzero(table.submap != NONE)
    reach_m = TOLERANCE * noise_m
    tree = cKDTree(table.position[own])
    here, there = tree.query_pairs(APART * reach_m, output_type="ndarray").reshape(-1, 2).T
    alike = table.submap[own[here]] == table.submap[own[there]]
    here, there = here[alike], there[alike]
    near = np.linalg.norm(table.position[own[here]] - table.position[own[there]], axis=1) <= reach_m
    n = len(own)
    graph = coo_array((np.ones(near.sum()), (here[near], there[near])), shape=(n, n))
    place = connected_components(graph, directed=False)[1]
    crowded = np.zeros(n, dtype=bool)
    other = np.column_stack([place[here[~near]], place[there[~near]]])
    crowded[other[other[:, 0] != other[:, 1]].ravel()] = True
    order = np.lexsort((own, table.first[own], place))
    oldest = order[np.unique(place[order], return_index=True)[1]][place]
    newer = (np.arange(n) != oldest) & ~crowded[place]
    pairs: Ints = np.column_stack([own, own[oldest]])[newer]
    return pairs


def seen_with_both(pairs: Ints, landmark: Ints, iteration: Ints, m: int) -> Ints:
    """Return the number of landmarks seen at about the time of each of a pair (k, 2); (k,).

    Parameters
    ----------
    pairs : (k, 2) int64
    landmark, iteration : (n,) int64
        Of all observations.
    m : int
        Number of landmarks.
    """
    when = iteration // LENGTH
    ones = np.ones(len(landmark), dtype=np.int32)
    seen = coo_array((ones, (landmark, when)), shape=(m, int(when.max(initial=0)) + 1)).tocsr()
    seen.data[:] = 1
    with_new, with_old = (((seen[of] @ seen.T) > 0).astype(np.int32) for of in pairs.T)
    return np.asarray(with_new.multiply(with_old).sum(axis=1), dtype=np.int64).ravel()
