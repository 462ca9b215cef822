"""The hot loops of segmentation, compiled.

A wall is a row of `WALL` numbers: a point on it and its direction (metres, robot frame), where it
begins and ends along that direction, and its share of the scan's points.  Compiled code is cached,
see `relmap.core.kernels`; this module is imported where it is used.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from relmap.core.kernels import compiled

PX, PY, UX, UY, BEGIN, END, SHARE = range(7)
WALL = 7
REACH = 6.0
"""Beyond this many standard deviations a Gaussian is taken for nothing."""
EXACT_M = 1e-7
"""Below this noise the ends are the outermost points: the blur is lost in rounding."""
PEAK = 1.0 / math.sqrt(2.0 * math.pi)


_CELLS = 512
"""Cells of the tables below per standard deviation."""
_GRID = np.arange(int(2 * REACH) * _CELLS + 2) / _CELLS - REACH
_STEP = ndtr(_GRID)
_BELL = np.exp(-0.5 * _GRID**2)


@compiled
def gauss_step(x: float) -> float:
    """Return the normal distribution function at x, from a table: to 5e-7."""
    if x >= REACH:
        return 1.0
    if x <= -REACH:
        return 0.0
    place = (x + REACH) * _CELLS
    cell = int(place)
    return float(_STEP[cell] + (place - cell) * (_STEP[cell + 1] - _STEP[cell]))


@compiled
def bell(x: float) -> float:
    """Return exp(-x**2 / 2), from a table: to 5e-7."""
    if abs(x) >= REACH:
        return 0.0
    place = (x + REACH) * _CELLS
    cell = int(place)
    return float(_BELL[cell] + (place - cell) * (_BELL[cell + 1] - _BELL[cell]))


@compiled
def span(begin: float, end: float, foot: float, height: float, rays: bool) -> float:
    """Return the measure of a stretch of wall: its length, or the angle under which it is seen."""
    measure = end - begin
    if rays:
        measure = math.atan((end - foot) / height) - math.atan((begin - foot) / height)
    return max(measure, 1e-9)


@compiled
def thickness(t: float, foot: float, height: float, rays: bool) -> float:
    """Return how densely points lie at t along a wall, per measure of `span`."""
    if rays:
        return height / (height * height + (t - foot) * (t - foot))
    return 1.0


@compiled
def foot_and_height(wall: NDArray[np.float64]) -> tuple[float, float]:
    """Return where along a wall the sensor stands, and how far off its line."""
    foot = -(wall[PX] * wall[UX] + wall[PY] * wall[UY])
    height = abs(wall[PX] * wall[UY] - wall[PY] * wall[UX])
    return foot, max(height, 1e-3)


@compiled
def expect(
    xy: NDArray[np.float64],
    walls: NDArray[np.float64],
    sigma: float,
    rest: NDArray[np.float64],
    rays: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the density (k, n) of each point under each wall, and of all together (n,).

    Gaussian across the wall, along it the sensor's own density between two ends that the noise
    blurs: the convolution of a box with a Gaussian is a difference of two normal distribution
    functions.  `rest` (n,) is the density of everything but these walls.
    """
    n, k = len(xy), len(walls)
    density, total = np.zeros((k, n)), rest.copy()
    for j in range(k):
        w = walls[j]
        foot, height = foot_and_height(w)
        measure = span(w[BEGIN], w[END], foot, height, rays)
        scale = w[SHARE] * PEAK / sigma / measure
        low, high = w[BEGIN] - REACH * sigma, w[END] + REACH * sigma
        for i in range(n):
            x, y = xy[i, 0] - w[PX], xy[i, 1] - w[PY]
            z = (y * w[UX] - x * w[UY]) / sigma
            if abs(z) > REACH:
                continue
            t = x * w[UX] + y * w[UY]
            if t < low or t > high:
                continue
            box = gauss_step((t - w[BEGIN]) / sigma) - gauss_step((t - w[END]) / sigma)
            if rays:
                box *= thickness(min(max(t, w[BEGIN]), w[END]), foot, height, rays)
            density[j, i] = scale * bell(z) * box
            total[i] += density[j, i]
    return density, total


@compiled
def weighted_line(
    xy: NDArray[np.float64], weight: NDArray[np.float64], wall: NDArray[np.float64]
) -> tuple[float, float]:
    """Fit a wall's point and direction to weighted points; return their weight and scatter across.

    Total least squares; the direction keeps its sense, the ends are moved along.
    """
    total, x, y = 0.0, 0.0, 0.0
    for i in range(len(xy)):
        total += weight[i]
        x += weight[i] * (xy[i, 0] - wall[PX])
        y += weight[i] * (xy[i, 1] - wall[PY])
    if total <= 0:
        return 0.0, 0.0
    px, py = wall[PX] + x / total, wall[PY] + y / total
    xx, xy_, yy = 0.0, 0.0, 0.0
    for i in range(len(xy)):
        if weight[i] > 0:
            dx, dy = xy[i, 0] - px, xy[i, 1] - py
            xx += weight[i] * dx * dx
            xy_ += weight[i] * dx * dy
            yy += weight[i] * dy * dy
    angle = 0.5 * math.atan2(2 * xy_, xx - yy)
    ux, uy = math.cos(angle), math.sin(angle)
    if ux * wall[UX] + uy * wall[UY] < 0:
        ux, uy = -ux, -uy
    shift = (px - wall[PX]) * ux + (py - wall[PY]) * uy
    wall[PX], wall[PY], wall[UX], wall[UY] = px, py, ux, uy
    wall[BEGIN] -= shift
    wall[END] -= shift
    across = 0.0
    for i in range(len(xy)):
        if weight[i] > 0:
            d = (xy[i, 1] - py) * ux - (xy[i, 0] - px) * uy
            across += weight[i] * d * d
    return total, across


