"""Compiled loops over points and voxels; see `relmap.segmentation.space`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import diagonalise
from relmap.segmentation.space.growing import ALIKE, FEWEST_VOXELS, REGROWN, TURN
from relmap.segmentation.space.voxels import GRAZING

GATE = 3.0
"""Largest distance of points from their plane, in standard deviations."""

Connected = tuple[Floats, Floats, Ints, Floats, Floats]
"""Of each voxel (v): moments (v, 10); largest distance of its centre from its plane (v,);
neighbours (v, 26), -1 for none; centre and normal (v, 3)."""


@compiled
def add_moments(
    points: Floats, of: Ints, sigma: Floats | None, middle: Floats | None, moments: Floats
) -> None:
    """Add the moments of points (n, 3) to those of their groups (v, 10); negative: none.

    Points are weighted by their noise (n,), if it is given, and taken about the `middle` (v, 3) of
    their group, if that is given.
    """
    for i in range(len(points)):
        g = of[i]
        if g < 0:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        w = 1.0 if sigma is None else 1.0 / (sigma[i] * sigma[i])
        if middle is not None:
            x, y, z = x - middle[g, 0], y - middle[g, 1], z - middle[g, 2]
        moments[g, 0] += w
        moments[g, 1] += w * x
        moments[g, 2] += w * y
        moments[g, 3] += w * z
        moments[g, 4] += w * x * x
        moments[g, 5] += w * x * y
        moments[g, 6] += w * x * z
        moments[g, 7] += w * y * y
        moments[g, 8] += w * y * z
        moments[g, 9] += w * z * z


@helper
def _plane_of(moments: Floats, second: Floats, plane: Floats) -> float:
    """Set the normal, which points to the sensor, and offset (4,); return the variance across.

    `second` (3, 3) is set to the variances along the axes.
    """
    for a in range(3):
        for b in range(a, 3):
            # xx, xy, xz, yy, yz, zz.
            product = moments[4 + a + b + (1 if a > 0 else 0)] / moments[0]
            product -= moments[1 + a] / moments[0] * (moments[1 + b] / moments[0])
            second[a, b] = second[b, a] = product
    axes, least = diagonalise(second), 0
    for a in range(1, 3):
        least = a if second[a, a] < second[least, least] else least
    plane[3] = 0.0
    for a in range(3):
        plane[a] = axes[a, least]
        plane[3] += plane[a] * moments[1 + a] / moments[0]
    if plane[3] > 0:
        for a in range(4):
            plane[a] = -plane[a]
    return float(max(second[least, least], 0.0))


@helper
def _grow(
    seed: int, region: int, plane: Floats, voxels: Connected, open_: Bools, label: Ints, queue: Ints
) -> int:
    """Label the voxels connected to a seed that lie on a plane, and queue them; return how many."""
    (_, reach, around, centre, normal), found, head = voxels, 1, 0
    label[seed] = region
    queue[0] = seed
    while head < found:
        v = queue[head]
        head += 1
        for k in range(around.shape[1]):
            w = around[v, k]
            if w < 0 or label[w] >= 0 or not open_[w]:
                continue
            cosine, off = 0.0, -plane[3]
            for a in range(3):
                cosine += normal[w, a] * plane[a]
                off += centre[w, a] * plane[a]
            if cosine < TURN or abs(off) > reach[w]:
                continue
            label[w] = region
            queue[found] = w
            found += 1
    return found


@helper
def _unlabel(label: Ints, queue: Ints, count: int) -> None:
    for k in range(count):
        label[queue[k]] = -1


@compiled
def grow_regions(
    seeds: Ints, planes: Floats, voxels: Connected, open_: Bools, label: Ints
) -> tuple[Ints, Floats]:
    """Grow planes from seeds, refitted as they grow; return seeds (r,) and planes (r, 4).

    `seeds` (s,), `planes` (s, 4): in this order. `open_` (v,): voxels that may be labelled; seeds
    of planes of too few voxels are closed. `label` (v,): region of each voxel, -1 for none,
    changed.
    """
    queue, sums, second = np.empty(len(label), dtype=np.int64), np.empty(10), np.empty((3, 3))
    found, fitted, n = np.empty(len(seeds), dtype=np.int64), np.empty((len(seeds), 4)), 0
    for s in range(len(seeds)):
        seed = seeds[s]
        if label[seed] >= 0 or not open_[seed]:
            continue
        for a in range(4):
            fitted[n, a] = planes[s, a]
        size = count = 0
        for _ in range(REGROWN):
            _unlabel(label, queue, count)
            count = _grow(seed, n, fitted[n], voxels, open_, label, queue)
            if count <= 1.1 * size or count < FEWEST_VOXELS:
                break
            size = count
            for a in range(len(sums)):
                sums[a] = 0.0
                for k in range(count):
                    sums[a] += voxels[0][queue[k], a]
            _plane_of(sums, second, fitted[n])
        if count < FEWEST_VOXELS:
            _unlabel(label, queue, count)
            open_[seed] = False
        else:
            found[n] = seed
            n += 1
    return found[:n], fitted[:n]


@helper
def _square_off(moments: Floats, plane: Floats) -> float:
    """Return the mean square distance of points, known by their moments, from a plane."""
    x, y, z, d = plane[0], plane[1], plane[2], plane[3]
    square = moments[4] * x * x + moments[7] * y * y + moments[9] * z * z
    square += 2 * (moments[5] * x * y + moments[6] * x * z + moments[8] * y * z)
    ahead = moments[1] * x + moments[2] * y + moments[3] * z
    return float((square - 2 * d * ahead) / moments[0] + d * d)


@compiled
def join_same(pairs: Ints, sums: Floats, noise: Floats, own: Ints) -> None:
    """Join pairs (p, 2) of planes (m,) whose points lie on their common plane within the noise.

    `own` (m,) is the plane that each was joined to; it, the moments (m, 10) and the mean square of
    the noise (m,) are changed.
    """
    both, plane, second, none = np.empty(10), np.empty(4), np.empty((3, 3)), np.empty(4)
    for p in range(len(pairs)):
        a, b = own[pairs[p, 0]], own[pairs[p, 1]]
        if a == b:
            continue
        for k in range(10):
            both[k] = sums[a, k] + sums[b, k]
        _plane_of(both, second, plane)
        same = True
        for one in (a, b):
            thin = max(noise[one], _plane_of(sums[one], second, none) / (ALIKE * ALIKE))
            same &= _square_off(sums[one], plane) < ALIKE * ALIKE * thin
        if not same:
            continue
        a, b = min(a, b), max(a, b)
        noise[a] = (noise[a] * sums[a, 0] + noise[b] * sums[b, 0]) / both[0]
        for k in range(10):
            sums[a, k] = both[k]
        for k in range(len(own)):
            if own[k] == b:
                own[k] = a


@helper
def _planes_around(around: Ints, label: Ints) -> tuple[Ints, Ints]:
    """Return the planes of each voxel (v,), or if it has none those of the voxels around it.

    They are in one array, voxel by voxel; the second one (v + 1,) holds the first of each voxel.
    """
    choice = np.empty(len(label) * around.shape[1], dtype=np.int64)
    first, n = np.zeros(len(label) + 1, dtype=np.int64), 0
    for v in range(len(label)):
        if label[v] >= 0:
            choice[n], n = label[v], n + 1
        else:
            for k in range(around.shape[1]):
                w = around[v, k]
                known = w < 0 or label[w] < 0
                for other in range(first[v], n):
                    known |= choice[other] == label[w]
                if not known:
                    choice[n], n = label[w], n + 1
        first[v + 1] = n
    return choice, first


@compiled
def label_points(
    points: Floats,
    of: Ints,
    sigma: Floats,
    around: Ints,
    voxel_label: Ints,
    planes: Floats,
    label: Ints,
    steepness: Floats,
) -> None:
    """Label each point (n,) with the nearest plane in its voxel, or if none in those around.

    The label is -1 if every plane (m, 4) is more than `GATE` standard deviations away. `steepness`
    (n,) is set to the fraction of an error along the ray that is across the plane; 1 for none.
    """
    choice, first = _planes_around(around, voxel_label)
    for i in range(len(points)):
        v, best, nearest, steepness[i] = of[i], -1, GATE * sigma[i], 1.0
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        range_m = np.sqrt(x * x + y * y + z * z)
        for k in range(first[v], first[v + 1]):
            g = choice[k]
            ahead = planes[g, 0] * x + planes[g, 1] * y + planes[g, 2] * z
            off, steep = ahead - planes[g, 3], max(abs(ahead) / range_m, GRAZING)
            if abs(off) < min(nearest, GATE * sigma[i] * steep):
                best, nearest, steepness[i] = g, abs(off), steep
        label[i] = best
