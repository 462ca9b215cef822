"""Walls that coincide after a motion, and the fit of the motion to them, compiled.

Points along walls are `Points`: places and normals (n, 2), see
`relmap.planes.places.wall_tie.WallPoints`.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Counts, Floats, Ints
from relmap.core.geometry.spatialindex_kernels import bucket_of, cell_at, key_of
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import factorise, solve
from relmap.planes.places.wall_tie import PARALLEL, SAMPLE_M

Points = tuple[Floats, Floats]
Among = tuple[Floats, Floats, Counts, Counts, Ints, float]
"""Points that others may lie on, and their normals; the first point of each bucket, the next point
in the bucket of each point, and the key of its cell, see
`relmap.core.geometry.spatialindex_kernels`; and the side of the cells, metres."""

HELD = 0.003
"""Information that holds each direction of a fit, relative to that of all points across their
walls: along a bare corridor it must not slide."""
FEWEST = 3
"""Number of points that a fit needs."""


@helper
def _nearest(among: Among, x: float, y: float, reach_m: float) -> int:
    """Return the nearest point within reach; -1 for none."""
    at, _, first, following, key, cell_m = among
    nearest, least = -1, reach_m * reach_m
    for i in range(cell_at(x - reach_m, cell_m), cell_at(x + reach_m, cell_m) + 1):
        for j in range(cell_at(y - reach_m, cell_m), cell_at(y + reach_m, cell_m) + 1):
            wanted = key_of(i, j, 0)
            one = first[bucket_of(wanted, len(first))]
            while one >= 0:
                square = (at[one, 0] - x) ** 2 + (at[one, 1] - y) ** 2
                if square <= least and key[one] == wanted:
                    nearest, least = one, square
                one = following[one]
    return nearest


@helper
def _lie(own: Points, among: Among, motion: Floats, near_m: float, other: Ints, off: Floats) -> int:
    """Set the point that each point lies on after a motion, and how far before it; see `lying`."""
    n, (at, normal), (c, s, tx, ty) = 0, own, motion
    for i in range(len(at)):
        x, y = c * at[i, 0] - s * at[i, 1] + tx, s * at[i, 0] + c * at[i, 1] + ty
        one = _nearest(among, x, y, near_m + SAMPLE_M)
        other[i], off[i] = -1, np.nan
        if one < 0:
            continue
        ox, oy = among[1][one, 0], among[1][one, 1]
        before = (among[0][one, 0] - x) * ox + (among[0][one, 1] - y) * oy
        nx, ny = c * normal[i, 0] - s * normal[i, 1], s * normal[i, 0] + c * normal[i, 1]
        if abs(before) <= near_m and ox * nx + oy * ny >= PARALLEL:
            other[i], off[i], n = one, before, n + 1
    return n


@compiled
def lying(own: Points, among: Among, motion: Floats, near_m: float) -> tuple[Ints, Floats]:
    """Return the point that each point lies on after a motion, -1 for none, and how far before it.

    `motion` (4,): cosine and sine of the rotation, and the translation; `near_m`: largest distance
    from a wall.
    """
    other, off = np.empty(len(own[0]), dtype=np.int64), np.empty(len(own[0]))
    _lie(own, among, motion, near_m, other, off)
    return other, off


@helper
def _equations(
    at: Floats, among: Among, motion: Floats, other: Ints, off: Floats, n: int
) -> tuple[Floats, Floats, Floats]:
    """Return information (3, 3) and right-hand side (3,) of a step, and centre and reach (3,).

    The step is a translation and a rotation about the centre, times the reach.
    """
    (c, s, tx, ty), about = motion, np.zeros(3)
    H, right, row = np.zeros((3, 3)), np.zeros(3), np.empty(3)
    mx, my, square = 0.0, 0.0, 0.0
    for i in range(len(at)):
        if other[i] >= 0:
            mx, my, square = mx + at[i, 0], my + at[i, 1], square + at[i, 0] ** 2 + at[i, 1] ** 2
    mx, my = mx / n, my / n
    reach = max(math.sqrt(max(square / n - mx * mx - my * my, 0.0)), 1e-9)
    about[0], about[1], about[2] = c * mx - s * my + tx, s * mx + c * my + ty, reach
    for i in range(len(at)):
        if other[i] < 0:
            continue
        x, y = at[i, 0] - mx, at[i, 1] - my
        row[0], row[1] = among[1][other[i], 0], among[1][other[i], 1]
        row[2] = ((c * x - s * y) * row[1] - (s * x + c * y) * row[0]) / reach
        for a in range(3):
            right[a] += row[a] * off[i]
            for b in range(3):
                H[a, b] += row[a] * row[b]
    return H, right, about


@helper
def _step(motion: Floats, H: Floats, right: Floats, about: Floats) -> None:
    """Move a motion by a least-squares step."""
    factorise(H)
    solve(H, right)
    c, s = math.cos(right[2] / about[2]), math.sin(right[2] / about[2])
    x, y = motion[2] - about[0], motion[3] - about[1]
    motion[0], motion[1] = c * motion[0] - s * motion[1], s * motion[0] + c * motion[1]
    motion[2] = c * x - s * y + about[0] + right[0]
    motion[3] = s * x + c * y + about[1] + right[1]


@compiled
def fit(own: Points, among: Among, motion: Floats, near_m: Floats) -> tuple[int, float, float]:
    """Fit a motion (4,), in place, to walls that coincide, alternating with matching.

    `near_m` (k,): largest distance from a wall, in each round. Returns `n`: number of points on
    walls before the last step; 0 if they do not determine a motion. `across`, `rms_m`: see
    `relmap.planes.places.wall_tie.WallTie`.
    """
    other, off, n = np.empty(len(own[0]), dtype=np.int64), np.empty(len(own[0])), 0
    across, squares = 0.0, 0.0
    for k in range(len(near_m)):
        n = _lie(own, among, motion, near_m[k], other, off)
        if n < FEWEST:
            return 0, 0.0, np.inf
        H, right, about = _equations(own[0], among, motion, other, off, n)
        half, beside = (H[0, 0] - H[1, 1]) / 2, H[0, 1]
        across = ((H[0, 0] + H[1, 1]) / 2 - math.sqrt(half * half + beside * beside)) / n
        for a in range(3):
            H[a, a] += HELD * n
        _step(motion, H, right, about)
    for i in range(len(off)):
        if other[i] >= 0:
            squares += off[i] * off[i]
    return n, across, math.sqrt(squares / n)


@compiled
def votes(here: Ints, counts: Ints, there: Ints, begin: Ints, shape: Ints) -> Ints:
    """Return how many points come into cells of others by each shift of the cells.

    `here` (n, 3), `counts` (n,): direction, column and row of cells, and the number of points in
    each. `there` (m, 3): the same of others, direction by direction. `begin` (d + 1,): the first
    cell of each direction. `shape` (2,): number of shifts along both axes; the cells have columns
    and rows from 0, and the shift by 0 is that of the largest column and row of `here`.
    """
    score = np.zeros((shape[0], shape[1]), dtype=np.int64)
    last = np.zeros(2, dtype=np.int64)
    for i in range(len(here)):
        last[0], last[1] = max(last[0], here[i, 1]), max(last[1], here[i, 2])
    for i in range(len(here)):
        x, y = last[0] - here[i, 1], last[1] - here[i, 2]
        for j in range(begin[here[i, 0]], begin[here[i, 0] + 1]):
            score[there[j, 1] + x, there[j, 2] + y] += counts[i]
    return score
