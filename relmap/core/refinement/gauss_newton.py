"""Damped Gauss-Newton with weights for what no noise explains, for any kind of landmark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.schur import NormalEquations

State = TypeVar("State")
Weigh = Callable[[Floats], Floats]
"""Weights (n,) of residuals (n,)."""

WORSE = 1.001
"""A step after which the cost is more than so many times that before was too long."""
DAMPED, MORE, MOST = 1e-4, 10.0, 1.0
"""What is added to the matrix's diagonal then, as a share of it, how many times more each time
(Levenberg, 1944; Marquardt, 1963), and when the search ends."""
SLOW = 0.1
"""A step that gains a larger share of what the one before did asks for a new factor."""
UNSURE = 1e-7
"""Gain that no further step is taken for, in squared standard deviations of the whole map."""
SAME, ALIKE = 0.05, 0.01
"""Change of a weight that makes no difference, and mean change that asks for no new factor."""


class Problem(Protocol[State]):
    """What a kind of landmark supplies.

    Attributes
    ----------
    pattern : Pattern
        Where the unknowns stand that are left when others are eliminated.
    freedoms : int
        How many more residuals there are than unknowns; at least 1.
    rounding : float
        Cost that is taken for rounding.
    """

    pattern: Pattern
    freedoms: int
    rounding: float

    def residuals(self, state: State) -> Floats:
        """Return the sizes (n,) of what is left of the observations, each as sure as the others."""
        ...

    def equations(
        self, state: State, weight: Floats, with_matrix: bool, damping: float
    ) -> NormalEquations:
        """Return the normal equations, of observations of weights (n,).

        The matrix's diagonal is larger by `damping`, as a share of it.
        """
        ...

    def stepped(
        self, state: State, equations: NormalEquations, step: Floats, weight: Floats
    ) -> State | None:
        """Return the state after the step that solves the equations; None if it is too long."""
        ...


@dataclass(frozen=True, eq=False)
class Solution(Generic[State]):
    """Where Gauss-Newton came to.

    Attributes
    ----------
    state : State
    weight : (n,) float64
    last : State, optional
        Before the last step, if there was one.
    gain : float
        What the last step gained, in squared standard deviations; infinite if there was none.
    converged : bool
        Whether the next one would gain next to nothing.
    factor : (size,) float64, optional
        Of the last matrix, good enough to go on with.
    """

    state: State
    weight: Floats
    last: State | None
    gain: float
    converged: bool
    factor: Floats | None


def weighted_squares(residual: Floats, weight: Floats) -> float:
    """Return the cost of least squares."""
    return float(weight @ residual**2)


def gauss_newton(
    problem: Problem[State],
    state: State,
    weigh: Weigh,
    rounds: int,
    factor: Floats | None = None,
    cost_of: Callable[[Floats, Floats], float] = weighted_squares,
    unsure: float = UNSURE,
    same: float = SAME,
    monotone: bool = True,
    reuse: bool = True,
    faint: float = 0.0,
) -> Solution[State]:
    """Return a state of the least cost.

    Weights change with each step.

    Parameters
    ----------
    problem : Problem
    state : State
        To start from.
    weigh : callable
    rounds : int
        Most steps.
    factor : (size,) float64, optional
        Of a matrix that is nearly the same.
    cost_of : callable
        What is made least, of residuals and weights.
    unsure, same : float
        Gain that no further step is taken for, in squared standard deviations of the whole map, and
        largest change of a weight.
    monotone : bool
        Whether a step that raises the cost is taken for too long.  Where weights go from lenient to
        strict, to raise the cost is the way out of what mismatched observations hold.
    reuse : bool
        Whether a factor is used again as long as that gains much; not where weights change a lot.
    faint : float
        As `unsure`, of a damped step: where full ones are too long, many more would be needed.
    """
    residual = problem.residuals(state)
    weight, damping, before, last = weigh(residual), 0.0, np.inf, None
    gained, converged = np.inf, False
    while rounds > 0 and damping <= MOST:
        fresh = factor is None
        equations = problem.equations(state, weight, fresh, damping)
        if factor is None:
            factor = equations.matrix
            problem.pattern.factorise(factor)
        step = problem.pattern.solve(factor, equations.right)
        cost, after = cost_of(residual, weight), problem.stepped(state, equations, step, weight)
        left = residual if after is None else problem.residuals(after)
        highest = WORSE * cost + problem.rounding if monotone else np.inf
        if after is None or not cost_of(left, weight) <= highest:
            factor, before = None, np.inf
            damping = max(DAMPED, MORE * damping) if fresh else damping
            continue
        rounds -= 1
        gain, unit, old = float(np.sum(equations.right * step)), cost / problem.freedoms, weight
        last, state, residual, weight = state, after, left, weigh(left)
        change, gained = np.abs(weight - old), gain / unit if unit > 0 else 0.0
        enough = max(unsure * unit, problem.rounding)
        shrinks = min(1.0, gain / before) if np.isfinite(before) else 1.0
        converged = not damping and shrinks * gain <= enough
        if (converged and change.max() < same) or (damping and gain <= faint * unit):
            break
        is_slow = not reuse or damping > 0 or gain > SLOW * before or change.mean() > ALIKE
        factor, before = (None, np.inf) if is_slow else (factor, gain)
        damping = damping / MORE if damping > DAMPED else 0.0
    return Solution(state, weight, last, gained, converged, factor)
