"""Registration of two point sets without an initial guess, compiled; see `search`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.search import MOST
from relmap.core.geometry.fitting_kernels import fit_rows, set_placement
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import ordered, smallest
from relmap.core.linalg.small_kernels import identity, square_between, square_of, unset

Along = tuple[Ints, float, float]
"""Order of the targets along the first axis, how far matches are along it, and the tolerance."""


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
    stretch: Floats | None,
) -> Ints:
    """Return the target point (m, d) nearest to each placed source point (n, d), or -1; (n,).

    Each target is matched at most once, to the nearest in its metric (m, d, d). `stretch` (m,) is
    the largest length of a unit of the metric, metres.
    """
    match = np.empty(len(source), dtype=np.int64)
    along = _along_first_axis(target, tolerance_m, stretch)
    _matched(source, target, along, R, t, match, metric, stretch)
    return match


@helper
def _along_first_axis(target: Floats, tolerance_m: float, stretch: Floats | None) -> Along:
    """Return the order of targets (m, d), and how far matches are, along the first axis."""
    longest = 1.0
    if stretch is not None:
        longest = 0.0
        for k in range(len(stretch)):
            longest = max(longest, stretch[k])
    return ordered(target[:, 0].copy()), (1 + 1e-9) * tolerance_m * longest, tolerance_m


@helper
def _matched(
    source: Floats,
    target: Floats,
    along: Along,
    R: Floats,
    t: Floats,
    match: Ints,
    metric: Floats | None,
    stretch: Floats | None,
) -> int:
    """Write the matches as `matched_at` returns them; return their number."""
    (n, d), m, tolerance_m = source.shape, len(target), along[2]
    owner, nearest = unset(m), np.empty(m)
    placed, apart = np.empty(d), np.empty(d)
    count = 0
    for k in range(m):
        nearest[k] = tolerance_m * tolerance_m
    for i in range(n):
        match[i] = -1
        for a in range(d):
            placed[a] = t[a]
            for b in range(d):
                placed[a] += R[a, b] * source[i, b]
        best, at = _nearest(placed, target, along, metric, stretch, apart)
        if at >= 0 and best < nearest[at]:
            if owner[at] >= 0:
                match[owner[at]] = -1
            else:
                count += 1
            owner[at], nearest[at], match[i] = i, best, at
    return count


@helper
def _nearest(
    placed: Floats,
    target: Floats,
    along: Along,
    metric: Floats | None,
    stretch: Floats | None,
    apart: Floats,
) -> tuple[float, int]:
    """Return the least squared distance within the tolerance, and the first target at it, or -1."""
    order, reach_m, tolerance_m = along
    best, at, begin, end = tolerance_m * tolerance_m, -1, 0, len(target)
    while begin < end:
        middle = (begin + end) // 2
        if target[order[middle], 0] < placed[0] - reach_m:
            begin = middle + 1
        else:
            end = middle
    while begin < len(target) and target[order[begin], 0] <= placed[0] + reach_m:
        k, begin = order[begin], begin + 1
        limit = best if stretch is None else best * stretch[k] ** 2
        square = (placed[0] - target[k, 0]) ** 2
        if square <= limit:
            square = square_between(placed, target[k], metric, k, apart)
            if square < best or (square == best and k < at):
                best, at = square, k
    return best, at


@compiled
def placements_by_triangles(
    source: Floats,
    target: Floats,
    triangles: Ints,
    tolerance_m: float,
    fewest: int,
    metric: Floats | None,
    stretch: Floats | None,
) -> tuple[Floats, Floats, Ints]:
    """Return placements from triangles of source points found among the target points.

    `source` (n, d), `target` (m, d), metres. `triangles` (k, 3): rows of the source points.
    `tolerance_m`: largest difference between two sides that agree, and largest distance of a match.
    `fewest`: minimum number of matches of a placement. `metric`, `stretch`: as for `matched_at`;
    the tolerance is in units of the metric. Returns `R` (h, d, d), `t` (h, d) and `matches` (h, n):
    the target point of each source point, or -1.
    """
    (n, d), m = source.shape, len(target)
    here, there = distances(source), distances(target)
    along = _along_first_axis(target, tolerance_m, stretch)
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
                        n_agreeing = _matched(
                            source, target, along, turn, shift, matches[h], metric, stretch
                        )
                        if n_agreeing >= fewest:
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
def _patch(points: Floats, most: int) -> Floats:
    """Return the points (k, d) nearest to the centre of points (n, d), nearest first."""
    n, d = points.shape
    apart, k = np.zeros(n), min(n, most)
    for a in range(d):
        total = 0.0
        for i in range(n):
            total += points[i, a]
        for i in range(n):
            apart[i] += (points[i, a] - total / n) ** 2
    last, near, count = smallest(apart.copy(), k - 1), np.empty(k, dtype=np.int64), 0
    for is_last in (False, True):
        for i in range(n):
            if count < k and (apart[i] == last if is_last else apart[i] < last):
                near[count], count = i, count + 1
    return points[near[ordered(apart[near])]]


@compiled
def shortest_period(
    points: Floats,
    tolerance_m: float,
    within_m: float,
    share: float,
    most: int,
    centres: int,
    neighbours: int,
) -> float:
    """Return the shortest shift that brings a share of a patch of points (n, d) onto others, m.

    `within_m`: only shorter ones are tried; `most`: points of the patch, amid all. Shifts are those
    from each of its first points, the `centres`, to its nearest neighbours. Infinite if there is
    none; shorter ones than twice the tolerance bring points near themselves.
    """
    if len(points) <= 2:
        return np.inf
    patch, shortest, limit = _patch(points, most), np.inf, within_m * within_m
    fewest = max(2.0, share * (len(patch) - 1))
    for c in range(min(centres, len(patch))):
        last = 4 * tolerance_m * tolerance_m
        for _ in range(neighbours):
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