@compiled
def wall_span(wall: NDArray[np.float64], rays: bool) -> float:
    """Return the measure of a wall, see `span`."""
    foot, height = foot_and_height(wall)
    return span(wall[BEGIN], wall[END], foot, height, rays)


@compiled
def local_density(wall: NDArray[np.float64], at: float, rays: bool) -> float:
    """Return the share of a wall's points that lie about a place on it, per metre."""
    foot, height = foot_and_height(wall)
    measure = span(wall[BEGIN], wall[END], foot, height, rays)
    return thickness(at, foot, height, rays) / max(measure, 1e-12)


@compiled
def _gather(
    xy: NDArray[np.float64],
    share: NDArray[np.float64],
    total: NDArray[np.float64],
    wall: NDArray[np.float64],
    sigma: float,
) -> NDArray[np.float64]:
    """Return what a step of EM needs of a wall's points, in the wall's own frame.

    Their weight, sums of t, d, tt, td and dd, the pull on both ends, and the outermost t.
    """
    s = np.zeros(10)
    s[8], s[9] = np.inf, -np.inf
    for i in range(len(xy)):
        if share[i] <= 0:
            continue
        w = share[i] / total[i]
        x, y = xy[i, 0] - wall[PX], xy[i, 1] - wall[PY]
        t, d = x * wall[UX] + y * wall[UY], y * wall[UX] - x * wall[UY]
        s[0] += w
        s[1] += w * t
        s[2] += w * d
        s[3] += w * t * t
        s[4] += w * t * d
        s[5] += w * d * d
        if w > 0.01:
            s[8], s[9] = min(s[8], t), max(s[9], t)
        low, high = (t - wall[BEGIN]) / sigma, (t - wall[END]) / sigma
        if low < 5 or high > -5:
            box = max(gauss_step(low) - gauss_step(high), 1e-7)
            s[6] += w * bell(low) / box
            s[7] += w * bell(high) / box
    return s


@compiled
def _turn(wall: NDArray[np.float64], s: NDArray[np.float64]) -> float:
    """Move a wall to its points' line of total least squares; return their scatter across it."""
    t, d = s[1] / s[0], s[2] / s[0]
    tt, td, dd = s[3] - s[0] * t * t, s[4] - s[0] * t * d, s[5] - s[0] * d * d
    angle = 0.5 * math.atan2(2 * td, tt - dd)
    c, q = math.cos(angle), math.sin(angle)
    ux, uy = wall[UX], wall[UY]
    wall[PX] += t * ux - d * uy
    wall[PY] += t * uy + d * ux
    wall[UX], wall[UY] = c * ux - q * uy, q * ux + c * uy
    shift = t * c + d * q
    wall[BEGIN] -= shift
    wall[END] -= shift
    return float(max(tt * q * q - 2 * td * q * c + dd * c * c, 0.0))


@compiled
def _score_ends(
    wall: NDArray[np.float64], s: NDArray[np.float64], sigma: float, rays: bool
) -> tuple[float, float]:
    """Return how far one step of Fisher scoring moves both ends, at most the noise.

    With points of density rho at an end, its information is rho / sigma times the integral of
    phi**2 / Phi, which is 0.9032.
    """
    if sigma < EXACT_M:
        return s[8] - wall[BEGIN], s[9] - wall[END]
    foot, height = foot_and_height(wall)
    rho = s[0] / span(wall[BEGIN], wall[END], foot, height, rays)
    low = rho * thickness(wall[BEGIN], foot, height, rays)
    high = rho * thickness(wall[END], foot, height, rays)
    first = (low - PEAK * s[6] / sigma) * sigma / (0.9032 * low)
    last = (PEAK * s[7] / sigma - high) * sigma / (0.9032 * high)
    limit = min(sigma, 0.2 * (wall[END] - wall[BEGIN]))
    return min(max(first, -sigma), limit), min(max(last, -limit), sigma)


@compiled
def em_step(
    xy: NDArray[np.float64],
    walls: NDArray[np.float64],
    sigma: float,
    rest: NDArray[np.float64],
    rays: bool,
    held: bool,
) -> tuple[float, float, float]:
    """Take one step of expectation and maximisation; walls (k, WALL) are changed in place.

    `held` ends stay where they are along their walls. Returns the log likelihood before the step,
    the noise after it, and the share of points that belong to the `rest` (n,), see `expect`.
    """
    density, total = expect(xy, walls, sigma, rest, rays)
    n, likelihood, loose = len(xy), 0.0, 0.0
    for i in range(n):
        likelihood += math.log(total[i])
        loose += rest[i] / total[i]
    squares, amount = 0.0, 0.0
    for j in range(len(walls)):
        s = _gather(xy, density[j], total, walls[j], sigma)
        walls[j, SHARE] = s[0] / n
        if s[0] <= 1e-9:
            continue
        first, last = (0.0, 0.0) if held else _score_ends(walls[j], s, sigma, rays)
        walls[j, BEGIN] += first
        walls[j, END] = max(walls[j, END] + last, walls[j, BEGIN] + EXACT_M)
        squares += _turn(walls[j], s)
        amount += s[0]
    return likelihood, math.sqrt(squares / max(amount - 2 * len(walls), 1.0)), loose / n
