"""Where matches put a scan, compiled; see `relmap.planes3d.hypotheses` and `fitting`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled
from relmap.core.linalg.order_kernels import medians

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@compiled
def placement_equations(
    R: Array,
    t: Array,
    axes: Array,
    centre: Array,
    planes: Array,
    root: Array,
    doubtful: float,
) -> tuple[Array, Array]:
    """Return the normal equations of a turn and a way, (6, 6) and (6,).

    Parameters
    ----------
    R : (3, 3) float64, t : (3,) float64
        The placement so far.
    axes : (r, 3, 3) float64, centre : (r, 3) float64
        Of patches, robot frame.
    planes : (r, 4) float64
        Normals and offsets of the planes that they are, map frame.
    root : (r, 3) float64
        Roots of the information of the tilt along the first two axes, and of the distance.
    doubtful : float
        Deviations from which a match counts less (Cauchy), or twice the usual if that is more.
    """
    n_rows = len(centre)
    off, J = np.zeros((n_rows, 3)), np.zeros((n_rows, 3, 6))
    size = np.zeros(n_rows)
    x = np.zeros(3)
    for r in range(n_rows):
        for k in range(3):
            for a in range(3):
                x[a] = 0.0
                for b in range(3):
                    x[a] += R[a, b] * (axes[r, k, b] if k < 2 else centre[r, b])
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                J[r, k, a] = (x[b] * planes[r, c] - x[c] * planes[r, b]) * root[r, k]
                off[r, k] += x[a] * planes[r, a]
                if k == 2:
                    off[r, k] += t[a] * planes[r, a]
                    J[r, k, 3 + a] = planes[r, a] * root[r, k]
            if k == 2:
                off[r, k] -= planes[r, 3]
            off[r, k] *= root[r, k]
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


@compiled
def crossings(
    normal: Array, off: Array, of: Index, held: Array, least_three: float, least_two: float
) -> Array:
    """Return the ways (w, 3) on which three matches agree, and those on which two do.

    Parameters
    ----------
    normal : (p, 3) float64, off : (p,) float64
        A match asks for ``normal @ way == off``.
    of : (p,) int64
        What each match is of; two of one are never taken together.
    held : (3,) float64
        The way that is gone where matches do not tell.
    least_three, least_two : float
        Least volume and area that the normals of three and two span.
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
                short_a, short_b = off[i], off[j]
                for d in range(3):
                    short_a -= a[d] * held[d]
                    short_b -= b[d] * held[d]
                cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
                along_a = (short_a - cosine * short_b) / area
                along_b = (short_b - cosine * short_a) / area
                for d in range(3):
                    ways[found, d] = held[d] + along_a * a[d] + along_b * b[d]
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
