"""Ends of walls: ends of blurred boxes, and corners where walls meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.segmentation.em.mixture import WallMixture, maximise
from relmap.segmentation.wall import SHARE

ROUNDS = 2
HELD = 4
"""Steps of EM with the ends fixed in their corners."""


@dataclass(frozen=True, eq=False)
class Sharpened:
    """Walls with accurate ends.

    `spread` (k, 2), metres: standard deviation of the start and end of each wall along itself.
    `joined` (k, 2): whether the end is in a corner with another wall. `hidden` (k, 2): whether the
    next beam meets something nearer; unknown, so false, if points are in no order.
    """

    mixture: WallMixture
    spread: Floats
    joined: Bools
    hidden: Bools


def sharpen(mixture: WallMixture, xy: Floats) -> Sharpened:
    """Return the mixture with accurate ends, moved into the corners where walls meet."""
    for _ in range(ROUNDS):
        joined = meet(solve_ends(mixture, xy), len(xy)).mixture
        mixture = maximise(joined, xy, HELD, held=True)
    return meet(solve_ends(mixture, xy), len(xy))


def solve_ends(mixture: WallMixture, xy: Floats) -> WallMixture:
    """Return the mixture with the most likely ends of its walls."""
    from relmap.segmentation.em.wall_kernels import span
    from relmap.segmentation.ends.end_kernels import fit_ends

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
    from relmap.segmentation.ends.end_kernels import met

    moved, spread, joined = met(mixture.walls, mixture.sigma, n, mixture.beam)
    return Sharpened(mixture.with_walls(moved), spread, joined, np.zeros_like(joined))
