"""Solving for walls, corners and poses, while learning how noisy each wall and corner is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from relmap.planes.assembly import FLAT_M, Assembled
from relmap.planes.equations import WallEquations
from relmap.planes.refinement import WallSystem

EXACT_M = 1e-7
"""How sure walls can be at best where there is no noise."""
SHARPER = 0.1
"""By how much the least noise is lowered at a time, down to what the observations show."""
MEDIAN = 1.4826
"""The standard deviation of what is normal, in units of the median of its size."""
KNOWN_BY = 4.0
"""Observations that what was assumed of a wall or corner counts for against what was seen of it."""
LAST = (8, 4.0)
"""Most steps of the last solution, and the residual from which an observation is in doubt."""
SHARPLY = (6, 4.0)
"""The same, of each solution with less noise than walls have at best."""


def refined(assembled: Assembled, rounds: Sequence[tuple[int, float]], held: float) -> Assembled:
    """Solve for walls, corners and poses, learning on the way how noisy each wall and corner is.

    Parameters
    ----------
    assembled : Assembled
    rounds : sequence of (int, float)
        Most steps of each solution, between which the noise of each wall and corner is learnt, and
        the residual from which an observation is in doubt: none is before the rest has fallen into
        place.
    held : float
        See `WallSystem`.
    """
    return _solved(WallSystem(assembled.given, held), assembled, rounds)


def refined_to_the_noise(assembled: Assembled, held: float) -> Assembled:
    """Solve for walls, corners and poses as accurately as the observations are.

    Where they are better than real walls, the least noise is lowered bit by bit: what was found
    wrong so far is out before the rest decides (graduated non-convexity; Blake and Zisserman,
    1987).
    """
    system, share = WallSystem(assembled.given, held), 1.0
    best = _solved(system, assembled, (LAST,))
    while share * FLAT_M > max(assembled.typical_m, EXACT_M):
        share *= SHARPER
        given = replace(
            assembled.given,
            sd=share * assembled.given.sd,
            corner_sd=share * assembled.given.corner_sd,
        )
        best = _solved(system, replace(best, given=given), (SHARPLY,), by_scan=False)
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
        given, settled = _reweighted(assembled.given, *own.off(state)), own.settled
    return replace(assembled, given=given, state=state, settled=settled)


def _reweighted(
    given: WallEquations, across: NDArray[np.float64], along: NDArray[np.float64]
) -> WallEquations:
    """Return the equations with the noise that each wall and corner shows in the residuals."""
    wall = _learnt(given.wall, across.mean(axis=1) / given.sd)
    corner = _learnt(given.corner, along / given.corner_sd)
    return replace(
        given, sd=given.sd * wall[given.wall], corner_sd=given.corner_sd * corner[given.corner]
    )


def _learnt(of: NDArray[np.int64], residual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by what the standard deviations of each are to be multiplied, at least 1.

    The median tells: single sights that are quite wrong are for the refinement to leave out.
    """
    from relmap.core.linalg.order_kernels import medians

    n = np.bincount(of)
    squares = n * (MEDIAN * medians(of, np.abs(residual))) ** 2
    return np.asarray(np.sqrt(np.maximum((KNOWN_BY + squares) / (KNOWN_BY + n), 1.0)))
