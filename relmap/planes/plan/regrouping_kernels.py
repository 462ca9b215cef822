"""Which walls lie on larger ones, compiled; see `relmap.planes.plan.regrouping`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import unset
from relmap.planes.plan.regrouping import GAP_M, TURN
from relmap.planes.walls.joining import OVERLAP

Lines = tuple[Floats, Floats, Floats, Floats, Bools]


@helper
def _ends_from(lines: Lines, s: int, k: int) -> tuple[float, float, float]:
    """Return the distances of the ends of wall k from the line of wall s, and along it."""
    middle, normal, along, reach, _ = lines
    x, y = middle[k, 0] - middle[s, 0], middle[k, 1] - middle[s, 1]
    off, places = 0.0, (0.0, 0.0)
    for e in range(2):
        fx, fy = x + reach[k, e] * along[k, 0], y + reach[k, e] * along[k, 1]
        off = max(off, abs(fx * normal[s, 0] + fy * normal[s, 1]))
        places = places[1], fx * along[s, 0] + fy * along[s, 1]
    return off, places[0], places[1]


@compiled
def gathered(
    lines: Lines,
    together: tuple[NDArray[np.int32], NDArray[np.int32]],
    order: Ints,
    across_m: float,
) -> Ints:
    """Return the wall that each (n,) is part of: itself, or the nearest of the earlier ones.

    A wall that absorbs another is extended: `reach` is updated in place.

    `lines`: middle, normal and along (n, 2), reach (n, 2), and which ends are corners (n, 2).
    `together`: for each wall those seen in one scan with it: begin (n + 1,), and walls. `order`:
    the walls (n,), the largest first. `across_m`: largest distance of both ends across, twice as
    large for two walls that overlap and were never seen in one scan.
    """
    (_, normal, _, reach, has_corner), (begin, beside) = lines, together
    n = len(order)
    part, stands, met = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64), unset(n)
    standing = 0
    for k in order:
        for at in range(begin[k], begin[k + 1]):
            met[beside[at]] = k
        size, best, wall, low, high = reach[k, 1] - reach[k, 0], np.inf, k, 0.0, 0.0
        for s in stands[:standing]:
            if normal[s, 0] * normal[k, 0] + normal[s, 1] * normal[k, 1] <= TURN:
                continue
            off, right, left = _ends_from(lines, s, k)
            if off > 2 * across_m or off >= best:
                continue
            inside = min(left, reach[s, 1]) - max(right, reach[s, 0])
            right_m = -GAP_M if has_corner[k, 0] or has_corner[s, 1] else GAP_M
            left_m = -GAP_M if has_corner[k, 1] or has_corner[s, 0] else GAP_M
            fits = off <= across_m
            fits &= right - reach[s, 1] <= right_m and reach[s, 0] - left <= left_m
            if fits or (met[s] != k and inside > OVERLAP * size):
                best, wall, low, high = off, s, right, left
        part[k] = wall
        if wall == k:
            stands[standing] = k
            standing += 1
        else:
            reach[wall, 0], reach[wall, 1] = min(reach[wall, 0], low), max(reach[wall, 1], high)
    return part
