"""Alignment of the landmarks of one scan to those of another, compiled; see `rigidity`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.each_kernels import extent_of
from relmap.core.geometry.fitting_kernels import misfits, trimmed_fit_rows
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import smallest
from relmap.core.linalg.small_kernels import picked


@helper
def _common(ids: Ints, scan_ids: Ints) -> tuple[Ints, Ints]:
    """Return the rows (k,) in two ascending lists (n,) and (m,) of the ids in both."""
    n, m, k, i, j = len(ids), len(scan_ids), 0, 0, 0
    rows, shared = np.empty(min(n, m), dtype=np.int64), np.empty(min(n, m), dtype=np.int64)
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
def fitted(
    ids: Ints,
    points: Floats,
    scan_ids: Ints,
    scan_points: Floats,
    order: Ints,
    limits: tuple[int, int, float, float],
) -> tuple[Ints, Floats, float, Ints, Ints, Floats, Floats, Floats, float, float]:
    """Align landmarks with ascending ids to a scan, by those with the same ids.

    `order` (m,): of the ascending ids of the scan. `limits`: minimum number of common landmarks,
    and maximum number used for the fit; the tolerance, metres, and its least fraction of the extent
    of the scan. Returns ids and points (m, d) of the scan in that order, and its extent; the rows
    (k,) of the common ones in both, none if they are too few; R and t; and their misfits (k,), the
    median and the largest: none and infinite if too few agree within the tolerance.
    """
    fewest, most, least_m, share = limits
    here, there = np.empty(len(order), dtype=np.int64), picked(scan_points, order)
    extent_m = extent_of(scan_points)
    for i in range(len(order)):
        here[i] = scan_ids[order[i]]
    rows, shared = _common(ids, here)
    misfit, none = np.empty(0), np.empty((0, 0))
    if len(rows) < fewest:
        return here, there, extent_m, rows[:0], shared[:0], none, misfit, misfit, np.inf, np.inf
    every, tolerance_m = max(-(-len(rows) // most), 1), max(least_m, share * extent_m)
    source, target = picked(points, rows, every), picked(there, shared, every)
    R, t, n_agreeing = trimmed_fit_rows(source, target, tolerance_m)
    if n_agreeing < 0:
        return here, there, extent_m, rows, shared, R, t, misfit, np.inf, np.inf
    misfit = misfits(picked(points, rows), picked(there, shared), R, t)
    usual, largest = smallest(misfit.copy(), len(rows) // 2), 0.0
    for off in misfit:
        largest = max(largest, off)
    return here, there, extent_m, rows, shared, R, t, misfit, usual, largest


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
