"""Solving for walls, corners and poses, with estimation of the noise of each wall and corner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes.refinement.system import WallSystem
from relmap.planes.walls.assembly import FLAT_M, Assembled

EXACT_M = 1e-7
"""Minimum standard deviation of walls for noise-free data."""
SHARPER = 0.1
"""Factor by which the least noise is lowered at a time, down to that of the observations."""
MEDIAN = 1.4826
"""Standard deviation of a normal variable relative to the median of its magnitude."""
KNOWN_BY = 4.0
"""Weight of the prior noise of a wall or corner, in observations."""
LAST = (8, 4.0)
"""Maximum steps of the last solution, and the residual above which an observation is an outlier."""
SHARPLY = (6, 4.0)
"""The same, for solutions with less noise than the least noise of walls."""


def refined(assembled: Assembled, rounds: Sequence[tuple[int, float]], held: float) -> Assembled:
    """Solve for walls, corners and poses, estimating the noise of each wall and corner.

    `rounds`, sequence of (int, float): maximum steps of each solution, between which the noise of
    each wall and corner is estimated, and the residual above which an observation is an outlier:
    infinite in the first rounds; `held`: see `WallSystem`.
    """
    return _solved(WallSystem(assembled.given, held), assembled, rounds)


def refined_to_the_noise(assembled: Assembled, held: float) -> Assembled:
    """Solve for walls, corners and poses at the accuracy of the observations.

    If they are more accurate than real walls, the least noise is lowered step by step, so that
    outliers are rejected before the noise is small (graduated non-convexity; Blake and Zisserman,
    1987). Otherwise the map is returned unchanged.
    """
    if assembled.typical_m >= FLAT_M:
        return assembled
    given, best, share = assembled.given, assembled, 1.0
    system = WallSystem(given, held)
    while share * FLAT_M > max(assembled.typical_m, EXACT_M):
        share *= SHARPER
        lower = replace(given, sd=share * given.sd, corner_sd=share * given.corner_sd)
        best = _solved(system, replace(best, given=lower), (SHARPLY,), by_scan=False)
    return best


def _solved(
    system: WallSystem,
    assembled: Assembled,
    rounds: Sequence[tuple[int, float]],
    by_scan: bool = True,
) -> Assembled:
    """Solve in rounds, with a system of the same observations; see `WallSystem.refine`."""
    given, state, settled = assembled.given, assembled.state, True
    for most, doubtful in rounds:
        own = system.reweighted(given)
        state = own.refine(state, most, doubtful, by_scan)
        across, along = own.off(state)
        given, settled = assembled.given, own.settled
        wall = _learnt(given.wall, across.mean(axis=1) / given.sd)
        corner = _learnt(given.corner, along / given.corner_sd)
        sd, corner_sd = given.sd * wall[given.wall], given.corner_sd * corner[given.corner]
        given = replace(given, sd=sd, corner_sd=corner_sd)
    return replace(assembled, given=given, state=state, settled=settled)


def _learnt(of: Ints, residual: Floats) -> Floats:
    """Return the factors for the standard deviations of each, at least 1.

    The median is used: single outliers are left to the robust weights of the refinement.
    """
    from relmap.core.linalg.order_kernels import medians

    n = np.bincount(of)
    squares = n * (MEDIAN * medians(of, np.abs(residual))) ** 2
    return np.asarray(np.sqrt(np.maximum((KNOWN_BY + squares) / (KNOWN_BY + n), 1.0)))
