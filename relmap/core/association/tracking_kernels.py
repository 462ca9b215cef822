"""Tracks that the points of a scan continue, compiled; see `constellation`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.matching_kernels import (
    Buckets,
    buckets,
    claims,
    matched,
    three_within,
)
from relmap.core.geometry.fitting_kernels import misfits, placed_at
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import smallest
from relmap.core.linalg.small_kernels import unset

Columns = tuple[Ints, Floats, Floats, Ints, Ints, Ints]
"""The columns of `LiveTracks`."""


@compiled
def middle_step(points: Floats, R: Floats, t: Floats) -> float:
    """Return the upper median of the distances by which R and t move points (n, d)."""
    moved, square = placed_at(points, R, t), np.zeros(len(points))
    for i in range(len(points)):
        for a in range(points.shape[1]):
            square[i] += (moved[i, a] - points[i, a]) ** 2
    return float(np.sqrt(smallest(square, len(square) // 2)))


@compiled
def agreement(
    matches: tuple[Floats, Floats],
    expected: Floats,
    pose: tuple[Floats, Floats],
    tolerance_m: float,
    metric: Floats | None,
) -> tuple[float, float]:
    """Return the upper median of the squared misfits of matches, and how far all tracks move.

    `matches`: tracks and points (k, d); `expected` (m, d): all tracks. Misfits are in the metric
    (k, d, d) of the points; only those within the tolerance count, without any it is infinite.
    """
    misfit, found = misfits(matches[0], matches[1], pose[0], pose[1], metric), 0
    for i in range(len(misfit)):
        if misfit[i] <= tolerance_m:
            misfit[found], found = misfit[i], found + 1
    square = smallest(misfit[:found], found // 2) ** 2 if found else np.inf
    return square, middle_step(expected, pose[0], pose[1])


@compiled
def carried(tracks: Columns, R: Floats, t: Floats) -> Columns:
    """Return the tracks in the frame of the next scan, at R (d, d) and t (d,) from theirs."""
    landmarks, expected, latest, missed, seen, restless = tracks
    return landmarks, placed_at(expected, R, t), placed_at(latest, R, t), missed, seen, restless


@helper
def continued(
    points: Floats,
    match: Ints,
    latest: Floats,
    counts: tuple[Ints, Ints, Ints],
    grid: Buckets,
    reaches: tuple[float, float, int],
) -> tuple[Ints, Ints, int]:
    """Return the tracks (k,) that points (n, d) continue, these points, and how many are static.

    Static tracks, which come first, continue at the point that matches their prediction, -1 if none
    does. The others that were seen last claim the point nearest to their latest observation, within
    a reach for those that may move or, if seen often and never moving, for static ones.
    """
    missed, seen, restless = counts
    widest, narrow, young = reaches
    n, m = len(points), len(match)
    rows, found, k = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64), 0
    taken = np.zeros(n + 1, dtype=np.bool_)
    for row in range(m):
        if match[row] >= 0:
            rows[k], found[k], taken[match[row]] = row, match[row], True
            k += 1
    n_static = k
    wanted, apart = np.empty(m, dtype=np.int64), np.empty(m)
    for row in range(m):
        apart[row] = np.inf
        if match[row] < 0 and missed[row] == 0:
            square, _, _, wanted[row] = three_within(latest[row], points, grid, widest)
            may_move = restless[row] > 0 or seen[row] < young
            if np.sqrt(square) <= (widest if may_move else narrow) and not taken[wanted[row]]:
                apart[row] = np.sqrt(square)
    followed = claims(wanted, apart, n)
    for row in range(m):
        if followed[row]:
            rows[k], found[k] = row, wanted[row]
            k += 1
    return rows[:k], found[:k], n_static


@helper
def _middle_square(points: Floats, expected: Floats, links: tuple[Ints, Ints, int]) -> float:
    """Return the upper median of the squared misfits of static links; NaN if there are none."""
    rows, found, n_static = links
    squares = np.zeros(n_static)
    for j in range(n_static):
        for a in range(points.shape[1]):
            squares[j] += (expected[rows[j], a] - points[found[j], a]) ** 2
    return smallest(squares, n_static // 2) if n_static else np.nan


@helper
def _n_kept(point_of: Ints, missed: Ints, longest: int) -> int:
    """Return how many tracks (m,) are continued by a point, or not missed for too long."""
    n = 0
    for row in range(len(missed)):
        n += point_of[row] >= 0 or missed[row] < longest
    return n


@compiled
def followed(
    points: Floats,
    tracks: Columns,
    links: tuple[Ints, Ints, int],
    n_landmarks: int,
    limits: tuple[int, int, int],
) -> tuple[Ints, Ints, Floats, Ints, float]:
    """Continue predicted tracks by links to points (n, d), and begin one with each other point.

    `limits`: observations that are averaged, iterations after which a moving track is static, and
    iterations for which a track is missed. Returns the landmark of each point (n,), new ones
    numbered from `n_landmarks`; of the tracks the landmarks (k,), expected and latest positions
    (2, k, d), and how often each was missed, seen and restless (3, k); and `_middle_square`.
    """
    before, expected, latest, missed, seen, restless = tracks
    rows, found, n_static = links
    memory, careful, longest = limits
    (n, d), m, k = points.shape, len(before), 0
    landmark, point_of, rests = unset(n), unset(m), np.zeros(m, dtype=np.bool_)
    for j in range(len(rows)):
        point_of[rows[j]], rests[rows[j]] = found[j], j < n_static
    square = _middle_square(points, expected, links)
    size = _n_kept(point_of, missed, longest) + n - len(rows)
    landmarks, places = np.empty(size, dtype=np.int64), np.empty((2, size, d))
    counts = np.empty((3, size), dtype=np.int64)
    for row in range(m):
        p = point_of[row]
        if p < 0 and missed[row] >= longest:
            continue
        landmarks[k] = before[row]
        counts[0, k], counts[1, k], counts[2, k] = missed[row] + 1, seen[row], restless[row]
        for a in range(d):
            places[0, k, a], places[1, k, a] = expected[row, a], latest[row, a]
        if p >= 0:
            landmark[p], counts[0, k], counts[1, k] = before[row], 0, seen[row] + 1
            counts[2, k] = max(restless[row] - 1, 0) if rests[row] else careful
            share = 1.0 if counts[2, k] > 0 else 1 / min(counts[1, k], memory)
            for a in range(d):
                places[0, k, a] += share * (points[p, a] - expected[row, a])
                places[1, k, a] = points[p, a]
        k += 1
    for p in range(n):
        if landmark[p] < 0:
            landmarks[k] = landmark[p] = n_landmarks
            counts[0, k], counts[1, k], counts[2, k] = 0, 1, 0
            for a in range(d):
                places[0, k, a] = places[1, k, a] = points[p, a]
            n_landmarks, k = n_landmarks + 1, k + 1
    return landmark, landmarks, places, counts, square


@compiled
def tracked(
    points: Floats,
    tracks: Columns,
    pose: tuple[Floats, Floats],
    reaches: tuple[float, float, float],
    metric: Floats | None,
    n_landmarks: int,
    limits: tuple[int, int, int, int],
) -> tuple[Floats, tuple[Ints, Ints, int], tuple[Ints, Ints, Floats, Ints, float]]:
    """Carry tracks, link them to points (n, d) and continue them; see these functions.

    `reaches`: see `Constellation`; `limits`: observations of a track that is not too short to
    classify, then those of `followed`. Returns the predicted positions (m, d), the links, and what
    `followed` does.
    """
    widest, narrow, farthest_m = reaches
    young, memory, careful, longest = limits
    placed = carried(tracks, pose[0], pose[1])
    _, expected, latest, missed, seen, restless = placed
    match, grid = np.empty(len(expected), dtype=np.int64), buckets(points, narrow, farthest_m)
    matched(expected, points, grid, metric, match)
    counts, within = (missed, seen, restless), (widest, narrow, young)
    pairs = continued(points, match, latest, counts, grid, within)
    found = followed(points, placed, pairs, n_landmarks, (memory, careful, longest))
    return expected, pairs, found
