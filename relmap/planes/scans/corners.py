"""Static ends of walls: the four midpoint pairs of Fig. 4, over a common interval.

For two walls, midpoints are estimated from either end of each, with a size that is fixed over the
interval; the pair with the least deviation over time has the static ends. End types given with a
scan take precedence: an end cut by the view is not tested. Without types the deviation alone
decides. A typed corner that moves is left to the engine's motion detection.
"""

from __future__ import annotations

from typing import Any

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
FEWEST = 8
"""Minimum number of common iterations."""
SKEW = 0.5
"""Sine of the smallest usable angle between two walls: for smaller ones, two ends cut by the view
move together while the robot goes straight."""
MOVED_M = 0.5
"""Minimum motion of one of two ends, as seen by the robot, for a steady pair to be static."""
NOISY_M, EXACT_M = 0.05, 0.01
"""A pair with a larger deviation due to noise alone is not informative; and a deviation below which
it counts as zero."""
BLUNT = 3.0
"""Ratio of the standard deviation of an end along its wall to that across it."""


def compared_ends(
    iteration: Ints, wall: Ints, ends: Floats, sd: Floats, kind: NDArray[np.int8]
) -> tuple[Ints, Bools, Bools]:
    """Test the ends of all walls seen in an interval; an end whose kind changed is unknown.

    `iteration`, `wall` (n,): iteration and wall of each observation; `ends` (n, 2, 2), robot frame,
    metres; `sd` (n,), metres: standard deviations of the distances; `kind` (n, 2): `CUT`, `CORNER`
    or `UNKNOWN`. Returns `walls` (w,), ascending; `static`, `moving` (w, 2): of the right and the
    left end; both false if unknown.
    """
    walls, row = np.unique(wall, return_inverse=True)
    column = iteration - iteration[0]
    block = np.full((len(walls), int(column[-1]) + 1, 2, 2), np.nan)
    block[row, column] = ends
    mean_sd = np.bincount(row, sd) / np.bincount(row)
    least, most = np.full((len(walls), 2), UNKNOWN), np.full((len(walls), 2), CUT)
    np.minimum.at(least, row, kind)
    np.maximum.at(most, row, kind)
    possible, typed = (least == most) & (least != CUT), (least == most) & (least == CORNER)
    off, noise = relative_deviations(block, mean_sd)  # by pairs of walls, then of their ends
    noise, there = noise[..., None, None], np.isfinite(off)
    static = (there & (off <= STEADY * noise) & possible[:, None]).any(axis=(1, 3)) & possible
    known = there & typed[:, None]
    moving = (known.sum(axis=(1, 3)) >= WITNESSES) & possible
    moving &= ~(known & (off <= np.maximum(MOVES * noise, MOVES_M))).any(axis=(1, 3))
    return walls, static, moving


def midpoint_pairs(first: Floats, second: Floats, size: Any, other_size: Any) -> Floats:
    """Return the four pairs of estimated midpoints in each iteration (..., k, 2, 2, 2), metres.

    From the first wall's midpoint, estimated from its right or left end, to the second's, likewise;
    the first wall's normal is along x. `first`, `second` (..., k, 2, 2), robot frame: ends of both
    walls; `size`, `other_size`: fixed sizes, metres: one each, or (..., 1, 1, 1).
    """
    inwards, along = np.array([[0.5], [-0.5]]), _along(first)
    middle, other = first + size * inwards * along, second + other_size * inwards * _along(second)
    x, y = np.moveaxis(other[..., None, :, :] - middle[..., :, None, :], -1, 0)
    ux, uy = np.moveaxis(along[..., None, :], -1, 0)
    return np.stack([ux * y - uy * x, -ux * x - uy * y], axis=-1)


def deviations(pairs: Floats, known: Bools | None = None) -> Floats:
    """Return the standard deviation (..., 2, 2) of each of four pairs (..., k, 2, 2, 2), metres.

    `known` (..., k): in which iterations; by default in all.
    """
    where = True if known is None else known[..., None, None, None]
    return np.asarray(np.sqrt(np.var(pairs, axis=-4, where=where).sum(axis=-1)))


def _along(ends: Floats) -> Floats:
    """Return unit vectors (..., 1, 2) from the right to the left end of walls (..., 2, 2)."""
    way = ends[..., 1:, :] - ends[..., :1, :]
    return np.asarray(way / np.hypot(way[..., :1], way[..., 1:]))


def relative_deviations(block: Floats, sd: Floats) -> tuple[Floats, Floats]:
    """Compare each of some walls with all others that it was seen with.

    `block` (w, k, 2, 2), robot frame, metres: ends of walls in the iterations of an interval; NaN
    where missing. `sd` (w,), metres: standard deviations of the distances of the walls. Returns
    `deviation` (w, w, 2, 2), metres: for the four pairs with each wall; infinite if not
    informative. `expected` (w, w), metres: deviation due to noise alone.
    """
    length = np.hypot(*np.moveaxis(block[:, :, 1] - block[:, :, 0], -1, 0))
    common = np.isfinite(length[:, None]) & np.isfinite(length)
    n, wall = common.sum(axis=2), np.arange(len(block))[:, None]
    known = (n >= FEWEST) & (wall != wall.T)
    size = np.where(common, length[:, None], 0.0).max(axis=2)
    order = np.argsort(~common, axis=2, kind="stable")
    begin, one = (
        block[wall, np.take_along_axis(order, k[..., None], axis=2)[..., 0]]
        for k in (np.zeros_like(n), n // 2)
    )
    way, other = one[:, :, 1] - one[:, :, 0], one.swapaxes(0, 1)
    # The rotation of the longer wall is less noisy: it defines 0 degrees.
    is_longer, longer_m = size >= size.T, np.maximum(np.maximum(size, size.T), 1e-9)
    sd_rad = np.sqrt(12.0) * np.where(is_longer, sd[:, None], sd) / longer_m
    apart_m = np.hypot(*np.moveaxis((other - one).mean(axis=2), -1, 0))
    expected = np.hypot(BLUNT * np.hypot(sd[:, None], sd), apart_m * sd_rad)
    first = np.broadcast_to(block[:, None], (*common.shape, 2, 2))
    fixed = size[..., None, None, None]
    pairs = midpoint_pairs(first, first.swapaxes(0, 1), fixed, fixed.swapaxes(0, 1))
    spread = deviations(pairs, common | ~known[..., None])
    spread = np.where(is_longer[..., None, None], spread, spread.transpose(1, 0, 3, 2))
    off_m = np.hypot(*np.moveaxis(first - begin[:, :, None], -1, 0))
    moved_m = np.where(common[..., None], off_m, 0.0).max(axis=2)
    known &= (_skew(way) >= SKEW) & (expected <= NOISY_M)
    moves = np.maximum(moved_m[..., None], moved_m.swapaxes(0, 1)[:, :, None]) >= MOVED_M
    moves &= known[..., None, None]
    by_noise = np.where(moves.any(axis=(2, 3)), np.maximum(expected, EXACT_M), np.inf)
    return np.where(moves, spread, np.inf), by_noise


def _skew(way: Floats) -> Floats:
    """Return the sine of the angle between each two walls, by their ways (w, w, 2) then."""
    (x, y), (u, v) = (np.moveaxis(each, -1, 0) for each in (way, way.swapaxes(0, 1)))
    return np.asarray(np.abs(x * v - y * u) / (np.hypot(x, y) * np.hypot(u, v)))
