"""Corners where walls meet, compiled; see `relmap.segmentation.ends.corners`."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.linalg.compiling import compiled, helper
from relmap.segmentation.em.wall_kernels import INFORMATION, foot_and_height
from relmap.segmentation.wall import BEGIN, END, PX, PY, SHARE, UX, UY

GATE = 3.0
"""Largest distance of an end from its corner, in standard deviations."""
LEAST_SINE = 0.25
"""Smallest angle between walls that determines a corner."""
CONTESTED = 0.5
"""Additional error of the ends of two meeting walls, which compete for points, in units of the
noise."""
WORTH = 2.0
"""A crossing this many times less accurate than the end is not used."""
WANDER = 4.0
"""Maximum movement of an end, relative to its wall and in standard deviations: with few points, the
allowed range grows with every move."""


@helper
def _end_spread(wall: Floats, sigma: float, n: int, beam: float, found: Floats) -> None:
    """Write the standard deviations of the ends (2,) of a wall among n points.

    They follow from the noise and the spacing of points; between two beams the position is uniform.
    """
    foot, height = foot_and_height(wall)
    low, high = wall[BEGIN] - foot, wall[END] - foot
    span = high - low
    if beam > 0:  # points are uniform in angle
        span = math.atan(high / height) - math.atan(low / height)
    for side in range(2):
        off = high if side else low
        apart = (height**2 + off**2) / height if beam > 0 else 1.0
        density = wall[SHARE] * n / max(max(span, 1e-9) * apart, 1e-12)
        spacing = 1 / max(density, 1e-9)
        blur = sigma * spacing / INFORMATION + spacing**2
        found[side] = math.sqrt(blur + (beam * apart) ** 2 / 12)


@helper
def _crossing(wall: Floats, other: Floats) -> tuple[float, float]:
    """Return where a wall crosses another one, along itself, and the sine of their angle."""
    ux, uy, vx, vy = wall[UX], wall[UY], other[UX], other[UY]
    dx, dy, cross = other[PX] - wall[PX], other[PY] - wall[PY], ux * vy - uy * vx
    size = abs(cross)
    return (dx * vy - dy * vx) / (1e-12 if size < 1e-12 else cross), max(size, 1e-12)


@helper
def _across(wall: Floats, place: float, sigma: float, n: int) -> float:
    """Return the standard deviation of the line of a wall at a place along it."""
    amount, length = max(wall[SHARE] * n, 3.0), max(wall[END] - wall[BEGIN], 1e-9)
    off = (place - 0.5 * (wall[BEGIN] + wall[END])) / length
    return sigma * math.sqrt((1 + 12 * off**2) / amount)


@helper
def _meet_one(
    walls: Floats, pair: tuple[int, int], sigma: float, n: int, blur: Floats, found: Floats
) -> None:
    """Note where a wall meets another one, for its ends that reach it.

    `found` (2, 3), of both ends: the least miss so far, in tolerances, place and its accuracy.
    """
    wall, other, own, its = walls[pair[0]], walls[pair[1]], blur[pair[0]], blur[pair[1]]
    place, sine = _crossing(wall, other)
    if sine <= LEAST_SINE:
        return
    there = _crossing(other, wall)[0]
    spread = math.hypot(_across(wall, place, sigma, n), _across(other, there, sigma, n)) / sine
    widest = math.hypot(max(its[0], its[1]), CONTESTED * sigma)
    reach = GATE * math.hypot(spread, widest)
    if not other[BEGIN] - reach < there < other[END] + reach:
        return
    for side in range(2):
        gate = GATE * math.hypot(spread, math.hypot(own[side], CONTESTED * sigma))
        miss = abs(place - wall[BEGIN + side]) / gate
        if spread < WORTH * own[side] and miss < found[side, 0]:
            found[side, 0], found[side, 1], found[side, 2] = miss, place, spread


@compiled
def met(walls: Floats, sigma: float, n: int, beam: float) -> tuple[Floats, Floats, Bools]:
    """Return walls (k, WALL) that end where they meet others; see `corners.meet`.

    Also returns the standard deviation of each end (k, 2), and whether it is in a corner.
    """
    k, moved, found = len(walls), walls.copy(), np.zeros((2, 3))
    blur, joined = np.empty((k, 2)), np.zeros((k, 2), dtype=np.bool_)
    for i in range(k):
        _end_spread(walls[i], sigma, n, beam, blur[i])
    accuracy = blur.copy()
    for i in range(k):
        found[0, 0] = found[1, 0] = 1.0
        for j in range(k):
            _meet_one(walls, (i, j), sigma, n, blur, found)
        length = max(walls[i, END] - walls[i, BEGIN], 1e-9)
        for side in range(2):
            off = abs(found[side, 1] - walls[i, BEGIN + side])
            if found[side, 0] < 1 and off < max(WANDER * sigma, 0.5 * length):
                moved[i, BEGIN + side], accuracy[i, side] = found[side, 1], found[side, 2]
                joined[i, side] = True
        if moved[i, END] - moved[i, BEGIN] <= 0.2 * length:
            for side in range(2):
                moved[i, BEGIN + side], joined[i, side] = walls[i, BEGIN + side], False
    return moved, accuracy, joined
