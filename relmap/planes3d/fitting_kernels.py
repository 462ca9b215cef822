"""Compiled loops of `relmap.planes3d.fitting`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.rotation_kernels import turned_by
from relmap.core.linalg.compiling import helper, unrolled
from relmap.core.linalg.order_kernels import medians
from relmap.core.linalg.small_kernels import factorise, product, solve
from relmap.planes3d.fitting import BENT_RAD, DOUBTFUL, ROUNDS, SYSTEMATIC


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


@helper
def _equations(
    R: Floats, t: Floats, axes: Floats, centre: Floats, rows: Ints, planes: Floats, root: Floats
) -> tuple[Floats, Floats]:
    """Return the normal equations of a rotation and a translation, (6, 6) and (6,)."""
    n_rows = len(rows)
    off, J = np.zeros((n_rows, 3)), np.zeros((n_rows, 3, 6))
    size = np.zeros(n_rows)
    for r in range(n_rows):
        for k in range(3):
            arm = axes[rows[r], k] if k < 2 else centre[rows[r]]
            _add_row(R, t, arm, planes[r], root[r, k], k == 2, off[r, k : k + 1], J[r, k])
            size[r] += off[r, k] ** 2
        size[r] = np.sqrt(size[r])
    limit = max(DOUBTFUL, 2 * medians(np.zeros(n_rows, dtype=np.int64), size)[0])
    H, g = np.zeros((6, 6)), np.zeros(6)
    for r in range(n_rows):
        weight = 1 / (1 + (size[r] / limit) ** 2)
        for k in range(3):
            for a in range(6):
                g[a] += weight * J[r, k, a] * off[r, k]
                for b in range(a + 1):
                    H[a, b] += weight * J[r, k, a] * J[r, k, b]
    return H, g


@helper
def _damp(H: Floats) -> None:
    """Complete a symmetric matrix (6, 6) given below its diagonal, and damp free directions."""
    for part in range(0, 6, 3):
        hold = (H[part, part] + H[part + 1, part + 1] + H[part + 2, part + 2]) * 1e-12 + 1e-30
        for a in range(part, part + 3):
            H[a, a] += hold
    for a in range(6):
        for b in range(a):
            H[b, a] = H[a, b]


@helper
def _root_information(
    spread: Floats, information: Floats, centre: Floats, map_noise_m: float, root: Floats
) -> None:
    """Set the square roots of the information (3,) of a match.

    Points of a plane have some of their errors in common, and the map may be bent.
    """
    square = SYSTEMATIC**2 * (spread[2] ** 2 + map_noise_m**2)
    for k in range(3):
        if k < 2:
            shared = square / max(spread[k], 1e-9) ** 2 + BENT_RAD**2
        else:
            shared = square + BENT_RAD**2 * (centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2)
        root[k] = 1 / np.sqrt(1 / max(information[k], 1e-12) + shared)


@helper
def _set_plane(axes: Floats, centre: Floats, plane: Floats) -> None:
    """Set the normal and offset (4,) of a patch."""
    plane[3] = 0.0
    for a in range(3):
        plane[a] = axes[2, a]
        plane[3] += axes[2, a] * centre[a]


@helper
def _stepped(R: Floats, t: Floats, H: Floats, step: Floats) -> tuple[Floats, float]:
    """Solve the normal equations and move the translation; return the rotation, and the step."""
    L, largest = H.copy(), 0.0
    factorise(L)
    solve(L, step)
    for a in range(3):
        largest = max(largest, abs(step[a]), abs(step[3 + a]))
        t[a] -= step[3 + a]
        step[a] = -step[a]
    return product(turned_by(step[:3]), R), largest


@unrolled
def fit_placement(
    R: Floats,
    t: Floats,
    scan: tuple[Floats, Floats, Floats, Floats],
    there: tuple[Floats, Floats, Floats],
    match: Ints,
    settled: float,
) -> tuple[Floats, Floats, Floats]:
    """Fit a pose to matches; return its rotation, its translation and the normal matrix (6, 6).

    `R` (3, 3), `t` (3,): first estimate. `scan`: axes, centres, spreads and information of the m
    patches of the scan, robot frame. `there`: axes, centres and spreads of those of the map, map
    frame. `match` (m,): patch of the map that each of the scan matches; -1 for none. `settled`: the
    step that ends the fit: metres, radians.
    """
    axes, centre, spread, information = scan
    count, n = len(match), 0
    rows, planes, root = np.empty(count, dtype=np.int64), np.empty((count, 4)), np.empty((count, 3))
    for i in range(count):
        if match[i] < 0:
            continue
        rows[n], noise_m = i, there[2][match[i], 2]
        _set_plane(there[0][match[i]], there[1][match[i]], planes[n])
        _root_information(spread[i], information[i], centre[i], noise_m, root[n])
        n += 1
    rows, t, H = rows[:n], t.copy(), np.empty((6, 6))
    for _ in range(ROUNDS):
        H, step = _equations(R, t, axes, centre, rows, planes, root)
        _damp(H)
        R, largest = _stepped(R, t, H, step)
        if largest < settled:
            break
    return R, t, H
