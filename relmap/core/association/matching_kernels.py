"""Matching observations to tracks, compiled; see `relmap.core.association`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import smallest
from relmap.core.linalg.small_kernels import picked, square_of, unset

PAIR_RATIO, MANY = 4.0, 6
"""Ratio of the distances to the second and to the nearest neighbour above which landmarks count as
pairs, and minimum number of landmarks for that: of three, two are often close by chance."""
REACH, CROWDED, SHARE = 1.5, 100, 1 / 12
"""How far neighbours of a sample are searched in a grid, in spacings; points from which a grid is
searched, and up to how many of its cells, per point."""
CELL, MARGIN = 4.0, 0.2501
"""Side of a cell of the grid, in reaches, and a reach in sides, with room for rounding."""
Buckets = tuple[Ints, Ints, float, float]
"""First point of each bucket of a grid, and the next one of each point; -1 ends. Then the largest
distance of points that are near, metres, and the same in units of their metric."""


@helper
def claims(wanted: Ints, distance: Floats, n: int) -> Bools:
    """Return which rows are the nearest among those that claim the same of n targets.

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
def buckets(points: Floats, reach: float, farthest_m: float) -> Buckets:
    """Put points (n, d) into the buckets of a hashed grid, for `nearest_to`."""
    n, d = points.shape
    n_buckets, side = 16, CELL * farthest_m
    while n_buckets < 2 * n:
        n_buckets *= 2
    first, following = unset(n_buckets), np.empty(n, dtype=np.int64)
    for i in range(n):
        z = points[i, 2] if d == 3 else 0.0
        x, y, z = np.floor(points[i, 0] / side), np.floor(points[i, 1] / side), np.floor(z / side)
        bucket = _bucket(int(x), int(y), int(z), n_buckets)
        following[i] = first[bucket]
        first[bucket] = i
    return first, following, farthest_m, reach


@helper
def nearest_to(
    query: Floats, points: Floats, grid: Buckets, metric: Floats | None, apart: Floats
) -> tuple[float, int]:
    """Return the squared distance to the nearest of points (n, d), and which it is; n if none.

    Only points within the reach of the grid count. Ties go to the first point. With a metric
    (n, d, d) of the points, reach and distance are in its units. `apart` (d,): work space.
    """
    first, following, farthest_m, reach = grid
    side, stretch = CELL * farthest_m, 1.001 * (farthest_m / reach) ** 2  # with room for rounding
    best, nearest, space = reach * reach, len(points), len(query) == 3
    z, margin_z = query[2] if space else 0.0, MARGIN if space else 0.0
    cx, cy, cz = query[0] / side, query[1] / side, z / side
    for x in range(int(np.floor(cx - MARGIN)), int(np.floor(cx + MARGIN)) + 1):
        for y in range(int(np.floor(cy - MARGIN)), int(np.floor(cy + MARGIN)) + 1):
            for layer in range(int(np.floor(cz - margin_z)), int(np.floor(cz + margin_z)) + 1):
                i = first[_bucket(x, y, layer, len(first))]
                while i >= 0:
                    square = 0.0
                    for a in range(len(query)):
                        apart[a] = points[i, a] - query[a]
                        square += apart[a] ** 2
                    if metric is not None:
                        is_far = square > stretch * best
                        square = np.inf if is_far else square_of(metric[i], apart)
                    if square < best or (square == best and i < nearest):
                        best, nearest = square, i
                    i = following[i]
    return best, nearest


@helper
def matched(
    placed: Floats, target: Floats, grid: Buckets, metric: Floats | None, match: Ints
) -> int:
    """Write the target (m, d) nearest to each placed point (n, d), or -1; return how many have one.

    Each target is matched at most once, to the nearest point. See `nearest_to`.
    """
    m, count = len(target), 0
    owner, nearest, apart = unset(m), np.empty(m), np.empty(target.shape[1])
    for i in range(len(placed)):
        match[i] = -1
        square, at = nearest_to(placed[i], target, grid, metric, apart)
        if at < m and (owner[at] < 0 or square < nearest[at]):
            if owner[at] >= 0:
                match[owner[at]] = -1
            else:
                count += 1
            owner[at], nearest[at], match[i] = i, square, at
    return count


@helper
def three_nearest(points: Floats, query: Floats) -> tuple[float, float, float, int]:
    """Return the squared distances of the three points (n, d) nearest to a query, and the nearest.

    For a few queries this is faster than building a grid. Without enough points a distance is
    infinite.
    """
    space = len(query) == 3
    qx, qy, qz = query[0], query[1], query[2] if space else 0.0
    first, second, third, index = np.inf, np.inf, np.inf, len(points)
    for i in range(len(points)):
        x, y, z = points[i, 0] - qx, points[i, 1] - qy, points[i, 2] - qz if space else 0.0
        square = x * x + y * y + z * z
        if square < first:
            first, second, third, index = square, first, second, i
        elif square < second:
            second, third = square, second
        elif square < third:
            third = square
    return first, second, third, index


