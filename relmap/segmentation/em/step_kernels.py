"""Compiled: a step of expectation and maximisation, and the likeliest line of a wall's points."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.linalg.compiling import compiled, helper
from relmap.segmentation.em.wall_kernels import (
    INFORMATION,
    PEAK,
    bell,
    end_blur,
    expect,
    foot_and_height,
    gauss_step,
    measure,
    place,
    sighted,
    weighted_line,
)
from relmap.segmentation.wall import BEGIN, END, EXACT_M, PX, PY, SHARE, UX, UY

NEWTON = 3
"""Iterations to find the most likely line."""


@helper
def _gather(
    xy: Floats, share: Floats, total: Floats, wall: Floats, sigma: float, beam: float
) -> Floats:
    """Return the statistics of a wall's points for a step of EM, in the wall's frame.

    The sum of their weights; weighted also by the precision across the wall, the sums of 1, t, d,
    tt, td and dd; the pull on both ends; and the outermost measures.
    """
    s = np.zeros(11)
    s[9], s[10] = np.inf, -np.inf
    foot, height = foot_and_height(wall)
    begin, end = measure(wall[BEGIN], foot, height, beam), measure(wall[END], foot, height, beam)
    blur = end_blur(sigma, beam)
    for i in range(len(xy)):
        if share[i] <= 0:
            continue
        w = share[i] / total[i]
        u, t, d, steep = sighted(xy[i, 0], xy[i, 1], wall, foot, height, beam)
        sure = w * steep * steep
        s[0] += w
        s[1] += sure
        s[2] += sure * t
        s[3] += sure * d
        s[4] += sure * t * t
        s[5] += sure * t * d
        s[6] += sure * d * d
        if w > 0.01:
            s[9], s[10] = min(s[9], u), max(s[10], u)
        low, high = (u - begin) / blur, (u - end) / blur
        if low < 5 or high > -5:
            box = max(gauss_step(low) - gauss_step(high), 1e-7)
            s[7] += w * bell(low) / box
            s[8] += w * bell(high) / box
    return s


@helper
def _turn(wall: Floats, s: Floats, begin: float, end: float, beam: float) -> float:
    """Fit a wall to its points by least squares, between two measures; return the scatter.

    Total least squares across the wall; along beams, whose bearings are exact, plain ones.
    """
    t, d = s[2] / s[1], s[3] / s[1]
    tt, td, dd = s[4] - s[1] * t * t, s[5] - s[1] * t * d, s[6] - s[1] * d * d
    angle = math.atan2(td, tt) if beam > 0 else 0.5 * math.atan2(2 * td, tt - dd)
    c, q = math.cos(angle), math.sin(angle)
    ux, uy = wall[UX], wall[UY]
    ahead = wall[PY] * ux - wall[PX] * uy
    wall[PX] += t * ux - d * uy
    wall[PY] += t * uy + d * ux
    wall[UX], wall[UY] = c * ux - q * uy, q * ux + c * uy
    if beam > 0:  # the ends keep their bearings
        turn = angle if ahead > 0 else -angle
        foot, height = foot_and_height(wall)
        wall[BEGIN] = place(begin + turn, foot, height, beam)
        wall[END] = place(end + turn, foot, height, beam)
    else:
        shift = t * c + d * q
        wall[BEGIN], wall[END] = begin - shift, end - shift
    wall[END] = max(wall[END], wall[BEGIN] + EXACT_M)
    return float(max(tt * q * q - 2 * td * q * c + dd * c * c, 0.0))


@compiled
def fit_line(xy: Floats, wall: Floats, beam: float) -> None:
    """Move a wall to the most likely line of points (n, 2), all assigned to it."""
    ones = np.ones(len(xy))
    weighted_line(xy, ones, wall)
    for _ in range(NEWTON if beam > 0 else 0):
        s = _gather(xy, ones, ones, wall, 1.0, beam)
        if not np.isfinite(s[1]):
            return
        _turn(wall, s, 0.0, 0.0, beam)


@helper
def _score_ends(s: Floats, begin: float, end: float, blur: float) -> tuple[float, float]:
    """Return both ends, in the wall's measure, after a step of Fisher scoring, at most the blur.

    With points of density rho at an end, its information is `INFORMATION` * rho / blur.
    """
    if blur < EXACT_M:
        return s[9], s[10]
    rho = s[0] / max(end - begin, 1e-9)
    first = (rho - PEAK * s[7] / blur) * blur / (INFORMATION * rho)
    last = (PEAK * s[8] / blur - rho) * blur / (INFORMATION * rho)
    limit = min(blur, 0.2 * (end - begin))
    return begin + min(max(first, -blur), limit), end + min(max(last, -limit), blur)


@compiled
def em_step(
    xy: Floats, walls: Floats, sigma: float, rest: Floats, beam: float, held: bool
) -> tuple[float, float, float]:
    """Take one step of expectation and maximisation; walls (k, WALL) are changed in place.

    `held` ends are fixed along their walls. Returns the log likelihood before the step, the noise
    after it, and the fraction of points that belong to the `rest` (n,), see `expect`.
    """
    density, total = expect(xy, walls, sigma, rest, beam)
    n, likelihood, loose = len(xy), 0.0, 0.0
    for i in range(n):
        likelihood += math.log(total[i])
        loose += rest[i] / total[i]
    squares, amount = 0.0, 0.0
    for j in range(len(walls)):
        s = _gather(xy, density[j], total, walls[j], sigma, beam)
        walls[j, SHARE] = s[0] / n
        if s[0] <= 1e-9:
            continue
        foot, height = foot_and_height(walls[j])
        begin = measure(walls[j, BEGIN], foot, height, beam)
        end = measure(walls[j, END], foot, height, beam)
        if not held:
            begin, end = _score_ends(s, begin, end, end_blur(sigma, beam))
        squares += _turn(walls[j], s, begin, end, beam)
        amount += s[0]
    return likelihood, math.sqrt(squares / max(amount - 2 * len(walls), 1.0)), loose / n
