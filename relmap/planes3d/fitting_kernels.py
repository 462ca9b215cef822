"""Compiled loops of `relmap.planes3d.hypotheses` and `relmap.planes3d.fitting`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import medians


@helper
def _add_row(
    R: Floats,
    t: Floats,
    arm: Floats,
    plane: Floats,
    root: float,
    with_way: bool,
    off: Floats,
    J: Floats,
) -> None:
    """Set the residual (1,) of a direction or point (3,), and its Jacobian (6,)."""
    x = np.zeros(3)
    for a in range(3):
        for b in range(3):
            x[a] += R[a, b] * arm[b]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        J[a] = (x[b] * plane[c] - x[c] * plane[b]) * root
        off[0] += x[a] * plane[a] * root
        if with_way:
            off[0] += t[a] * plane[a] * root
            J[3 + a] = plane[a] * root
    if with_way:
        off[0] -= plane[3] * root


@compiled
def placement_equations(
    R: Floats,
    t: Floats,
    axes: Floats,
    centre: Floats,
    planes: Floats,
    root: Floats,
    doubtful: float,
) -> tuple[Floats, Floats]:
    """Return the normal equations of a rotation and a translation, (6, 6) and (6,).

    Parameters
    ----------
    R : (3, 3) float64, t : (3,) float64
        Current estimate.
    axes : (r, 3, 3) float64, centre : (r, 3) float64
        Axes and centres of patches, robot frame.
    planes : (r, 4) float64
        Normals and offsets of the planes that they match, map frame.
    root : (r, 3) float64
        Square roots of the information of the tilt along the first two axes, and of the distance.
    doubtful : float
        Residual, in standard deviations, at which the weight is halved (Cauchy); or twice the
        median residual if that is larger.
    """
    n_rows = len(centre)
    off, J = np.zeros((n_rows, 3)), np.zeros((n_rows, 3, 6))
    size = np.zeros(n_rows)
    for r in range(n_rows):
        for k in range(3):
            arm = axes[r, k] if k < 2 else centre[r]
            _add_row(R, t, arm, planes[r], root[r, k], k == 2, off[r, k : k + 1], J[r, k])
            size[r] += off[r, k] ** 2
        size[r] = np.sqrt(size[r])
    limit = max(doubtful, 2 * medians(np.zeros(n_rows, np.int64), size)[0])
    H, g = np.zeros((6, 6)), np.zeros(6)
    for r in range(n_rows):
        weight = 1 / (1 + (size[r] / limit) ** 2)
        for k in range(3):
            for a in range(6):
                g[a] += weight * J[r, k, a] * off[r, k]
                for b in range(6):
                    H[a, b] += weight * J[r, k, a] * J[r, k, b]
    return H, g


@helper
def _way_of_two(
    a: Floats, b: Floats, off_a: float, off_b: float, held: Floats, area: float, way: Floats
) -> None:
    """Set the translation (3,) closest to the predicted one that satisfies two matches."""
    cosine = 0.0
    for d in range(3):
        off_a -= a[d] * held[d]
        off_b -= b[d] * held[d]
        cosine += a[d] * b[d]
    along_a, along_b = (off_a - cosine * off_b) / area, (off_b - cosine * off_a) / area
    for d in range(3):
        way[d] = held[d] + along_a * a[d] + along_b * b[d]


@compiled
def crossings(
    normal: Floats, off: Floats, of: Ints, held: Floats, least_three: float, least_two: float
) -> Floats:
    """Return the translations (w, 3) that satisfy three matches, and those that satisfy two.

    Parameters
    ----------
    normal : (p, 3) float64, off : (p,) float64
        A match requires ``normal @ translation == off``.
    of : (p,) int64
        Plane of the scan of each match; two matches of one plane are not combined.
    held : (3,) float64
        Predicted translation, used in the direction that two matches leave open.
    least_three, least_two : float
        Least volume and area that the normals of three and two matches span.
    """
    count, found = len(of), 0
    ways = np.empty((count * (count - 1) // 2 + count * (count - 1) * (count - 2) // 6, 3))
    for i in range(count):
        for j in range(i + 1, count):
            if of[i] == of[j]:
                continue
            a, b = normal[i], normal[j]
            cx, cy = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]
            cz = a[0] * b[1] - a[1] * b[0]
            area = cx * cx + cy * cy + cz * cz
            if area > least_two**2:
                _way_of_two(a, b, off[i], off[j], held, area, ways[found])
                found += 1
            for k in range(j + 1, count):
                if of[k] == of[i] or of[k] == of[j]:
                    continue
                c = normal[k]
                volume = cx * c[0] + cy * c[1] + cz * c[2]
                if abs(volume) <= least_three:
                    continue
                for d in range(3):
                    e, f = (d + 1) % 3, (d + 2) % 3
                    ways[found, d] = (
                        off[i] * (b[e] * c[f] - b[f] * c[e])
                        + off[j] * (c[e] * a[f] - c[f] * a[e])
                        + off[k] * (a[e] * b[f] - a[f] * b[e])
                    ) / volume
                found += 1
    return ways[:found]
