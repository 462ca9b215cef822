"""Static ends of walls: the four midpoint pairs of Fig. 4, over a common interval.

For two walls, midpoints are estimated from either end of each, with a size that is fixed over the
interval; the pair with the least deviation over time has the static ends. End types given with a
scan take precedence: an end cut by the view is not tested. Without types the deviation alone
decides. A typed corner that moves is left to the engine's motion detection.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints

CUT, CORNER, UNKNOWN, LOOSE = 0, 1, 2, 4
"""Kinds of ends: of the visible part, of the wall itself, unknown; and the flag of a small
free-standing object."""
INTERVAL = 12
"""Iterations over which pairs are compared."""
STEADY = 1.6
"""Deviation, relative to that due to noise, up to which a pair has static ends."""
MOVES, MOVES_M = 4.0, 0.3
WITNESSES = 2
"""Deviation above which an end moves, relative to all ends known as corners, and their minimum
number."""


def compared_ends(
    iteration: Ints, wall: Ints, ends: Floats, sd: Floats, kind: NDArray[np.int8]
) -> tuple[Ints, Bools, Bools]:
    """Test the ends of all walls seen in an interval; an end whose kind changed is unknown.

    `iteration`, `wall` (n,): iteration and wall of each observation; `ends` (n, 2, 2), robot frame,
    metres; `sd` (n,), metres: standard deviations of the distances; `kind` (n, 2): `CUT`, `CORNER`
    or `UNKNOWN`. Returns `walls` (w,), ascending; `static`, `moving` (w, 2): of the right and the
    left end; both false if unknown.
    """
    from relmap.planes.scans.corner_kernels import relative_deviations

    walls, row = np.unique(wall, return_inverse=True)
    column = iteration - iteration[0]
    block = np.full((len(walls), int(column[-1]) + 1, 2, 2), np.nan)
    block[row, column] = ends
    mean_sd = np.bincount(row, sd) / np.bincount(row)
    least, most = np.full((len(walls), 2), UNKNOWN), np.full((len(walls), 2), CUT)
    np.minimum.at(least, row, kind)
    np.maximum.at(most, row, kind)
    possible, typed = (least == most) & (least != CUT), (least == most) & (least == CORNER)
    static, moving = np.zeros((2, len(walls), 2), dtype=np.bool_)
    for k in np.flatnonzero(possible.any(axis=1)).tolist():
        off, noise = relative_deviations(block, mean_sd, k)
        for e in np.flatnonzero(possible[k]).tolist():
            steady = off[:, e] <= STEADY * noise[:, None]
            static[k, e] = (steady & np.isfinite(off[:, e]) & possible).any()
            known = np.isfinite(off[:, e]) & typed
            apart = off[:, e] > np.maximum(MOVES * noise, MOVES_M)[:, None]
            moving[k, e] = known.sum() >= WITNESSES and apart[known].all()
    return walls, static, moving
