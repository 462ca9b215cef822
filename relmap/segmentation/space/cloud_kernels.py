"""Compiled loops over the voxels of a cloud, and over the rays of a scan and its planes."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.spatialindex_kernels import bucket_of
from relmap.core.linalg.compiling import compiled, helper
from relmap.segmentation.space.growing import APART
from relmap.segmentation.space.voxels import BITS, GRAZING, NEAR


@helper
def _along(axis: Floats, point: Floats) -> float:
    return float(axis[0] * point[0] + axis[1] * point[1] + axis[2] * point[2])


@compiled
def range_errors(points: Floats, label: Ints, planes: Floats) -> Floats:
    """Return how far points (n, 3) are beyond their planes along their rays (n,); 0 without one.

    `label` (n,): the plane of each, -1 for none; `planes` (m, 4): normals and offsets. Rays are
    taken to meet planes at an angle with at least the sine `GRAZING`.
    """
    found = np.zeros(len(points))
    for i in range(len(points)):
        if label[i] >= 0:
            plane = planes[label[i]]
            ahead = _along(plane, points[i])
            steep = ahead / np.sqrt(_along(points[i], points[i]))
            found[i] = (ahead - plane[3]) / np.copysign(max(abs(steep), GRAZING), steep)
    return found


@compiled
def slid(points: Floats, label: Ints, planes: Floats, error_m: Floats) -> Floats:
    """Return points (n, 3) slid along their planes to where their rays meet these.

    `label` (n,), `planes` (m, 4), `error_m` (n,): see `range_errors`.
    """
    found = points.copy()
    for i in range(len(points)):
        if label[i] >= 0:
            plane, share = planes[label[i]], error_m[i] / np.sqrt(_along(points[i], points[i]))
            ahead = _along(plane, points[i])
            for a in range(3):
                found[i, a] -= share * (points[i, a] - ahead * plane[a])
    return found


@helper
def _extents(points: Floats, label: Ints, axes: Floats, beyond_m: float) -> Floats:
    """Return the least and largest coordinates (m, 2, 2) of the points of planes along two axes."""
    found = np.empty((len(axes), 2, 2))
    for k in range(len(axes)):
        for a in range(2):
            found[k, a, 0], found[k, a, 1] = np.inf, -np.inf
    for i in range(len(points)):
        if label[i] >= 0:
            for k in range(2):
                at, ends = _along(axes[label[i], 1 + k], points[i]), found[label[i], k]
                ends[0], ends[1] = min(ends[0], at - beyond_m), max(ends[1], at + beyond_m)
    return found


@compiled
def undecided(
    points: Floats, label: Ints, sigma: Floats, planes: Floats, axes: Floats, beyond_m: float
) -> Bools:
    """Return which points (n, 3) may be of another plane than theirs, by their rays.

    `label` (n,), `planes` (m, 4): see `range_errors`; `sigma` (n,): noise across planes. `axes`
    (m, 3, 3): normals and the axes along which planes extend `beyond_m` further than their points.
    """
    extents, found = _extents(points, label, axes, beyond_m), np.zeros(len(points), dtype=np.bool_)
    for i in range(len(points)):
        if label[i] < 0:
            continue
        own, range_m = planes[label[i]], np.sqrt(_along(points[i], points[i]))
        steep = abs(_along(own, points[i])) / range_m
        wide = max(steep, GRAZING)
        near_m = APART * sigma[i] / wide
        for k in range(len(planes)):
            other = _along(planes[k], points[i]) / range_m
            # Where the ray meets its plane, times the angle: its distance from the other plane.
            off_m = abs(own[3] * other - planes[k, 3] * _along(own, points[i]) / range_m)
            other = abs(other)
            if k == label[i] or off_m > near_m * (wide * other + max(other, GRAZING) * steep):
                continue
            u, v = _along(axes[k, 1], points[i]), _along(axes[k, 2], points[i])
            ends = extents[k]
            if ends[0, 0] <= u <= ends[0, 1] and ends[1, 0] <= v <= ends[1, 1]:
                found[i] = True
                break
    return found


@compiled
def numbered_cells(
    points: Floats, range_m: Floats, size_m: float, middle_m: float
) -> tuple[Ints, Ints]:
    """Return the keys (v,) of the voxels of points (n, 3), as they occur, and that of each (n,)."""
    slots = 16
    while slots < 2 * len(points):
        slots *= 2
    slot, half = np.zeros(slots, dtype=np.int64), 1 << (BITS - 1)
    keys, of = np.empty(len(points), dtype=np.int64), np.empty(len(points), dtype=np.int64)
    found, last, v = 0, -1, -1
    for i in range(len(points)):
        scale = np.sqrt(middle_m / max(range_m[i], NEAR * middle_m)) / size_m
        key = 0
        for a in range(3):
            key = (key << BITS) | (int(np.floor(points[i, a] * scale)) + half)
        if key != last:
            at = bucket_of(key, slots)
            # A slot holds the number of its voxel plus one, 0 if it is empty.
            while slot[at] > 0 and keys[slot[at] - 1] != key:
                at = (at + 1) & (slots - 1)
            if slot[at] == 0:
                keys[found], found = key, found + 1
                slot[at] = found
            v, last = slot[at] - 1, key
        of[i] = v
    return keys[:found], of


@compiled
def neighbours(keys: Ints, steps: Ints) -> Ints:
    """Return the voxels (v, s) whose keys differ from those of each by the steps; -1 for none.

    `keys` (v,), ascending; `steps` (s,), ascending: with each step there is its negative.
    """
    count, last = len(keys), len(steps) - 1
    around = np.full((count, len(steps)), -1)
    for k in range(len(steps)):
        if steps[k] < 0:
            continue
        j = 0
        for i in range(count):
            while j < count and keys[j] < keys[i] + steps[k]:
                j += 1
            if j < count and keys[j] == keys[i] + steps[k]:
                around[i, k] = j
                around[j, last - k] = i
    return around
