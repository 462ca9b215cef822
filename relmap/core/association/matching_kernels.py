"""Matching observations to tracks, compiled; see `relmap.core.association`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import square_of, unset


@compiled
def claims(wanted: Ints, distance: Floats, n: int) -> Bools:
    """Return which rows are the nearest among those that want the same of n targets.

    Ties go to the first row; rows at infinite distance are ignored.
    """
    winner = unset(n + 1)
    for row in range(len(wanted)):
        if np.isfinite(distance[row]):
            best = winner[wanted[row]]
            if best < 0 or distance[row] < distance[best]:
                winner[wanted[row]] = row
    won = np.zeros(len(wanted), dtype=np.bool_)
    for target in range(n):
        if winner[target] >= 0:
            won[winner[target]] = True
    return won


@helper
def _bucket(x: int, y: int, z: int, n_buckets: int) -> int:
    """Return the bucket of a cell (Teschner et al., "Optimized spatial hashing", VMV 2003)."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (n_buckets - 1)


@helper
def buckets(points: Floats, cell: float) -> tuple[Ints, Ints]:
    """Put points (n, d) into the buckets of a hashed grid of cells.

    Returns the first point of each bucket, and the next point in the bucket of each point; -1 ends.
    """
    n, d = points.shape
    n_buckets = 16
    while n_buckets < 2 * n:
        n_buckets *= 2
    first, following = unset(n_buckets), np.empty(n, dtype=np.int64)
    for i in range(n):
        z = points[i, 2] if d == 3 else 0.0
        x, y, z = np.floor(points[i, 0] / cell), np.floor(points[i, 1] / cell), np.floor(z / cell)
        bucket = _bucket(int(x), int(y), int(z), n_buckets)
        following[i] = first[bucket]
        first[bucket] = i
    return first, following


@compiled
def nearest_within(
    points: Floats,
    queries: Floats,
    reach: float,
    metric: Floats | None = None,
    cell: float = 0.0,
) -> tuple[Floats, Ints]:
    """Return distance and index (k,) of the point (n, d) nearest to each query (k, d).

    Only points within reach count; if there is none, the distance is infinite and the index n. Ties
    go to the first point. With a metric (n, d, d) of the points, reach and distance are in its
    units, and `cell` is the largest distance of a point within reach, metres.
    """
    n, d = points.shape
    side = reach if metric is None else cell
    first, following = buckets(points, side)
    apart = np.empty(d)
    distance, index = np.empty(len(queries)), np.empty(len(queries), dtype=np.int64)
    layers = 1 if d == 3 else 0
    for k in range(len(queries)):
        index[k] = n
        z = queries[k, 2] if d == 3 else 0.0
        cx, cy, cz = queries[k, 0] / side, queries[k, 1] / side, z / side
        best = reach * reach
        for x in range(int(np.floor(cx)) - 1, int(np.floor(cx)) + 2):
            for y in range(int(np.floor(cy)) - 1, int(np.floor(cy)) + 2):
                for z_cell in range(int(np.floor(cz)) - layers, int(np.floor(cz)) + layers + 1):
                    i = first[_bucket(x, y, z_cell, len(first))]
                    while i >= 0:
                        square = 0.0
                        for a in range(d):
                            apart[a] = points[i, a] - queries[k, a]
                            square += apart[a] ** 2
                        if metric is not None:
                            square = square_of(metric[i], apart)
                        if square < best or (square == best and i < index[k]):
                            best, index[k] = square, i
                        i = following[i]
        distance[k] = np.sqrt(best) if index[k] < n else np.inf
    return distance, index


@compiled
def two_nearest(points: Floats, queries: Floats) -> tuple[Floats, Ints]:
    """Return the distances (k, 2) of the two points (n, d) nearest to each query, and the nearest.

    For a few queries this is faster than building a tree. Infinite if there are fewer points.
    """
    n, d = points.shape
    distances, index = np.empty((len(queries), 2)), np.empty(len(queries), dtype=np.int64)
    for k in range(len(queries)):
        first, second, index[k] = np.inf, np.inf, n
        for i in range(n):
            square = 0.0
            for a in range(d):
                square += (points[i, a] - queries[k, a]) ** 2
            if square < first:
                first, second, index[k] = square, first, i
            elif square < second:
                second = square
        distances[k, 0], distances[k, 1] = np.sqrt(first), np.sqrt(second)
    return distances, index


@compiled
def see_tracks(
    expected: Floats,
    latest: Floats,
    counts: tuple[Ints, Ints, Ints],
    rows: Ints,
    points: Floats,
    strayed: Bools,
    memory: int,
    careful: int,
) -> None:
    """Record which tracks were found and which were missed; see `LiveTracks.see`."""
    missed, seen, restless = counts
    for row in range(len(missed)):
        missed[row] += 1
    for j in range(len(rows)):
        row = rows[j]
        missed[row] = 0
        seen[row] += 1
        restless[row] = careful if strayed[j] else max(restless[row] - 1, 0)
        share = 1.0 if restless[row] > 0 else 1 / min(seen[row], memory)
        for a in range(points.shape[1]):
            expected[row, a] += share * (points[j, a] - expected[row, a])
            latest[row, a] = points[j, a]
