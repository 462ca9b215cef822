"""Ends of walls: ends of blurred boxes, and corners where walls meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.segmentation.em.mixture import WallMixture, maximise
from relmap.segmentation.wall import BEGIN, END, PX, PY, SHARE, UX, UY

GATE = 3.0
"""Largest distance of an end from its corner, in standard deviations."""
LEAST_SINE = 0.25
"""Smallest angle between walls that determines a corner."""
INFORMATION = 0.9032
"""Integral of phi**2 / Phi: the information of a blurred end, in units of density / sigma."""
CONTESTED = 0.5
"""Additional error of the ends of two meeting walls, which compete for points, in units of the
noise."""
WORTH = 2.0
"""A crossing this many times less accurate than the end is not used."""
WANDER = 4.0
"""Maximum movement of an end, relative to its wall and in standard deviations: with few points, the
allowed range grows with every move."""
ROUNDS = 2
HELD = 4
"""Steps of EM with the ends fixed in their corners."""


@dataclass(frozen=True, eq=False)
class Sharpened:
    """Walls with accurate ends.

    `spread` (k, 2), metres: standard deviation of the start and end of each wall along itself.
    `joined` (k, 2): whether the end is in a corner with another wall. `hidden` (k, 2): whether the
    next beam meets something nearer; None if points are in no order.
    """

    mixture: WallMixture
    spread: Floats
    joined: Bools
    hidden: Bools | None = None


def sharpen(mixture: WallMixture, xy: Floats) -> Sharpened:
    """Return the mixture with accurate ends, moved into the corners where walls meet."""
    for _ in range(ROUNDS):
        joined = meet(solve_ends(mixture, xy), len(xy)).mixture
        mixture = maximise(joined, xy, HELD, held=True)
    return meet(solve_ends(mixture, xy), len(xy))


def solve_ends(mixture: WallMixture, xy: Floats) -> WallMixture:
    """Return the mixture with the most likely ends of its walls."""
    from relmap.segmentation.em.wall_kernels import span
    from relmap.segmentation.ends.box_kernels import fit_ends

    density, total = mixture.density(xy)
    walls = mixture.walls.copy()
    for share, wall in zip(density / total, walls, strict=True):
        amount = wall[SHARE] * len(xy)
        for _ in range(2):
            dense = amount / span(wall, mixture.beam)
            fit_ends(xy, share, wall, mixture.sigma, dense, mixture.beam)
    return mixture.with_walls(walls)


def meet(mixture: WallMixture, n: int) -> Sharpened:
    """Move the ends of walls, among n points, to where their walls meet others.

    An end belongs to a corner if the other wall reaches it too, both within their accuracy. The
    crossing of two lines is more accurate than either end.
    """
    walls, blur = mixture.walls, end_spread(mixture, n)
    amount = np.maximum(walls[:, SHARE] * n, 3.0)[:, None]
    length = np.maximum(walls[:, END] - walls[:, BEGIN], 1e-9)[:, None]
    t, sine = crossings(walls)
    offset = t - 0.5 * (walls[:, BEGIN] + walls[:, END])[:, None]
    across = mixture.sigma * np.sqrt((1 + 12 * (offset / length) ** 2) / amount)
    spread = np.hypot(across, across.T) / sine
    loose = np.hypot(blur, CONTESTED * mixture.sigma)
    moved, accuracy = walls.copy(), blur.copy()
    joined = np.zeros(blur.shape, dtype=np.bool_)
    reach, every = GATE * np.hypot(spread, loose.max(axis=1)), np.arange(len(t))
    reached = (walls[:, BEGIN] - reach < t.T) & (walls[:, END] + reach > t.T) & (sine > LEAST_SINE)
    farthest = np.maximum(WANDER * mixture.sigma, 0.5 * length[:, 0])
    for side, end in enumerate((BEGIN, END)) if len(walls) > 1 else ():
        gate = GATE * np.hypot(spread, loose[:, side, None])
        usable = reached & (spread < WORTH * blur[:, side, None])
        far = np.abs(t - walls[:, end, None])
        miss = np.where(usable, far / gate, 2.0)
        nearest = miss.argmin(axis=1)
        near = far[every, nearest] < farthest
        rows = ((miss[every, nearest] < 1) & near).nonzero()[0]
        moved[rows, end] = t[rows, nearest[rows]]
        accuracy[rows, side] = spread[rows, nearest[rows]]
        joined[rows, side] = True
    kept = moved[:, END] - moved[:, BEGIN] > 0.2 * length[:, 0]
    moved = np.where(kept[:, None], moved, walls)
    return Sharpened(mixture.with_walls(moved), accuracy, joined & kept[:, None])


def end_spread(mixture: WallMixture, n: int) -> Floats:
    """Return the standard deviations of the ends (k, 2) of walls among n points.

    They follow from the noise and the spacing of points; between two beams the position is uniform.
    """
    walls, beam = mixture.walls, mixture.beam
    at, (px, py, ux, uy) = walls[:, [BEGIN, END]], walls[:, [PX, PY, UX, UY]].T
    foot, height = -(px * ux + py * uy), np.maximum(np.abs(px * uy - py * ux), 1e-3)
    off, apart = at - foot[:, None], np.ones_like(at)
    span = off
    if beam > 0:  # points are uniform in angle
        span = np.arctan(off / height[:, None])
        apart = (height[:, None] ** 2 + off**2) / height[:, None]
    span = np.maximum(span[:, 1] - span[:, 0], 1e-9)
    density = (walls[:, SHARE] * n)[:, None] / np.maximum(span[:, None] * apart, 1e-12)
    spacing = 1 / np.maximum(density, 1e-9)
    between = (beam * apart) ** 2 / 12
    blur = mixture.sigma * spacing / INFORMATION + spacing**2
    return np.asarray(np.sqrt(blur + between))


def crossings(walls: Floats) -> tuple[Floats, Floats]:
    """Return the crossings with each line (1, k) along each line (k, 1), and the sines."""
    ux, uy = walls[:, UX], walls[:, UY]
    cross = ux[:, None] * uy - uy[:, None] * ux
    dx, dy = walls[:, PX] - walls[:, PX, None], walls[:, PY] - walls[:, PY, None]
    size = np.abs(cross)
    along = (dx * uy - dy * ux) / np.where(size < 1e-12, 1e-12, cross)
    return along, np.maximum(size, 1e-12)
