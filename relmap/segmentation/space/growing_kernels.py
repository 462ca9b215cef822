"""Compiled loops over points and voxels; see `relmap.segmentation.space`."""

from __future__ import annotations

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled


@compiled
def add_moments(points: Floats, of: Ints, weight: Floats, moments: Floats) -> None:
    """Add the moments of points (n, 3) to those of their groups (v, 10); negative: none."""
    for i in range(len(points)):
        g = of[i]
        if g < 0:
            continue
        w, x, y, z = weight[i], points[i, 0], points[i, 1], points[i, 2]
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


@compiled
def grow(
    seed: int,
    region: int,
    plane: Floats,
    reach: Floats,
    around: Ints,
    centre: Floats,
    normal: Floats,
    open_: Bools,
    label: Ints,
    queue: Ints,
) -> int:
    """Label the voxels connected to a seed that lie on a plane; return how many.

    Parameters
    ----------
    plane : (5,) float64
        Normal, offset, and the least cosine between the normal and that of a voxel.
    reach : (v,) float64
        Largest distance of the centre of each voxel from the plane.
    open_ : (v,) bool
        Voxels that may be labelled.
    label : (v,) int64
        Region of each voxel, changed; none is `region` before the call.
    queue : (v,) int64
        Filled from its start with the voxels found.
    """
    n, found = len(label), 1
    label[seed] = region
    queue[0] = seed
    head = 0
    while head < found:
        v = queue[head]
        head += 1
        for k in range(around.shape[1]):
            w = around[v, k]
            if w < 0 or w >= n or label[w] >= 0 or not open_[w]:
                continue
            turn, off = 0.0, -plane[3]
            for a in range(3):
                turn += normal[w, a] * plane[a]
                off += centre[w, a] * plane[a]
            if turn < plane[4] or abs(off) > reach[w]:
                continue
            label[w] = region
            queue[found] = w
            found += 1
    return found


@compiled
def label_points(
    points: Floats,
    of: Ints,
    sigma: Floats,
    gate: float,
    grazing: float,
    around: Ints,
    voxel_label: Ints,
    planes: Floats,
    label: Ints,
) -> None:
    """Label each point (n,) with the nearest plane in its voxel, or if none in those around.

    The label is -1 if every plane (m, 4) is more than `gate` standard deviations away.
    """
    for i in range(len(points)):
        v, best, nearest = of[i], -1, gate * sigma[i]
        range_m = (points[i, 0] ** 2 + points[i, 1] ** 2 + points[i, 2] ** 2) ** 0.5
        for k in range(-1, around.shape[1]):
            w = v if k < 0 else around[v, k]
            if w < 0 or voxel_label[w] < 0:
                continue
            g = voxel_label[w]
            if g != best:
                off = -planes[g, 3]
                for a in range(3):
                    off += planes[g, a] * points[i, a]
                steep = max(abs(off + planes[g, 3]) / range_m, grazing)
                if abs(off) < min(nearest, gate * sigma[i] * steep):
                    best, nearest = g, abs(off)
            if k < 0:
                break
        label[i] = best
