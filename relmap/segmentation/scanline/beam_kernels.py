"""Compiled loops over the beams of a 2-D laser scan."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import median
from relmap.segmentation.em.wall_kernels import weighted_line
from relmap.segmentation.scanline.lines import MEDIAN
from relmap.segmentation.wall import BEGIN, END, PX, PY, SHARE, UX, UY, WALL

STEEP = math.radians(4.0)
"""Smallest incidence angle at which a wall is followed from beam to beam."""
SKIPPED = 2.5
"""Number of consecutive beams without a return that break a wall."""
STRAYS = 3
"""Number of consecutive beams on another object that do not split a wall."""
DOOR_M = 0.5
"""Width of a gap, crossed by beams, that splits a wall."""
OPEN = 0.9
"""Number of beams that must cross it."""
OFF = 5.0
"""Standard deviations of a point above which a line does not fit."""
INLIER, ROUNDS = 5 / MEDIAN, 10
"""Five standard deviations, in medians: larger deviations are not noise; and the maximum number of
times that these are excluded."""
CHANCE = 1e-3
"""Largest probability that the points of a wall form a line by chance."""
LIMIT = 4.0
"""Mean square of two neighbours, relative to the noise, above which a line does not fit."""


@helper
def _fit(xy: Floats, first: int, last: int) -> Floats:
    """Return the wall through points first to last (excluded), from the first to the last."""
    wall = np.zeros(WALL)
    wall[PX], wall[PY] = xy[first, 0], xy[first, 1]
    wall[UX], wall[UY] = xy[last - 1, 0] - xy[first, 0], xy[last - 1, 1] - xy[first, 1]
    weighted_line(xy[first:last], np.ones(last - first), wall)
    for end, i in ((BEGIN, first), (END, last - 1)):
        wall[end] = (xy[i, 0] - wall[PX]) * wall[UX] + (xy[i, 1] - wall[PY]) * wall[UY]
    return wall


@helper
def _off(xy: Floats, i: int, wall: Floats) -> float:
    return float(abs((xy[i, 1] - wall[PY]) * wall[UX] - (xy[i, 0] - wall[PX]) * wall[UY]))


@helper
def turns(xy: Floats) -> Floats:
    """Return the angles (n - 1,) from each point to the next as the sensor sees them."""
    turn = np.empty(len(xy) - 1)
    for i in range(len(turn)):
        x = xy[i, 0] * xy[i + 1, 0] + xy[i, 1] * xy[i + 1, 1]
        turn[i] = abs(math.atan2(xy[i, 0] * xy[i + 1, 1] - xy[i, 1] * xy[i + 1, 0], x))
    return turn


@compiled
def off_chords(xy: Floats, reach: int) -> float:
    """Return the median distance of points (n,) from lines through the middle of their neighbours.

    The lines are parallel to the chord of the points `reach` before and after: with 1 it is that of
    the neighbours. Points farther off than noise explains are excluded, repeatedly.
    """
    off, inliers = np.empty(len(xy) - 2 * reach), np.empty(len(xy) - 2 * reach)
    for i in range(len(off)):
        k = i + reach
        dx, dy = xy[k + reach, 0] - xy[i, 0], xy[k + reach, 1] - xy[i, 1]
        across = dx * (xy[k, 1] - xy[k - 1, 1]) - dy * (xy[k, 0] - xy[k - 1, 0])
        across -= (dx * (xy[k + 1, 1] - xy[k - 1, 1]) - dy * (xy[k + 1, 0] - xy[k - 1, 0])) / 2
        off[i] = abs(across) / max(math.hypot(dx, dy), 1e-12)
    middle = median(off.copy())
    for _ in range(ROUNDS):
        before, limit, n = middle, INLIER * middle, 0
        for i in range(len(off)):
            if off[i] <= limit:
                inliers[n] = off[i]
                n += 1
        middle = median(inliers[:n])
        if middle == before:
            break
    return middle


@helper
def radii(xy: Floats) -> Floats:
    """Return the ranges of points (n,)."""
    radius = np.empty(len(xy))
    for i in range(len(xy)):
        radius[i] = math.hypot(xy[i, 0], xy[i, 1])
    return radius


@helper
def breaks(xy: Floats, turn: Floats, free: Floats, sigma: float) -> Bools:
    """Return after which points (n,) the next one is on another surface.

    `free` are the angles (n - 1,) between them without those of beams that hit specks.
    """
    usual, radius = median(turn.copy()), radii(xy)
    broken = np.zeros(len(xy), dtype=np.bool_)
    for i in range(len(xy) - 1):
        gap = math.hypot(xy[i + 1, 0] - xy[i, 0], xy[i + 1, 1] - xy[i, 1])
        near = min(radius[i], radius[i + 1])
        steep = math.sin(max(STEEP - turn[i], 0.3 * STEEP))
        limit = near * math.sin(min(turn[i], STEEP)) / steep + 6 * sigma
        broken[i] = free[i] > SKIPPED * usual + 1e-9 or gap > limit
    return broken


@helper
def _split_at(xy: Floats, first: int, last: int, sigma: float) -> int:
    """Return where points first to last (excluded) bend most; -1 if one line fits them."""
    wall = _fit(xy, first, last)
    worst = 0.0
    for i in range(first, last):
        worst = max(worst, _off(xy, i, wall))
    if worst <= OFF * sigma:
        return -1
    cx, cy = xy[last - 1, 0] - xy[first, 0], xy[last - 1, 1] - xy[first, 1]
    length, at, most = max(math.hypot(cx, cy), 1e-12), -1, -1.0
    for i in range(first + 1, last - 1):
        off = abs((xy[i, 1] - xy[first, 1]) * cx - (xy[i, 0] - xy[first, 0]) * cy) / length
        if off > most:
            most, at = off, i
    return at


@helper
def _scatter(xy: Floats, first: int, last: int) -> float:
    """Return the sum of squares of points first to last (excluded) about their line."""
    wall, total = _fit(xy, first, last), 0.0
    for i in range(first, last):
        total += _off(xy, i, wall) ** 2
    return total


@helper
def _shift_breaks(xy: Floats, broken: Bools, pieces: Ints) -> None:
    """Assign each point beside a bend to the nearer line."""
    for k in range(len(pieces) - 1):
        a, b, c, d = pieces[k, 0], pieces[k, 1], pieces[k + 1, 0], pieces[k + 1, 1]
        if b != c or broken[b - 1] or b - a < 4 or d - c < 4:
            continue
        left, right = _fit(xy, a, b - 1), _fit(xy, c + 1, d)
        while b - a > 3 and _off(xy, b - 1, right) < _off(xy, b - 1, left):
            b -= 1
        if b == c:
            while d - b > 3 and _off(xy, b, left) < _off(xy, b, right):
                b += 1
        pieces[k, 1] = pieces[k + 1, 0] = b


@helper
def _straight(xy: Floats, first: int, last: int, sigma: float, pieces: Ints, n: int) -> int:
    """Split points first to last (excluded) where they bend; add the pieces after n others.

    Returns the number of all pieces.
    """
    ends, waiting = np.empty(last - first, dtype=np.int64), 1  # of parts, the next one last
    ends[0] = last
    while waiting > 0:
        end = ends[waiting - 1]
        at = _split_at(xy, first, end, sigma) if end - first >= 3 else -1
        if at >= 0:
            ends[waiting] = at
            waiting += 1
            continue
        if end - first >= 3:
            pieces[n, 0], pieces[n, 1] = first, end
            n += 1
        first, waiting = end, waiting - 1
    return n


@helper
def _open_between(xy: Floats, turn: Floats, b: int, c: int, sigma: float) -> bool:
    """Return whether beams pass between point b - 1 and point c.

    Objects nearer than the wall only hide it.
    """
    wide = math.hypot(xy[c, 0] - xy[b - 1, 0], xy[c, 1] - xy[b - 1, 1])
    if wide < DOOR_M:
        return False
    between, through = 0.0, 0
    for i in range(b - 1, c):
        between += turn[i]
    unseen = between / median(turn.copy()) - (c - b) - 1
    x, y = xy[b - 1, 0], xy[b - 1, 1]
    ux, uy = (xy[c, 0] - x) / wide, (xy[c, 1] - y) / wide
    side = x * uy - y * ux  # position of the sensor
    for i in range(b, c):
        off = (xy[i, 1] - y) * ux - (xy[i, 0] - x) * uy
        if off * side < 0 and abs(off) > OFF * sigma:
            through += 1
    return bool(unseen + through >= OPEN)


@helper
def _join(xy: Floats, turn: Floats, pieces: Ints, sigma: float) -> int:
    """Join neighbours that one line fits; return the number of pieces left, the first ones."""
    k = 0
    for other in range(1, len(pieces)):
        a, b, c, d = pieces[k, 0], pieces[k, 1], pieces[other, 0], pieces[other, 1]
        fits = c - b <= STRAYS and _scatter(xy, a, d) < LIMIT * sigma**2 * (d - a)
        fits = fits and not _open_between(xy, turn, b, c, sigma)
        if fits and _split_at(xy, a, d, 1.5 * sigma) < 0:
            pieces[k, 1] = d
        else:
            k += 1
            pieces[k, 0], pieces[k, 1] = c, d
    return min(k + 1, len(pieces))


@helper
def _by_chance(xy: Floats, first: int, last: int, sigma: float) -> float:
    """Return the probability that points first to last (excluded) form a line by chance.

    The first and the last define a line; the others lie within their band, out of an area as wide
    as the line is long.
    """
    wall, worst = _fit(xy, first, last), sigma
    for i in range(first, last):
        worst = max(worst, _off(xy, i, wall))
    return float(min(2 * worst / max(wall[END] - wall[BEGIN], 1e-12), 1.0) ** (last - first - 2))


@compiled
def line_pieces(xy: Floats, beam: Ints, sigma: float) -> tuple[Ints, Floats]:
    """Return the straight pieces (m, 2) of a scan: first point, and one after the last.

    Also returns the walls (m, WALL) through them. Pieces that are probable by chance are left out.
    `beam` are the numbers (n,) of the points before specks were left out.
    """
    pieces, n, start = np.empty((len(xy), 2), dtype=np.int64), 0, 0
    if len(xy) >= 3:
        turn = turns(xy)
        usual, free = median(turn.copy()), turn.copy()
        for i in range(len(turn)):
            free[i] -= (beam[i + 1] - beam[i] - 1) * usual
        broken = breaks(xy, turn, free, sigma)
        for i in range(len(xy)):
            if broken[i] or i == len(xy) - 1:
                n, start = _straight(xy, start, i + 1, sigma, pieces, n), i + 1
        _shift_breaks(xy, broken, pieces[:n])
        n = _join(xy, free, pieces[:n], sigma)
    walls, m = np.zeros((n, WALL)), 0
    for k in range(n):
        a, b = pieces[k, 0], pieces[k, 1]
        if _by_chance(xy, a, b, sigma) < CHANCE:
            wall = _fit(xy, a, b)
            for i in range(WALL):
                walls[m, i] = wall[i]
            walls[m, SHARE] = (b - a) / len(xy)
            pieces[m, 0], pieces[m, 1] = a, b
            m += 1
    return pieces[:m], walls[:m]
