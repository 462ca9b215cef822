"""Compiled: the ends of a box that noise has blurred, by maximum likelihood.

Along a wall points lie evenly between two ends; noise carries some of them beyond. The outermost
points would put the ends too far out, the more so the more points there are; the maximum of the
likelihood is unbiased, and without noise it is the outermost points.

A beam stands for all bearings that are nearer to it than to its neighbours; the most likely end is
then half way between the last beam that meets the wall and the next one.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.linalg.compiling import compiled, helper
from relmap.segmentation.em.wall_kernels import (
    PEAK,
    REACH,
    foot_and_height,
    measure,
    place,
    sightings,
)
from relmap.segmentation.wall import BEGIN, END, EXACT_M

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