@helper
def three_within(
    query: Floats, points: Floats, grid: Buckets, radius: float
) -> tuple[float, float, float, int]:
    """Return what `three_nearest` does, but distances beyond a radius, metres, may be too large.

    Only the cells of the grid within the radius are searched, unless they are many.
    """
    if len(points) < CROWDED:
        return three_nearest(points, query)
    first, following, farthest_m, _ = grid
    side, r, space = CELL * farthest_m, 1.001 * radius, len(query) == 3  # with room for rounding
    z, r_z = query[2] if space else 0.0, r if space else 0.0
    left, right = np.floor((query[0] - r) / side), np.floor((query[0] + r) / side)
    front, back = np.floor((query[1] - r) / side), np.floor((query[1] + r) / side)
    low, high = np.floor((z - r_z) / side), np.floor((z + r_z) / side)
    if not (right - left + 1) * (back - front + 1) * (high - low + 1) <= SHARE * len(points):
        return three_nearest(points, query)
    a, b, c, one, two, three = np.inf, np.inf, np.inf, len(points), -1, -1
    for x in range(int(left), int(right) + 1):
        for y in range(int(front), int(back) + 1):
            for layer in range(int(low), int(high) + 1):
                i = first[_bucket(x, y, layer, len(first))]
                while i >= 0:
                    u, v = points[i, 0] - query[0], points[i, 1] - query[1]
                    w = points[i, 2] - z if space else 0.0
                    square = u * u + v * v + w * w
                    if square <= c and i not in (one, two, three):  # cells may share a bucket
                        if square < a or (square == a and i < one):
                            a, b, c, one, two, three = square, a, b, i, one, two
                        elif square < b:
                            b, c, two, three = square, b, i, two
                        else:
                            c, three = square, i
                    i = following[i]
    return a, b, c, one


@helper
def nearest_of_sample(
    points: Floats, expected: Floats, missed: Ints, most: int, radius: float
) -> tuple[Ints, Ints, Floats, float]:
    """Return the points (n, d) nearest to a sample of the tracks (m, d) that were seen last.

    Returns the tracks (k,), at most `most`, the point nearest to each, its distance, and the
    spacing, see `scale.spacing_of`; no tracks if two matches are impossible. A spacing or a
    distance above the radius, metres, may be too large.
    """
    n, m, fewest, n_latest = len(points), len(missed), missed[0], 0
    for row in range(m):
        fewest = min(fewest, missed[row])
    latest = np.empty(m, dtype=np.int64)
    for row in range(m):
        if missed[row] == fewest:
            latest[n_latest], n_latest = row, n_latest + 1
    if min(n, n_latest) < 2:
        return latest[:0], latest[:0], np.empty(0), 0.0
    crowd = points if n >= n_latest else picked(expected, latest[:n_latest])
    used = crowd if np.isfinite(radius) else crowd[:0]
    grid, every = buckets(used, radius, 2 * radius / CELL), -(-len(crowd) // most)
    neighbour = np.empty((2, -(-len(crowd) // every)))
    for k in range(neighbour.shape[1]):
        found = three_within(crowd[k * every], crowd, grid, radius)
        neighbour[0, k], neighbour[1, k] = found[1], found[2]
    if len(used) > n:
        grid = buckets(points, radius, 2 * radius / CELL)
    half = neighbour.shape[1] // 2
    spacing = np.sqrt(smallest(neighbour[0], half))
    if len(crowd) >= MANY:
        spacing = max(spacing, np.sqrt(smallest(neighbour[1], half // 2)) / PAIR_RATIO)
    every = -(-n_latest // most)
    k = -(-n_latest // every)
    target, distance = np.empty(k, dtype=np.int64), np.empty(k)
    for i in range(k):
        latest[i] = latest[i * every]
        found = three_within(expected[latest[i]], points, grid, radius)
        distance[i], target[i] = np.sqrt(found[0]), found[3]
    return latest[:k], target, distance, spacing


@compiled
def matched_sample(
    points: Floats, expected: Floats, missed: Ints, most: int, known: float, slowness: float
) -> tuple[Ints, Ints, Ints, Floats, Floats, Floats, float]:
    """Match a sample of the tracks (m, d) to the points (n, d) nearest to them, within the spacing.

    `known`: the spacing so far, infinite before the first scan; `slowness`: weight of this scan in
    it. Returns the sample; the tracks matched (k,), their points and the distances to them; the
    positions of both (k, d); and the spacing.
    """
    radius = REACH * known if len(points) >= CROWDED else np.inf
    while True:
        sample, target, distance, spacing = nearest_of_sample(
            points, expected, missed, most, radius
        )
        if spacing <= radius:
            break
        radius = np.inf
    m, k = len(sample), 0
    rows, found, apart = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64), np.empty(m)
    if np.isfinite(known):
        # None is seen if most points coincide with others.
        spacing = known + slowness * (spacing - known) if m and spacing > 0 else known
    for j in range(m):
        distance[j] = distance[j] if distance[j] <= spacing else np.inf
    won = claims(target, distance, len(points))
    for j in range(m):
        if won[j]:
            rows[k], found[k], apart[k] = sample[j], target[j], distance[j]
            k += 1
    rows, found = rows[:k], found[:k]
    here, there = picked(expected, rows), picked(points, found)
    return sample, rows, found, apart[:k], here, there, spacing
