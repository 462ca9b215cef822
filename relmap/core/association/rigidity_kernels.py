"""Alignment of the landmarks of one scan to those of another, compiled; see `rigidity`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.fitting_kernels import trimmed_fit_rows
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import smallest


@compiled
def extent_of(points: Floats) -> float:
    """Return the longest side of the box around points (n, d)."""
    longest = 0.0
    for a in range(points.shape[1]):
        low, high = np.inf, -np.inf
        for i in range(len(points)):
            low, high = min(low, points[i, a]), max(high, points[i, a])
        longest = max(longest, high - low)
    return longest


@helper
def _in_both(ids: Ints, scan_ids: Ints) -> tuple[Ints, Ints]:
    """Return the positions, in two ascending lists, of the ids contained in both."""
    n, m = len(ids), len(scan_ids)
    rows, shared = np.empty(min(n, m), dtype=np.int64), np.empty(min(n, m), dtype=np.int64)
    k, i, j = 0, 0, 0
    while i < n and j < m:
        if ids[i] == scan_ids[j]:
            rows[k], shared[k] = i, j
            k, i, j = k + 1, i + 1, j + 1
        elif ids[i] < scan_ids[j]:
            i += 1
        else:
            j += 1
    return rows[:k], shared[:k]


@compiled
def lay_on(
    ids: Ints, points: Floats, scan_ids: Ints, scan_points: Floats, limits: tuple[float, int, int]
) -> tuple[Ints, Ints, Floats, Floats, Floats, float, float]:
    """Fit landmarks (n, d) to those of the same ids in a scan (m, d); both ids ascend.

    The limits are the tolerance and the maximum and minimum number of pairs to fit.  Returns the
    rows of both, R, t, the misfits, their upper median and the largest; with too few pairs, or too
    few that agree, there are no misfits and these are infinite.
    """
    tolerance_m, sample, fewest = limits
    rows, shared = _in_both(ids, scan_ids)
    k, d = len(rows), points.shape[1]
    if k < fewest:
        return rows, shared, np.empty((d, d)), np.empty(d), np.empty(0), np.inf, np.inf
    every = -(-k // sample)
    n_fitted = (k - 1) // every + 1
    source, target = np.empty((n_fitted, d)), np.empty((n_fitted, d))
    for pair in range(n_fitted):
        for a in range(d):
            source[pair, a] = points[rows[pair * every], a]
            target[pair, a] = scan_points[shared[pair * every], a]
    R, t, n_agreeing = trimmed_fit_rows(source, target, tolerance_m)
    if n_agreeing < 0:
        return rows, shared, R, t, np.empty(0), np.inf, np.inf
    misfit, listed, largest = np.empty(k), np.empty(k), 0.0
    for pair in range(k):
        square = 0.0
        for a in range(d):
            apart = t[a] - scan_points[shared[pair], a]
            for b in range(d):
                apart += R[a, b] * points[rows[pair], b]
            square += apart * apart
        misfit[pair] = listed[pair] = np.sqrt(square)
        largest = max(largest, misfit[pair])
    return rows, shared, R, t, misfit, smallest(listed, k // 2), largest


@compiled
def carry(
    last: tuple[Ints, Floats, Ints, Ints],
    scan_ids: Ints,
    scan_points: Floats,
    R: Floats,
    t: Floats,
    longest: int,
) -> tuple[Ints, Floats, Ints, Ints]:
    """Return the landmarks of a scan, and the missed ones transformed into its frame.

    `last` are ids, points, scans missed and how often each was seen.  Both ids ascend, and so do
    those returned.  Landmarks missed in more than the maximum number of scans are dropped.
    """
    ids, points, missed, times = last
    (n, d), m = points.shape, len(scan_ids)
    all_ids, all_points = np.empty(n + m, dtype=np.int64), np.empty((n + m, d))
    all_missed, all_times = np.zeros(n + m, dtype=np.int64), np.ones(n + m, dtype=np.int64)
    k, i, j = 0, 0, 0
    while i < n or j < m:
        if i == n or (j < m and scan_ids[j] <= ids[i]):
            all_ids[k] = scan_ids[j]
            for a in range(d):
                all_points[k, a] = scan_points[j, a]
            if i < n and scan_ids[j] == ids[i]:
                all_times[k] += times[i]
                i += 1
            k, j = k + 1, j + 1
            continue
        if missed[i] < longest:
            all_ids[k], all_missed[k], all_times[k] = ids[i], missed[i] + 1, times[i]
            for a in range(d):
                all_points[k, a] = t[a]
                for b in range(d):
                    all_points[k, a] += R[a, b] * points[i, b]
            k += 1
        i += 1
    return all_ids[:k], all_points[:k], all_missed[:k], all_times[:k]
