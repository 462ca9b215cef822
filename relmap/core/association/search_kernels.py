"""Registration of two point sets without an initial guess, compiled; see `search`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.matching_kernels import buckets, matched
from relmap.core.association.search import CENTRES, MOST, NEIGHBOURS, PATCH, REPEATED
from relmap.core.geometry.fitting_kernels import fit_rows, placed_at, set_placement
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import ordered
from relmap.core.linalg.small_kernels import identity, picked, square_of


@helper
def distances(points: Floats) -> Floats:
    """Return the mutual distances (n, n) of points (n, d)."""
    n, d = points.shape
    found = np.zeros((n, n))
    for i in range(n):
        for j in range(i):
            square = 0.0
            for a in range(d):
                square += (points[i, a] - points[j, a]) ** 2
            found[i, j] = np.sqrt(square)
            found[j, i] = found[i, j]
    return found


@helper
def _allowances(target: Floats, tolerance_m: float, metric: Floats | None) -> Floats:
    """Return by how much the mutual distances (m, m) of targets may differ and yet agree."""
    m, d = target.shape
    allowed, along = np.empty((m, m)), np.empty(d)
    for i in range(m):
        for j in range(m):
            allowed[i, j] = tolerance_m
            if metric is not None and i != j:
                length = 0.0
                for a in range(d):
                    along[a] = target[i, a] - target[j, a]
                    length += along[a] ** 2
                if length == 0:  # they coincide
                    continue
                room = length / square_of(metric[i], along) + length / square_of(metric[j], along)
                allowed[i, j] = tolerance_m * np.sqrt(room / 2)
    return allowed


@compiled
def matched_at(
    source: Floats,
    target: Floats,
    R: Floats,
    t: Floats,
    tolerance_m: float,
    metric: Floats | None,
    farthest_m: float,
) -> Ints:
    """Return the target point (m, d) nearest to each placed source point (n, d), or -1; (n,).

    Each target is matched at most once, to the nearest in its metric (m, d, d). `farthest_m`:
    largest distance of a match, metres.
    """
    match, grid = np.empty(len(source), dtype=np.int64), buckets(target, tolerance_m, farthest_m)
    matched(placed_at(source, R, t), target, grid, metric, match)
    return match


@compiled
def placements_by_triangles(
    source: Floats,
    target: Floats,
    triangles: Ints,
    tolerance_m: float,
    fewest: int,
    metric: Floats | None,
    farthest_m: float,
) -> tuple[Floats, Floats, Ints]:
    """Return placements from triangles of source points found among the target points.

    `source` (n, d), `target` (m, d), metres. `triangles` (k, 3): rows of the source points.
    `tolerance_m`: largest difference between two sides that agree, and largest distance of a match.
    `fewest`: minimum number of matches of a placement. `metric`, `farthest_m`: as for `matched_at`;
    the tolerance is in units of the metric. Returns `R` (h, d, d), `t` (h, d) and `matches` (h, n):
    the target point of each source point, or -1.
    """
    (n, d), m = source.shape, len(target)
    here, there = distances(source), distances(target)
    grid = buckets(target, tolerance_m, farthest_m)
    allowed = _allowances(target, tolerance_m, metric)
    R, t, matches = np.empty((MOST, d, d)), np.empty((MOST, d)), np.empty((MOST, n), dtype=np.int64)
    corners, found, every = np.empty((3, d)), np.empty((3, d)), np.ones(3, dtype=np.bool_)
    h, tried, turn = 0, 0, identity(d)
    for i, j, p in triangles:
        _enter(source, i, j, p, corners)
        for k in range(m):
            for q in range(m):
                if k == q or abs(there[k, q] - here[i, j]) > allowed[k, q]:
                    continue
                for r in range(m):
                    off = abs(there[k, r] - here[i, p]) - allowed[k, r]
                    off = max(off, abs(there[q, r] - here[j, p]) - allowed[q, r])
                    if off > 0 or r in (k, q):
                        continue
                    _enter(target, k, q, r, found)
                    turn, shift, fixed, _, _ = fit_rows(corners, found, every, turn)
                    if fixed and tried < MOST:
                        tried += 1
                        placed = placed_at(source, turn, shift)
                        if matched(placed, target, grid, metric, matches[h]) >= fewest:
                            set_placement(R, t, h, turn, shift)
                            h += 1
        if tried == MOST:
            break
    return R[:h], t[:h], matches[:h]


@helper
def _enter(points: Floats, i: int, j: int, k: int, corners: Floats) -> None:
    """Copy three of points (n, d) as corners (3, d)."""
    for a in range(points.shape[1]):
        corners[0, a], corners[1, a], corners[2, a] = points[i, a], points[j, a], points[k, a]


@helper
def _patch(points: Floats) -> Floats:
    """Return the points (k, d) nearest to the centre of points (n, d), nearest first."""
    n, d = points.shape
    apart = np.zeros(n)
    for a in range(d):
        total = 0.0
        for i in range(n):
            total += points[i, a]
        for i in range(n):
            apart[i] += (points[i, a] - total / n) ** 2
    return picked(points, ordered(apart)[:PATCH])


@compiled
def shortest_period(points: Floats, tolerance_m: float, within_m: float) -> float:
    """Return the shortest shift that brings a share of a patch of points (n, d) onto others, m.

    `within_m`: only shorter ones are tried. Shifts are those from each of its first points, the
    centres, to its nearest neighbours. Infinite if there is none; shorter ones than twice the
    tolerance bring points near themselves.
    """
    if len(points) <= 2:
        return np.inf
    patch, shortest, limit = _patch(points), np.inf, within_m * within_m
    fewest = max(2.0, REPEATED * (len(patch) - 1))
    for c in range(min(CENTRES, len(patch))):
        last = 4 * tolerance_m * tolerance_m
        for _ in range(NEIGHBOURS):
            to, square = -1, np.inf
            for j in range(len(patch)):
                apart = _shifted(patch, c, c, c, j)
                if last < apart < square:
                    to, square = j, apart
            if to < 0 or square >= limit:
                break
            last = square
            if _repeats(patch, c, to, tolerance_m, fewest):
                shortest = limit = square
    return float(np.sqrt(shortest))


@helper
def _repeats(patch: Floats, start: int, end: int, tolerance_m: float, fewest: float) -> bool:
    """Return whether the shift from one point to another brings `fewest` others onto points."""
    count = 0
    for i in range(len(patch)):
        if count + len(patch) - i < fewest:
            break
        for j in range(len(patch)):
            # The first point itself comes onto the second.
            if i != start and _shifted(patch, i, start, end, j) <= tolerance_m * tolerance_m:
                count += 1
                break
    return count >= fewest


@helper
def _shifted(patch: Floats, i: int, start: int, end: int, j: int) -> float:
    """Return the square of the distance from a point to another, shifted by a third to a fourth."""
    total = 0.0
    for a in range(patch.shape[1]):
        off = patch[i, a] + patch[end, a] - patch[start, a] - patch[j, a]
        total += off * off
    return total
