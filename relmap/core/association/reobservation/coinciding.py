"""Landmarks of a refined map that coincide, or that are parts of one object: mapped twice.

An object that is rarely detected has many tracks of few observations, and one whose shape
differs from side to side has several landmarks next to each other.  No scan shows two of them.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import median_apart, nearest
from relmap.core.refinement.condensing import LENGTH
from relmap.core.scan import FARTHEST_M
from relmap.core.state.table import NONE, LandmarkState

TOLERANCE = 5.0
"""Largest distance between landmarks that coincide, in standard deviations of an observation."""
APART = 2.5
"""Minimum distance of any other landmark, relative to that of landmarks merged in place."""
SIGMAS, CLEAR_SIGMAS = 4.0, 10.0
"""Largest distance of one landmark mapped twice, and least of any other, in standard deviations."""
NEIGHBOURS = 2.0
"""Largest distance of any other that counts, in spacings."""
SHARE = 0.6
"""Fraction of coinciding landmarks that may also coincide with others after a shift."""
LEAST = 1e-9
"""Minimum variance relative to their sum."""
SPACING = 0.2
"""Largest distance between two landmarks of one object, in spacings of the landmarks: at random 3 %
of the landmarks in the plane have another one as close."""
DEVIATIONS = 12.5
"""The same in standard deviations of an observation: objects look different from each side."""


def lying_together(table: LandmarkState, noise_m: float) -> Ints:
    """Return pairs (k, 2) of a newer and an older landmark that coincide.

    All others are much farther from both.

    `table`: of a refined map; `noise_m`: standard deviation of an observed coordinate.
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


def neighbours_fit(
    new: Floats, old: Floats, others: Floats, reach_m: float, tolerance_m: float
) -> bool:
    """Return whether landmarks that coincide with older ones also fit neighbours of these.

    `new`, `old` (k, d), metres: positions of both; `others` (m, d), metres: those of all older
    ones; `reach_m`: possible drift; `tolerance_m`: largest distance of landmarks that coincide.
    """
    tree = cKDTree(others)
    for here, near in zip(old, tree.query_ball_point(old, min(reach_m, FARTHEST_M)), strict=True):
        shifts = others[near] - here
        shifts = shifts[np.linalg.norm(shifts, axis=1) > 2 * tolerance_m]
        apart = nearest(tree, (new + shifts[:, None]).reshape(-1, new.shape[1]))[0]
        fits = np.sum(apart.reshape(len(shifts), len(new)) <= tolerance_m, axis=1)
        if (fits > SHARE * len(new)).any():
            return True
    return False


def within(apart: Floats, covariance: Floats, sigmas: float) -> Bools:
    """Return which differences (k, d) are within a number of deviations of a covariance (d, d)."""
    squares = np.sum(apart * np.linalg.solve(covariance, apart.T).T, axis=1)
    return np.asarray(squares <= sigmas**2)


def compatible(positions: Floats, covariances: Floats) -> Ints:
    """Return pairs (k, 2) of rows that coincide within their covariances, and with no others.

    `positions` (n, d), metres: of a refined map; `covariances` (n, d, d), square metres: NaN where
    a position is undetermined.
    """
    spread = np.sqrt(np.maximum(np.trace(covariances, axis1=1, axis2=2), 0.0))
    known = np.flatnonzero(np.isfinite(spread) & (spread > 0))
    if len(known) < 3:
        return np.empty((0, 2), dtype=np.int64)
    at, own = positions[known], covariances[known]
    tree = cKDTree(at)
    spacing_m = median_apart(tree)
    reach_m = np.minimum(2 * CLEAR_SIGMAS * spread[known], NEIGHBOURS * spacing_m)
    near = [(i, j) for i, others in enumerate(tree.query_ball_point(at, reach_m)) for j in others]
    i, j = np.unique(np.sort(np.array(near), axis=1), axis=0).T
    i, j = i[i != j], j[i != j]
    apart = at[i] - at[j]
    regular = LEAST * np.eye(at.shape[1]) * (spread[known[i]] ** 2)[:, None, None]
    scaled = np.linalg.solve(own[i] + own[j] + regular, apart[:, :, None])[:, :, 0]
    square = np.sum(apart * scaled, axis=1)
    rivals = square <= CLEAR_SIGMAS**2
    alone = np.bincount(np.concatenate([i[rivals], j[rivals]]), minlength=len(at)) == 1
    found = (square <= SIGMAS**2) & alone[i] & alone[j]
    pairs: Ints = np.column_stack([known[i], known[j]])[found]
    return pairs


def seen_with_both(pairs: Ints, landmark: Ints, iteration: Ints, m: int) -> Ints:
    """Return the number of landmarks seen at about the time of each of a pair (k, 2); (k,).

    `pairs` (k, 2); `landmark`, `iteration` (n,): of all observations; `m`: number of landmarks.
    """
    when = iteration // LENGTH
    ones = np.ones(len(landmark), dtype=np.int32)
    seen = coo_array((ones, (landmark, when)), shape=(m, int(when.max(initial=0)) + 1)).tocsr()
    seen.data[:] = 1
    with_new, with_old = (((seen[of] @ seen.T) > 0).astype(np.int32) for of in pairs.T)
    return np.asarray(with_new.multiply(with_old).sum(axis=1), dtype=np.int64).ravel()


def gathered(
    places: Floats, counts: Ints, iterations: list[Ints], noise_m: float, spacing_m: float
) -> Ints:
    """Return for each landmark (n,) the one of the same object; its own number if there is none.

    Each is joined to the nearest that was seen more often (Rodriguez and Laio, 2014), unless a scan
    shows it together with a landmark already joined to that.

    `places` (n, d), metres: median position of the observations of each landmark; `counts` (n,):
    number of observations of each; `iterations`, list of n (k,): the scans that contain each;
    `noise_m`: standard deviation of an observed coordinate; `spacing_m`: median distance from a
    mapped landmark to the nearest other.
    """
    n, reach_m = len(places), min(DEVIATIONS * noise_m, SPACING * spacing_m)
    whole = np.arange(n)
    rank = np.empty(n, dtype=np.int64)
    rank[np.argsort(-counts, kind="stable")] = np.arange(n)
    towards = np.full(n, NONE)
    near = cKDTree(places).query_pairs(reach_m, output_type="ndarray").reshape(-1, 2)
    near = np.concatenate([near, near[:, ::-1]])
    near = near[rank[near[:, 1]] < rank[near[:, 0]]]
    apart = np.linalg.norm(places[near[:, 0]] - places[near[:, 1]], axis=1)
    for piece, other in near[np.argsort(-apart, kind="stable")].tolist():
        towards[piece] = other
    seen = [set(scans.tolist()) for scans in iterations]
    for piece in np.argsort(rank)[towards[np.argsort(rank)] != NONE].tolist():
        of = int(whole[towards[piece]])
        is_near = np.linalg.norm(places[piece] - places[of]) <= reach_m
        if is_near and seen[of].isdisjoint(seen[piece]):
            whole[piece] = of
            seen[of] |= seen[piece]
    return whole
