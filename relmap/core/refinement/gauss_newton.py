"""Damped, robust Gauss-Newton for any kind of landmark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.robust import (
    EXACT,
    bounded_cost,
    huber,
    lenient,
    limit_of,
    robust_cost,
    strict,
)
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.schur import NormalEquations

State = TypeVar("State")
Weigh = Callable[[Floats], Floats]
"""Weights (n,) of residuals (n,)."""

WORSE = 1.001
"""A step is too long if it multiplies the cost by more than this."""
DAMPED, MORE, MOST = 1e-4, 10.0, 1.0
"""Initial damping after a rejected step, as a fraction of the diagonal, factor of its increase, and
limit (Levenberg, 1944; Marquardt, 1963)."""
SLOW = 0.1
"""A step that gains a larger fraction of the previous gain triggers a new factorisation."""
UNSURE, ROUGH = 1e-7, 1e-2
"""Gain below which no further step is taken, in squared standard deviations of the whole map; and
the same for a state from which another solution starts."""
SAME, ALIKE = 0.05, 0.01
"""Largest negligible change of a weight, and mean change that needs no new factorisation."""
Weights = Callable[[Floats, float], Floats]

ROUNDS = 30
"""Maximum number of steps. Maps of shuffled landmarks converge in fewer; a direction that is hardly
determined would take hundreds, which move it by little."""
FAINT = 0.03
"""Gain of a damped step, in squared standard deviations of the whole map, below which to stop."""
WORTH_SAYING = 1.0
"""Gain of the last step, in squared standard deviations of the whole map, above which a warning
says that it did not converge."""
BENT, WIDE = 0.5, 4.0
"""Residual beyond which Huber's influence is constant, relative to that of an outlier; and limit of
outliers that are far off."""


class Problem(Protocol[State]):
    """A nonlinear least-squares problem, implemented by a kind of landmark.

    `pattern`: sparsity pattern of the unknowns that are not eliminated. `freedoms`: degrees of
    freedom: residuals minus unknowns; at least 1. `rounding`: cost treated as rounding.
    """

    pattern: Pattern
    freedoms: int
    rounding: float

    def residuals(self, state: State) -> Floats:
        """Return the norms (n,) of the residuals, normalised to equal variance."""
        ...

    def equations(
        self, state: State, weight: Floats, with_matrix: bool, damping: float
    ) -> NormalEquations:
        """Return the normal equations of observations with weights (n,).

        The diagonal of the matrix is multiplied by ``1 + damping``.
        """
        ...

    def stepped(
        self, state: State, equations: NormalEquations, step: Floats, weight: Floats
    ) -> State | None:
        """Return the state after solving the equations; None if the step is too long."""
        ...


class HasPositions(Protocol):
    """A state with landmarks (m, d), metres."""

    @property
    def positions(self) -> Floats:
        """The landmark positions."""
        ...


Located = TypeVar("Located", bound=HasPositions)


@dataclass(frozen=True, eq=False)
class Solution(Generic[State]):
    """Result of Gauss-Newton.

    `weight` (n,); `last`: state before the last step, if any. `gain`: gain of the last step, in
    squared standard deviations; infinite if there was none. `converged`: whether the gain of the
    next step would be negligible.
    """

    state: State
    weight: Floats
    last: State | None = None
    gain: float = np.inf
    converged: bool = False


def weighted_squares(residual: Floats, weight: Floats) -> float:
    """Return the least-squares cost."""
    return float((weight * residual**2).sum())


def gauss_newton(
    problem: Problem[State],
    state: State,
    weigh: Weigh,
    rounds: int,
    cost_of: Callable[[Floats, Floats], float] = weighted_squares,
    unsure: float = UNSURE,
    monotone: bool = True,
    reuse: bool = True,
    faint: float = 0.0,
) -> Solution[State]:
    """Minimise the cost, updating the weights with each step.

    `state`: the initial one; `rounds`: maximum number of steps; `cost_of`: cost as a function of
    residuals and weights; `unsure`: gain of a step, in squared standard deviations of the whole
    map, that is negligible, and `faint` of a damped one: if full steps are rejected, convergence
    would take many more. `monotone`: whether a step that increases the cost is rejected; while
    weights go from lenient to strict, an increase may be needed to escape from wrong matches.
    `reuse`: whether a factor is reused while the gain is large, and weights must have settled too;
    if not, which is for weights that change much, those after the last step are not computed.
    """
    residual = problem.residuals(state)
    weight, damping, before, last = weigh(residual), 0.0, np.inf, None
    gained, converged, factor = np.inf, False, None
    while rounds > 0 and damping <= MOST:
        fresh = factor is None
        factor, equations, step = _solved(problem, state, weight, factor, damping)
        cost, after = cost_of(residual, weight), problem.stepped(state, equations, step, weight)
        left = residual if after is None else problem.residuals(after)
        highest = WORSE * cost + problem.rounding if monotone else np.inf
        if after is None or not cost_of(left, weight) <= highest:
            factor, before = None, np.inf
            damping = max(DAMPED, MORE * damping) if fresh else damping
            continue
        rounds -= 1
        gain, unit = float(np.sum(equations.right * step)), cost / problem.freedoms
        last, state, residual = state, after, left
        gained, enough = gain / unit if unit > 0 else 0.0, max(unsure * unit, problem.rounding)
        # Gains shrink by a constant factor, at most 1.
        following = gain * min(1.0, gain / before) if np.isfinite(before) else gain
        converged = not damping and following <= enough
        stalled = damping > 0 and gain <= faint * unit
        if not reuse and (converged or stalled or rounds == 0):
            break
        old, weight = weight, weigh(left)
        change = np.abs(weight - old)
        if (converged and change.max() < SAME) or stalled:
            break
        is_slow = not reuse or damping > 0 or gain > SLOW * before or change.mean() > ALIKE
        factor, before = (None, np.inf) if is_slow else (factor, gain)
        damping = damping / MORE if damping > DAMPED else 0.0
    return Solution(state, weight, last, gained, converged)


def _solved(
    problem: Problem[State], state: State, weight: Floats, factor: Floats | None, damping: float
) -> tuple[Floats, NormalEquations, Floats]:
    """Return a factor, a new one if none is given, the equations, and their solution."""
    equations = problem.equations(state, weight, factor is None, damping)
    if factor is None:
        factor = equations.matrix
        problem.pattern.factorise(factor)
    return factor, equations, problem.pattern.solve(factor, equations.right)


def settle(problem: Problem[Located], start: Located) -> Solution[Located]:
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


def settle_again(
    problem: Problem[Located], start: Located, known: Solution[Located], trust: Floats
) -> Solution[Located]:
    """Return a known solution, or a better one that is found with Huber's weights first.

    From a start that is bent at one place, lenient weights may give up what would unbend it: they
    have a minimum for each choice of outliers, Huber's have few. And outliers far away keep an
    influence, which turns what hardly resists. So outliers are then rejected at once, or those that
    are far off first.

    `trust` (n,): factors of Huber's weights, small where residuals may be wrong.
    """
    d, size = start.positions.shape[1], size_of(start.positions)
    limit = limit_of(problem.residuals(known.state), d, size)
    bent = _roughly(problem, start, lambda left: trust * huber(left, BENT * limit))
    near = _roughly(problem, bent, lambda left: strict(left, WIDE * limit))
    return better(problem, limit, known, [bent, near])


def better(
    problem: Problem[Located], limit: float, known: Solution[Located], starts: list[Located]
) -> Solution[Located]:
    """Return a known solution, or one of smaller bounded cost that is found near other states.

    `limit`: residual above which one is an outlier. Outliers are rejected at once.
    """

    def weigh(residual: Floats) -> Floats:
        return strict(residual, limit)

    def cost(state: Located) -> float:
        return bounded_cost(problem.residuals(state), limit)

    best = min((_roughly(problem, start, weigh) for start in starts), key=cost)
    if cost(best) >= cost(known.state):
        return known
    found = gauss_newton(problem, best, weigh, ROUNDS, faint=FAINT)
    return replace(found, converged=found.converged or found.gain <= WORTH_SAYING)


def _roughly(problem: Problem[Located], start: Located, weigh: Weigh) -> Located:
    """Return the state after steps that gain much; it is where another solution starts."""
    return gauss_newton(problem, start, weigh, ROUNDS, unsure=ROUGH, reuse=False, faint=FAINT).state


def size_of(positions: Floats) -> float:
    """Return the largest coordinate of positions (m, d) relative to their mean, metres."""
    return float(np.abs(positions - positions.mean(axis=0)).max())
