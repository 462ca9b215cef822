"""Robust joint least squares over segments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.robust import EXACT, lenient, limit_of, robust_cost, strict
from relmap.core.refinement.gauss_newton import SAME, WORSE, Problem, Solution, gauss_newton

Weights = Callable[[Floats, float], Floats]

ROUNDS = 30
"""Maximum number of steps. Maps of shuffled landmarks converge in fewer; a direction that is hardly
determined would take hundreds, which move it by little."""
FAINT = 0.03
"""Gain of a damped step, in squared standard deviations of the whole map, below which to stop."""
WORTH_SAYING = 1.0
"""Gain of the last step, in squared standard deviations of the whole map, above which a warning
says that it did not converge."""


class HasPositions(Protocol):
    """A state with landmarks (m, d), metres."""

    @property
    def positions(self) -> Floats:
        """The landmark positions."""
        ...


State = TypeVar("State", bound=HasPositions)


def settle(problem: Problem[State], start: State) -> Solution[State]:
    """Return the state of least robust cost, or the initial one if that is better.

    It counts as converged if the last step gained little.

    The first weights come from the initial state: an unweighted solution could be pulled by a few
    wrong matches to where reweighting cannot recover. Lenient weights first distribute the drift
    over a loop; strict weights then reject remaining outliers. The inlier threshold never grows:
    many wrong matches with small weights would raise the noise estimate, and so each other's
    weights.
    """
    d, size = start.positions.shape[1], size_of(start.positions)
    residual = problem.residuals(start)
    limit = first = limit_of(residual, d, size)

    def weighing(function: Weights) -> Callable[[Floats], Floats]:
        def weigh(residual: Floats) -> Floats:
            nonlocal limit
            limit = min(limit_of(residual, d, size), limit)
            return function(residual, limit)

        return weigh

    found = gauss_newton(problem, start, weighing(lenient), ROUNDS, faint=FAINT)
    final = strict(problem.residuals(found.state), limit)
    if np.abs(final - found.weight).max() > SAME:
        found = gauss_newton(problem, found.state, weighing(strict), ROUNDS, faint=FAINT)
    rounding = len(residual) * (EXACT * size) ** 2
    cost = robust_cost(problem.residuals(found.state), first)
    if not cost <= WORSE * robust_cost(residual, first) + rounding:
        return Solution(start, strict(residual, first))
    return replace(found, converged=found.converged or found.gain <= WORTH_SAYING)


def size_of(positions: Floats) -> float:
    """Return the root mean square distance of positions (m, d) from their mean, metres."""
    return float(np.abs(positions - positions.mean(axis=0)).max())
