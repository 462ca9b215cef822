"""The robust joint least squares over segments: weights for what no noise explains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.robust import EXACT, lenient, limit_of, robust_cost, strict
from relmap.core.refinement.equations import Laid, SegmentProblem
from relmap.core.refinement.gauss_newton import SAME, WORSE, Problem, gauss_newton

Weights = Callable[[Floats, float], Floats]

ROUNDS, FEW_ROUNDS = 100, 10
"""Steps at most, and from where another problem that is nearly the same has settled."""
FAINT = 0.03
"""Gain of a damped step, in squared standard deviations of the whole map, that is the last."""
WORTH_SAYING = 1.0
"""Gain of the last step, in squared standard deviations of the whole map, above which it is said
that it did not settle."""


class HasPositions(Protocol):
    """A state with landmarks (m, d), metres."""

    @property
    def positions(self) -> Floats:
        """Where the landmarks are."""
        ...


State = TypeVar("State", bound=HasPositions)


@dataclass(frozen=True, eq=False)
class Settled(Generic[State]):
    """What the robust joint least squares came to.

    Attributes
    ----------
    state : tuple
        With the positions of the landmarks, as the problem has it.
    weight : (n,) float64
        Of an observation of each row.
    converged : bool
        Whether it settled.  Where not, the state is the best that was found, which may be that to
        start from.
    """

    state: State
    weight: Floats
    converged: bool


def settle(problem: Problem[State], start: State) -> Settled[State]:
    """Return the state of the least robust cost, no worse than the one to start from.

    The first weights are those of the start: a few wrong matches would drag a map that is solved
    for without weights to where no weights bring it back from.  Lenient weights spread a drift over
    a loop; then what still fits nowhere is let go.  The limit of what noise explains never grows:
    many wrong matches that count a little raise the noise, and so each other's weights.
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
        return Settled(start, strict(residual, first), converged=False)
    converged = found.converged or found.gain <= WORTH_SAYING
    return Settled(found.state, found.weight, converged)


def polished(problem: SegmentProblem, settled: Settled[Laid]) -> Settled[Laid]:
    """Return the state of the least cost near one that another problem has settled in.

    The residuals are those of segments as a whole, which this problem need not make less: what
    counts is its own cost.
    """

    def cost(state: Laid) -> float:
        return problem.equations(state, settled.weight, with_matrix=False, damping=0.0).cost

    start, weight = settled.state, settled.weight
    found = gauss_newton(problem, start, lambda _: weight, FEW_ROUNDS, monotone=False)
    return replace(settled, state=found.state) if cost(found.state) <= cost(start) else settled


def size_of(positions: Floats) -> float:
    """Return how far from their middle positions (m, d) lie, metres."""
    return float(np.abs(positions - positions.mean(axis=0)).max())
