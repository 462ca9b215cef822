"""A wall is a row of `WALL` numbers.

A point on it and its direction (metres, robot frame), its start and end along that direction, and
its fraction of the scan's points.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats

PX, PY, UX, UY, BEGIN, END, SHARE = range(7)
WALL = 7
LEAST = 8
"""Minimum number of points of a wall."""
EXACT_M = 1e-7
"""Noise below which the ends are the outermost points: the blur is lost in rounding."""
HIDDEN = 0.7
"""Fraction of the smaller wall's view in which two walls cannot both be seen: walls are opaque."""
FLUSH = 4.0
"""Standard deviations within which a wall in front of another is the same one."""
PARALLEL_SINE = 0.3


def corners(wall: Floats) -> Floats:
    """Return the two ends (2, 2) of a wall."""
    return wall[:2] + wall[BEGIN : END + 1, None] * wall[UX : UY + 1]


def cut(wall: Floats, hole: tuple[float, float], share: float) -> list[Floats]:
    """Return a wall as two, before and after a hole along it; `share`: of the points, before."""
    before, after = wall.copy(), wall.copy()
    before[END], after[BEGIN] = hole
    before[SHARE], after[SHARE] = wall[SHARE] * share, wall[SHARE] * (1 - share)
    return [before, after]


def flush(w: Floats, v: Floats, sigma: float) -> bool:
    """Return whether the shorter of two walls lies on the longer one's line, within noise."""
    if w[END] - w[BEGIN] < v[END] - v[BEGIN]:
        w, v = v, w
    if abs(w[UX] * v[UY] - w[UY] * v[UX]) > PARALLEL_SINE:
        return False
    return bool((np.abs((corners(v) - w[:2]) @ (-w[UY], w[UX])) < FLUSH * sigma).all())


def side_by_side(w: Floats, v: Floats) -> bool:
    """Return whether most of the shorter of two walls lies beside the longer one."""
    if w[END] - w[BEGIN] < v[END] - v[BEGIN]:
        w, v = v, w
    t = np.sort((corners(v) - w[:2]) @ w[UX : UY + 1])
    return bool(min(w[END], t[1]) - max(w[BEGIN], t[0]) > HIDDEN * (t[1] - t[0]))


def one_hides_other(w: Floats, v: Floats, sigma: float) -> bool:
    """Return whether two walls share most of the smaller one's view: the sensor sees only one.

    By more than noise explains.
    """
    spans, blur = [], 0.0
    for wall in (w, v):
        ends = corners(wall)
        middle = ends.mean(axis=0)
        turned = ends @ np.array([[middle[0], -middle[1]], [middle[1], middle[0]]])
        bearing = np.arctan2(turned[:, 1], turned[:, 0]) + np.arctan2(middle[1], middle[0])
        spans.append((bearing.min(), bearing.max()))
        blur = max(blur, sigma / max(float(np.hypot(*middle)), 1e-9))
    (a, b), (c, d) = spans
    shift = 2 * np.pi * round(((a + b) - (c + d)) / (4 * np.pi))
    shared = min(b, d + shift) - max(a, c + shift)
    return bool(shared > HIDDEN * min(b - a, d - c) + blur)


def within_reach(w: Floats, v: Floats, sigma: float) -> bool:
    """Return whether two walls come so close that they may be one."""
    reach = 4 * sigma + 0.1 * min(w[END] - w[BEGIN], v[END] - v[BEGIN])
    for one, other in ((w, v), (v, w)):
        offset = corners(other) - one[:2]
        t, d = offset @ one[UX : UY + 1], offset @ (-one[UY], one[UX])
        beyond = np.maximum(np.maximum(one[BEGIN] - t, t - one[END]), 0)
        if (np.hypot(beyond, d) < reach).any():
            return True
    return False
