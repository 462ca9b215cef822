"""A wall is a row of `WALL` numbers.

A point on it and its direction (metres, robot frame), its start and end along that direction, and
its fraction of the scan's points.
"""

from __future__ import annotations

from relmap.core.arrays import Floats

PX, PY, UX, UY, BEGIN, END, SHARE = range(7)
WALL = 7
EXACT_M = 1e-7
"""Noise below which the ends are the outermost points: the blur is lost in rounding."""


def corners(wall: Floats) -> Floats:
    """Return the two ends (2, 2) of a wall."""
    return wall[:2] + wall[BEGIN : END + 1, None] * wall[UX : UY + 1]
