"""Votes of pairs of points for placements in the plane, compiled."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper

SIDE = 4096
"""Maximum number of cells along each axis; shifts that differ by this number share their votes."""


@compiled
def most_voted(
    points: Floats, there: Floats, reach_m: Floats, angles: Floats, cell_m: float
) -> tuple[Ints, Floats]:
    """Return the two shifts for each turn that most pairs of points vote for.

    Votes are counted in cells that overlap by half.

    `points` (n, 2), metres: relative to their mean, the centre of rotation; `there` (m, 2), metres:
    relative to the same point; `reach_m` (m,): largest shift of a point onto each of these;
    `angles` (k,), radians. Returns `votes` (k, 2) and `shift` (k, 2, 2), metres.
    """
    most_m = reach_m.max()
    side = min(int(2 * most_m / cell_m) + 3, SIDE)
    cells = np.zeros((side, side), dtype=np.int64)
    at = np.empty((len(points) * len(there), 2), dtype=np.int64)
    votes, shift = np.zeros((len(angles), 2), dtype=np.int64), np.zeros((len(angles), 2, 2))
    best = np.empty((2, 2), dtype=np.int64)
    for k in range(len(angles)):
        count = _cells_of(points, there, reach_m, angles[k], cell_m, at)
        _add(cells, at, count, 1)
        for rank in range(2):
            votes[k, rank] = _largest(cells, at, count, best, rank)
            # The votes of a cell are for shifts within one cell of its corner.
            shift[k, rank, 0] = best[rank, 0] * cell_m - most_m
            shift[k, rank, 1] = best[rank, 1] * cell_m - most_m
        _add(cells, at, count, -1)
    return votes, shift


@helper
def _cells_of(
    points: Floats, there: Floats, reach_m: Floats, angle: float, cell_m: float, at: Ints
) -> int:
    """Write the cell (2,) of each shift that is within reach; return how many there are."""
    cos, sin, most_m, count = np.cos(angle), np.sin(angle), reach_m.max(), 0
    for i in range(len(points)):
        x = cos * points[i, 0] - sin * points[i, 1]
        y = sin * points[i, 0] + cos * points[i, 1]
        for j in range(len(there)):
            dx, dy = there[j, 0] - x, there[j, 1] - y
            if dx * dx + dy * dy <= reach_m[j] * reach_m[j]:
                at[count, 0] = int((dx + most_m) / cell_m)
                at[count, 1] = int((dy + most_m) / cell_m)
                count += 1
    return count


@helper
def _add(cells: Ints, at: Ints, count: int, votes: int) -> None:
    """Add votes to cells and to those after them."""
    side = len(cells)
    for c in range(count):
        for ab in range(4):
            cells[(at[c, 0] + ab // 2) % side, (at[c, 1] + ab % 2) % side] += votes


@helper
def _largest(cells: Ints, at: Ints, count: int, best: Ints, rank: int) -> int:
    """Write the cell with the most votes, the second away from the first; return its votes."""
    most, side = 0, len(cells)
    best[rank, 0], best[rank, 1] = -9, -9
    for c in range(count):
        for ab in range(4):
            u, v = at[c, 0] + ab // 2, at[c, 1] + ab % 2
            beside = rank == 1 and max(abs(u - best[0, 0]), abs(v - best[0, 1])) <= 2
            if cells[u % side, v % side] > most and not beside:
                most = cells[u % side, v % side]
                best[rank, 0], best[rank, 1] = u, v
    return most
