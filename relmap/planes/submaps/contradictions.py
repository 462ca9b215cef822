"""Visits of a place whose beams pass through walls seen in another visit of a map."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.planes.linking.tying import Scans
from relmap.planes.motions import from_matrices
from relmap.planes.scans.beams import NEAR_M, compared

APART_M, LATER_M = 0.5, 3.0
"""Distance between the compared scans along the path, and least distance of two of a pair."""
REACH_M, PAIRS = 12.0, 8
"""Largest distance of two compared scans, and number of pairs of each."""
POINTS = 20
"""Smallest number of points in view of both scans."""
CONTRADICTS, AGREES = 0.3, 0.15
"""Fraction of contradicting points above which two scans contradict, and below which they agree. In
27 real and simulated logs that were mapped correctly, 0 to 4 % of the pairs contradict."""
LEAST, HALF = 10, 0.5
"""Smallest number of contradictory pairs that a cut separates, and per consistent pair. In the same
logs there is at most one in ten; where four panels were moved between two visits, one in four."""


def contradicted_revisits(poses: Floats, first: int, scans: Scans) -> Ints:
    """Return the scans (t,) before which to cut a map that contradicts itself.

    There the path between two visits of a place is wrong, by drift or by a wrong link, though each
    step may agree with its own two scans. Each cut separates most contradictory pairs of scans
    among those that are not yet separated, compared with the consistent ones. Scans without a pose
    may belong to other maps: none of them is cut.

    `poses` (k, 4, 4): of consecutive scans, NaN where unknown; `first`: the first of the scans.
    """
    known, pairs, cuts = np.flatnonzero(np.isfinite(poses[:, 0, 0])), _pairs(poses), list[int]()
    share = _contradicting(pairs, poses, first, scans)
    while True:
        against = _spanning(pairs[share > CONTRADICTS], len(poses))
        agreeing = _spanning(pairs[share < AGREES], len(poses))
        cut = int(np.argmax(against - HALF * agreeing))
        if against[cut] < max(LEAST, HALF * agreeing[cut]):
            return np.array(sorted(cuts), dtype=np.int64)
        cuts.append(first + int(known[np.searchsorted(known, cut)]))
        whole = (pairs < cut).all(axis=1) | (pairs >= cut).all(axis=1)
        pairs, share = pairs[whole], share[whole]


def _pairs(poses: Floats) -> Ints:
    """Return pairs (p, 2) of nearby scans between which the robot was elsewhere, ascending."""
    known = np.flatnonzero(np.isfinite(poses[:, 0, 0]))
    steps = np.linalg.norm(np.diff(poses[known, :2, 3], axis=0), axis=1)
    way_m = np.append(0.0, np.cumsum(steps))[: len(known)]
    _, rows = np.unique(way_m // APART_M, return_index=True)
    at, way_m = known[rows], way_m[rows]
    near = cKDTree(poses[at, :2, 3]).query_pairs(REACH_M, output_type="ndarray")
    near = np.sort(near[np.abs(np.diff(way_m[near], axis=1)[:, 0]) > LATER_M], axis=1)
    near = near[np.lexsort(near.T[::-1])]
    many = np.bincount(near[:, 0], minlength=len(at))
    place = np.arange(len(near)) - (np.cumsum(many) - many)[near[:, 0]]
    kept = place % -(-many // PAIRS)[near[:, 0]] == 0  # evenly, few of each scan
    return np.asarray(at[near[kept]])


def _contradicting(pairs: Ints, poses: Floats, first: int, scans: Scans) -> Floats:
    """Return the fraction of contradicting points of each pair; NaN if few are in view of both."""
    of = {row: scans.beams_of(first + row) for row in np.unique(pairs).tolist()}
    motions = from_matrices(np.linalg.inv(poses[pairs[:, 1]]) @ poses[pairs[:, 0]])
    counts = np.zeros((len(pairs), 4))
    for k, (earlier, later) in enumerate(pairs.tolist()):
        if len(of[earlier]) and len(of[later]):
            counts[k] = compared(of[earlier], of[later], motions[k : k + 1], NEAR_M)[0]
    n = counts[:, 0] + counts[:, 1]
    return np.where(n >= POINTS, counts[:, 1] / np.maximum(n, 1.0), np.nan)


def _spanning(pairs: Ints, n: int) -> Ints:
    """Return how many pairs (p, 2) a cut before each row separates; (n,)."""
    begin, end = (np.bincount(rows, minlength=n) for rows in (pairs[:, 0] + 1, pairs[:, 1] + 1))
    return np.asarray(np.cumsum(begin[:n] - end[:n]))
