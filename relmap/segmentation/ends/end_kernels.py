"""Compiled: the ends of walls, of blurred boxes by maximum likelihood, and where walls meet.

Along a wall points lie evenly between two ends; noise carries some of them beyond. The outermost
points would put the ends too far out, the more so the more points there are; the maximum of the
likelihood is unbiased, and without noise it is the outermost points.

A beam stands for all bearings that are nearer to it than to its neighbours; the most likely end is
then half way between the last beam that meets the wall and the next one.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.linalg.compiling import compiled, helper
from relmap.segmentation.em.wall_kernels import (
    INFORMATION,
    PEAK,
    REACH,
    foot_and_height,
    measure,
    place,
    sightings,
)
from relmap.segmentation.wall import BEGIN, END, EXACT_M, PX, PY, SHARE, UX, UY

INWARD = 5.0
"""Range of the search for an end, in standard deviations inwards of its last estimate."""
FEW = 4
"""With beams, number of beams at an end from which the point density is estimated."""
LEAST = 0.05
"""With beams, minimum weight of a point in a wall to influence its end."""
_ROOT = math.sqrt(2.0)


@helper
def exact_step(x: float) -> float:
    """Return the normal distribution function at x."""
    return 0.5 * math.erfc(-x / _ROOT)


@helper
def _end_slope(
    at: float, other: float, t: Floats, weight: Floats, blur: float, density: float, beam: float
) -> float:
    """Return how fast the log likelihood falls when the lower end of a box moves up."""
    slope = 0.0
    for i in range(len(t)):
        z = (t[i] - at) / blur
        if beam > 0:
            slope += weight[i] / blur / max(z + 0.5, 1e-3) if z < 0.5 else 0.0
        elif z > 5:
            continue
        elif z < -5:  # the ratio's asymptote, where the difference below underflows
            slope += weight[i] * -z / blur
        else:
            beyond = (t[i] - other) / blur
            box = exact_step(z) - (exact_step(beyond) if beyond > -REACH else 0.0)
            slope += weight[i] * PEAK * math.exp(-0.5 * z * z) / blur / max(box, 1e-12)
    return slope - density


@helper
def _bracket(
    begin: float, end: float, t: Floats, weight: Floats, blur: float, density: float, beam: float
) -> tuple[float, float]:
    """Return places about the lower end between which the likelihood is greatest."""
    top = min(end - 0.5 * blur, begin + INWARD * blur)
    low = high = min(begin, top - blur)
    step = 0.5 * blur
    for _ in range(60):
        if _end_slope(low, end, t, weight, blur, density, beam) < 0:
            break
        low -= step
        step *= 2
    step = 0.5 * blur
    for _ in range(60):
        if high >= top or _end_slope(high, end, t, weight, blur, density, beam) > 0:
            break
        high = min(high + step, top)
        step *= 2
    return low, high


@helper
def _below(limit: float, t: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return the places (n,) below a limit, and their weights."""
    n, places, weights = 0, np.empty(len(t)), np.empty(len(t))
    for i in range(len(t)):
        if t[i] < limit:
            places[n], weights[n] = t[i], weight[i]
            n += 1
    return places[:n], weights[:n]


@helper
def lower_end(
    begin: float, end: float, t: Floats, weight: Floats, blur: float, density: float, beam: float
) -> float:
    """Return the lower end of a blurred box, by maximum likelihood, given the upper one.

    Places and blur are in the `measure` of the wall, the density in points per measure. With beams
    the blur is their spacing.
    """
    if blur < EXACT_M:
        least = np.inf
        for i in range(len(t)):
            least = min(least, t[i]) if weight[i] > 0.01 else least
        return least if least < np.inf else begin
    t, weight = _below(begin + (INWARD + REACH) * blur, t, weight)
    low, high = _bracket(begin, end, t, weight, blur, density, beam)
    for _ in range(14):
        middle = 0.5 * (low + high)
        if _end_slope(middle, end, t, weight, blur, density, beam) < 0:
            low = middle
        else:
            high = middle
        if high - low < 1e-3 * blur:
            break
    return 0.5 * (low + high)


@helper
def _density_at(begin: float, end: float, t: Floats, weight: Floats, beam: float) -> float:
    """Return the density of points at the lower end, from the first few beams.

    Fewer of a column of beams meet a wall that is farther off: half as many make a whole column.
    """
    reach = max(min(FEW * beam, end - begin), beam)
    total = 0.0
    for i in range(len(t)):
        total += weight[i] if t[i] < begin + reach else 0.0
    return 0.5 * total / reach


@compiled
def fit_ends(
    xy: Floats, weight: Floats, wall: Floats, sigma: float, density: float, beam: float
) -> None:
    """Move both ends of a wall to where its weighted points make them most likely.

    The density is in points per `measure`; with beams, that at each end is estimated from the beams
    there.
    """
    n, least, points, w = 0, LEAST if beam > 0 else 1e-6, np.empty((len(xy), 2)), np.empty(len(xy))
    for i in range(len(xy)):
        if weight[i] > least:
            points[n, 0], points[n, 1], w[n] = xy[i, 0], xy[i, 1], weight[i]
            n += 1
    if n == 0:
        return
    u, w = sightings(points[:n], wall, beam)[0], w[:n]
    foot, height = foot_and_height(wall)
    low, high = measure(wall[BEGIN], foot, height, beam), measure(wall[END], foot, height, beam)
    blur = beam if beam > 0 else sigma
    dense = _density_at(low, high, u, w, beam) if beam > 0 else density
    low = lower_end(low, high, u, w, blur, dense, beam)
    dense = _density_at(-high, -low, -u, w, beam) if beam > 0 else density
    high = -lower_end(-high, -low, -u, w, blur, dense, beam)
    wall[BEGIN] = place(low, foot, height, beam)
    wall[END] = max(place(high, foot, height, beam), wall[BEGIN] + EXACT_M)


@compiled
def box_extent(t: Floats, sigma: float) -> tuple[float, float]:
    """Return the ends of a uniformly filled, blurred box from positions (n,), some 2000 at most."""
    t = t[:: len(t) // 2000 + 1].copy()
    low, high, weight = np.inf, -np.inf, np.ones(len(t))
    for i in range(len(t)):
        low, high = min(low, t[i]), max(high, t[i])
    if high - low <= 4 * sigma or len(t) < 8:
        return low, high
    first, last = low + sigma, high - sigma
    for _ in range(2):
        density = len(t) / max(last - first, sigma)
        first = lower_end(first, last, t, weight, sigma, density, 0.0)
        last = -lower_end(-last, -first, -t, weight, sigma, density, 0.0)
    return first, last


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
