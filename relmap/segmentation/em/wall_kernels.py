"""The hot loops of segmentation, compiled.

Walls are rows of numbers, see `relmap.segmentation.wall`.

Points lie evenly on the walls, each with noise in all directions; or on beams, evenly spaced and
`beam` radians apart, each with noise along its beam: its bearing is exact, and fixes where on the
wall it was measured.

Compiled code is cached, see `relmap.core.linalg.compiling`.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

from relmap.core.arrays import Floats
from relmap.core.linalg.compiling import compiled, helper, unrolled
from relmap.segmentation.wall import BEGIN, END, PX, PY, SHARE, UX, UY

REACH = 6.0
"""Standard deviations beyond which a Gaussian is treated as zero."""
PEAK = 1.0 / math.sqrt(2.0 * math.pi)
INFORMATION = 0.9032
"""Integral of phi**2 / Phi: the information of a blurred end, in units of density / blur."""
GRAZING = 1.56
"""With beams, a wall ends where their incidence is within this angle of grazing."""
BLUR = 0.5
"""With beams, blur of an end during the search, in beam spacings."""
NEXT = 1.0 / BLUR
"""Extent of an end: up to the next beam, and not beyond."""

_CELLS = 512
"""Cells of the tables below per standard deviation."""
_GRID = np.arange(int(2 * REACH) * _CELLS + 2) / _CELLS - REACH
_STEP = ndtr(_GRID)
_BELL = np.exp(-0.5 * _GRID**2)


@helper
def gauss_step(x: float) -> float:
    """Return the normal distribution function at x, from a table: to 5e-7."""
    if x >= REACH:
        return 1.0
    if x <= -REACH:
        return 0.0
    place = (x + REACH) * _CELLS
    cell = int(place)
    return float(_STEP[cell] + (place - cell) * (_STEP[cell + 1] - _STEP[cell]))


@helper
def bell(x: float) -> float:
    """Return exp(-x**2 / 2), from a table: to 5e-7."""
    if abs(x) >= REACH:
        return 0.0
    place = (x + REACH) * _CELLS
    cell = int(place)
    return float(_BELL[cell] + (place - cell) * (_BELL[cell + 1] - _BELL[cell]))


@compiled
def foot_and_height(wall: Floats) -> tuple[float, float]:
    """Return the position of the sensor along a wall, and its distance from the line."""
    foot = -(wall[PX] * wall[UX] + wall[PY] * wall[UY])
    height = abs(wall[PX] * wall[UY] - wall[PY] * wall[UX])
    return foot, max(height, 1e-3)


@helper
def measure(t: float, foot: float, height: float, beam: float) -> float:
    """Return the measure along a wall in which points are uniform: metres, or beam angle."""
    return math.atan((t - foot) / height) if beam > 0 else t


@compiled
def place(u: float, foot: float, height: float, beam: float) -> float:
    """Return the place along a wall for a `measure`."""
    return foot + height * math.tan(min(max(u, -GRAZING), GRAZING)) if beam > 0 else u


@compiled
def span(wall: Floats, beam: float) -> float:
    """Return the extent of a wall in its `measure`."""
    foot, height = foot_and_height(wall)
    begin, end = measure(wall[BEGIN], foot, height, beam), measure(wall[END], foot, height, beam)
    return max(end - begin, 1e-9)


@helper
def end_blur(sigma: float, beam: float) -> float:
    """Return the blur of ends, in the `measure` of a wall.

    It is given by the noise; with beams, noise moves no point off its beam, and the blur is the
    spacing of the beams.
    """
    return BLUR * beam if beam > 0 else sigma


@helper
def sighted(
    x: float, y: float, wall: Floats, foot: float, height: float, beam: float
) -> tuple[float, float, float, float]:
    """Return where a point is relative to a wall.

    Its position along the wall, as a `measure` and in metres; its distance from the line; and the
    factor by which it is farther off in the direction of its noise: across the wall, or along its
    beam, which meets the wall at that position. Infinite if the beam does not meet the wall.
    """
    x -= wall[PX]
    y -= wall[PY]
    t, d = x * wall[UX] + y * wall[UY], y * wall[UX] - x * wall[UY]
    if beam <= 0:
        return t, t, d, 1.0
    ahead = wall[PY] * wall[UX] - wall[PX] * wall[UY]
    out = ahead + d if ahead > 0 else -ahead - d
    if out <= 0:
        return 0.0, 0.0, d, np.inf
    steep = math.hypot(t - foot, out) / out
    return math.atan((t - foot) / out), foot + (t - foot) * height / out, d, steep


@compiled
def sightings(xy: Floats, wall: Floats, beam: float) -> tuple[Floats, Floats, Floats]:
    """Return positions of points (n, 2) along a wall, as `measure` and in metres, and distances.

    See `sighted`; distances are in the direction of the noise.
    """
    n = len(xy)
    u, t, off = np.empty(n), np.empty(n), np.empty(n)
    foot, height = foot_and_height(wall)
    for i in range(n):
        u[i], t[i], d, steep = sighted(xy[i, 0], xy[i, 1], wall, foot, height, beam)
        off[i] = d * steep
    return u, t, off


@unrolled
def expect(
    xy: Floats, walls: Floats, sigma: float, rest: Floats, beam: float
) -> tuple[Floats, Floats]:
    """Return the density (k, n) of each point under each wall, and of all together (n,).

    Gaussian in the direction of the noise, along the wall uniform between two blurred ends: the
    convolution of a box with a Gaussian is a difference of two normal distribution functions.
    `beam` is the angle between beams, 0 where points lie evenly on the walls. `rest` (n,) is the
    density of everything but these walls.
    """
    n, k = len(xy), len(walls)
    density, total = np.zeros((k, n)), rest.copy()
    blur, reach = end_blur(sigma, beam), NEXT if beam > 0 else REACH
    for j in range(k):
        w = walls[j]
        foot, height = foot_and_height(w)
        low, high = measure(w[BEGIN], foot, height, beam), measure(w[END], foot, height, beam)
        scale = w[SHARE] * PEAK / sigma / max(high - low, 1e-9)
        for i in range(n):
            d = (xy[i, 1] - w[PY]) * w[UX] - (xy[i, 0] - w[PX]) * w[UY]
            if abs(d) > REACH * sigma:  # no noise is greater across a wall than along a beam
                continue
            u, _, d, steep = sighted(xy[i, 0], xy[i, 1], w, foot, height, beam)
            z, first, last = abs(d) * steep / sigma, (u - low) / blur, (u - high) / blur
            if not z <= REACH or first < -reach or last > reach:
                continue  # z is NaN where a wall leads to the sensor
            density[j, i] = scale * bell(z) * (gauss_step(first) - gauss_step(last))
            if beam > 0:
                density[j, i] /= math.hypot(xy[i, 0], xy[i, 1])
            total[i] += density[j, i]
    return density, total


@helper
def weighted_line(xy: Floats, weight: Floats, wall: Floats) -> None:
    """Fit a wall's point and direction to weighted points by total least squares.

    The direction keeps its sense, and the ends are moved along.
    """
    total, x, y = 0.0, 0.0, 0.0
    for i in range(len(xy)):
        total += weight[i]
        x += weight[i] * (xy[i, 0] - wall[PX])
        y += weight[i] * (xy[i, 1] - wall[PY])
    if total <= 0:
        return
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
