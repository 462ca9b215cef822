"""Compiled: the ends of a box that noise has blurred, by maximum likelihood.

Along a wall points lie evenly (or by beams) between two ends; noise carries some of them beyond.
The outermost points would put the ends too far out, by more the more points there are; the maximum
of the likelihood is unbiased, and without noise it is the outermost points.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled
from relmap.segmentation.kernels import (
    BEGIN,
    END,
    EXACT_M,
    PEAK,
    PX,
    PY,
    REACH,
    UX,
    UY,
    foot_and_height,
    thickness,
)

INWARD = 5.0
"""An end is looked for no more than so many standard deviations inwards of where it was."""
_ROOT = math.sqrt(2.0)


@compiled
def exact_step(x: float) -> float:
    """Return the normal distribution function at x."""
    return 0.5 * math.erfc(-x / _ROOT)


@compiled
def _end_slope(
    at: float,
    other: float,
    t: NDArray[np.float64],
    weight: NDArray[np.float64],
    sigma: float,
    density: float,
    shape: tuple[float, float, bool],
) -> float:
    """Return how fast the log likelihood falls when the lower end of a box moves up."""
    foot, height, rays = shape
    slope = 0.0
    for i in range(len(t)):
        z = (t[i] - at) / sigma
        if z > 5:
            continue
        if z < -5:  # the ratio's asymptote, where the difference below underflows
            slope += weight[i] * -z / sigma
        else:
            beyond = (t[i] - other) / sigma
            box = exact_step(z) - (exact_step(beyond) if beyond > -REACH else 0.0)
            slope += weight[i] * PEAK * math.exp(-0.5 * z * z) / sigma / max(box, 1e-12)
    return slope - density * thickness(at, foot, height, rays)


@compiled
def _bracket(
    begin: float,
    end: float,
    t: NDArray[np.float64],
    weight: NDArray[np.float64],
    sigma: float,
    density: float,
    shape: tuple[float, float, bool],
) -> tuple[float, float]:
    """Return places about the lower end between which the likelihood is greatest."""
    top = min(end - 0.5 * sigma, begin + INWARD * sigma)
    low = high = min(begin, top - sigma)
    step = 0.5 * sigma
    for _ in range(60):
        if _end_slope(low, end, t, weight, sigma, density, shape) < 0:
            break
        low -= step
        step *= 2
    step = 0.5 * sigma
    for _ in range(60):
        if high >= top or _end_slope(high, end, t, weight, sigma, density, shape) > 0:
            break
        high = min(high + step, top)
        step *= 2
    return low, high


@compiled
def _outermost(t: NDArray[np.float64], weight: NDArray[np.float64], otherwise: float) -> float:
    """Return the lowest position that belongs to the wall at all."""
    lowest = np.inf
    for i in range(len(t)):
        if weight[i] > 0.01 and t[i] < lowest:
            lowest = t[i]
    return lowest if lowest < np.inf else otherwise


@compiled
def lower_end(
    begin: float,
    end: float,
    t: NDArray[np.float64],
    weight: NDArray[np.float64],
    sigma: float,
    density: float,
    shape: tuple[float, float, bool],
) -> float:
    """Return the lower end of a blurred box, by maximum likelihood, with the upper one given.

    The density is in points per measure of `span`; the shape tells foot, height and whether the
    points lie by beams.
    """
    if sigma < EXACT_M:
        return _outermost(t, weight, begin)
    near = t < begin + (INWARD + REACH) * sigma
    t, weight = t[near], weight[near]
    low, high = _bracket(begin, end, t, weight, sigma, density, shape)
    for _ in range(14):
        middle = 0.5 * (low + high)
        if _end_slope(middle, end, t, weight, sigma, density, shape) < 0:
            low = middle
        else:
            high = middle
        if high - low < 1e-3 * sigma:
            break
    return 0.5 * (low + high)


@compiled
def fit_ends(
    xy: NDArray[np.float64],
    weight: NDArray[np.float64],
    wall: NDArray[np.float64],
    sigma: float,
    density: float,
    rays: bool,
) -> None:
    """Move both ends of a wall to where its weighted points make them most likely."""
    n, m = len(xy), 0
    t, w = np.empty(n), np.empty(n)
    for i in range(n):
        if weight[i] > 1e-6:
            t[m] = (xy[i, 0] - wall[PX]) * wall[UX] + (xy[i, 1] - wall[PY]) * wall[UY]
            w[m] = weight[i]
            m += 1
    if m == 0:
        return
    t, w = t[:m], w[:m]
    foot, height = foot_and_height(wall)
    low, high, shape = wall[BEGIN], wall[END], (foot, height, rays)
    mirrored = (-foot, height, rays)
    wall[BEGIN] = lower_end(low, high, t, w, sigma, density, shape)
    high = -lower_end(-high, -wall[BEGIN], -t, w, sigma, density, mirrored)
    wall[END] = max(high, wall[BEGIN] + EXACT_M)


@compiled
def box_extent(t: NDArray[np.float64], sigma: float) -> tuple[float, float]:
    """Return the ends of an evenly filled, blurred box from positions (n,); of many, a part."""
    t = t[:: len(t) // 2000 + 1]
    low, high, weight = t.min(), t.max(), np.ones(len(t))
    if high - low <= 4 * sigma or len(t) < 8:
        return low, high
    shape = (0.0, 1.0, False)
    first, last = low + sigma, high - sigma
    for _ in range(2):
        density = len(t) / max(last - first, sigma)
        first = lower_end(first, last, t, weight, sigma, density, shape)
        last = -lower_end(-last, -first, -t, weight, sigma, density, shape)
    return first, last
