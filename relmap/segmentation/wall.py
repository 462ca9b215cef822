"""A wall is a row of `WALL` numbers.

A point on it and its direction (metres, robot frame), its start and end along that direction, and
its fraction of the scan's points.
"""

from __future__ import annotations

from relmap.core.arrays import Floats

PX, PY, UX, UY, BEGIN, END, SHARE = range(7)
WALL = 7
LEAST = 8
"""Minimum number of points of a wall."""
EXACT_M = 1e-7
"""Noise below which the ends are the outermost points: the blur is lost in rounding."""


def corners(wall: Floats) -> Floats:
    """Return the two ends (2, 2) of a wall."""
    return wall[:2] + wall[BEGIN : END + 1, None] * wall[UX : UY + 1]


def cut(wall: Floats, hole: tuple[float, float], share: float) -> list[Floats]:
    """Return a wall as two, before and after a hole along it; `share`: of the points, before."""
    before, after = wall.copy(), wall.copy()
    before[END], after[BEGIN] = hole
    before[SHARE], after[SHARE] = wall[SHARE] * share, wall[SHARE] * (1 - share)
    return [before, after]
