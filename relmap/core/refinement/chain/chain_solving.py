"""Least squares over all observations and odometry, with the noise of each estimated."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.robust import OUTLIER, huber, lenient, limit_of, robust_cost, strict
from relmap.core.refinement.chain.chain_data import Chain, Chained, Sigmas
from relmap.core.refinement.chain.chained import ChainProblem
from relmap.core.refinement.gauss_newton import FAINT, WORTH_SAYING, Solution, Weigh, gauss_newton
from relmap.core.refinement.trend import by_landmark

TIMES, FEW_ROUNDS, ROUNDS = 15, 10, 50
"""Maximum number of rounds of estimating the noise and solving; steps of each, and of the last."""
ROUGH, FINE = 1e-2, 1e-4
"""Gain below which no further step is taken, in squared standard deviations of the whole map."""
SETTLED = 0.02
"""Relative change of the noise that is negligible."""
BENT = 3.5
"""Residual, in standard deviations, beyond which Huber's influence is constant."""
MOVED = 5.0
"""Ratio of the median distances of observations from the means and from the medians of landmarks
above which wrong ids have moved the means."""


def start_of(chain: Chain, poses: Floats, m: int) -> Chained:
    """Return the state at poses (k, 4, 4), with each landmark (m,) at the mean of its places.

    At the median, if it is far closer to most: one wrong id in ten moves means by metres, and then
    nothing stands out.
    """
    d = chain.points.shape[1]
    R, t = poses[:, :d, :d], poses[:, :d, 3]
    at, each = chain.iteration, np.empty((2, m, d))
    placed = np.einsum("nij,nj->ni", R[at], chain.points) + t[at]
    for one, rows in by_landmark(chain.landmark, placed):
        each[:, one] = placed[rows].mean(axis=0), np.median(placed[rows], axis=0)
    off = np.median(np.linalg.norm(placed - each[:, chain.landmark], axis=2), axis=1)
    return Chained(each[int(off[0] > MOVED * off[1])], R, t, np.zeros(2 * d - 1))


def settled_chain(
    chain: Chain,
    step_sd: tuple[Floats, Floats],
    state: Chained,
    anchor: int,
    sigmas: Sigmas | None,
    to_the_last: bool,
    has_ids: bool,
    slip: float = 1.0,
) -> tuple[Solution[Chained], ChainProblem]:
    """Solve for the map of least robust cost, and estimate the noise from its residuals.

    Parts of the chain turn as a whole: otherwise long chains stay far from the optimum. Since wrong
    ids turn them too, with ids the better of this solution and one without such turns is returned.

    `step_sd`, tuple of (k - 1,): standard deviations of the distance and the turn of each step of
    odometry, as in `ChainProblem`; `state`: where to start; `anchor`: iteration that is held;
    `sigmas`: the noise, if known; `to_the_last`: whether to iterate until convergence; `slip`: as
    in `ChainProblem`. Returns `problem`: with the estimated noise.
    """
    whole = ChainProblem(chain, step_sd, sigmas or Sigmas(), state.positions, anchor, slip=slip)
    single = copy(whole)
    single.turns_whole = False
    each = [
        _settled(problem, state, sigmas is not None, to_the_last)
        for problem in ((single, whole) if has_ids else (whole,))
    ]
    return min(each, key=lambda one: _cost(each[0][1], one[0].state, one[0].state))


def _settled(
    problem: ChainProblem, state: Chained, is_known: bool, to_the_last: bool
) -> tuple[Solution[Chained], ChainProblem]:
    """Return the solution from a state, and the problem with the noise, estimated if not known."""
    found, problem = _with_noise(problem, state, is_known, to_the_last)
    if not is_known:
        found = _better(problem, found)
    if to_the_last:
        weigh = _weighing(problem, strict, OUTLIER)
        found = gauss_newton(problem, found.state, weigh, ROUNDS, unsure=FINE, faint=FAINT)
    converged = found.converged or found.gain <= WORTH_SAYING or not to_the_last
    return replace(found, converged=converged), problem


def _with_noise(
    problem: ChainProblem, state: Chained, is_known: bool, to_the_last: bool
) -> tuple[Solution[Chained], ChainProblem]:
    """Return the solution, and the problem with the noise estimated from its residuals in turn."""
    for _ in range(TIMES):
        weigh = _weighing(problem, lenient, OUTLIER)
        found = gauss_newton(problem, state, weigh, FEW_ROUNDS, unsure=ROUGH, faint=WORTH_SAYING)
        state = found.state
        if is_known and (found.converged or not to_the_last):
            break
        sigmas, before = problem.components(state, found.weight), problem.sigmas
        ratios = [a / b for a, b in zip(sigmas, before, strict=True)]
        is_known = max(abs(np.log(ratio)) for ratio in ratios) < SETTLED
        problem = problem.with_noise(sigmas, state.positions)
    return found, problem


def _better(problem: ChainProblem, known: Solution[Chained]) -> Solution[Chained]:
    """Return the better of a solution and one that starts from that with Huber's weights.

    Lenient weights have many local minima, each with other outliers.  Huber's have few, but help
    only if the noise is known.
    """
    bent, weigh = known.state, _weighing(problem, huber, BENT)
    bent = gauss_newton(problem, bent, weigh, ROUNDS, unsure=ROUGH, faint=WORTH_SAYING).state
    weigh = _weighing(problem, lenient, OUTLIER)
    found = gauss_newton(problem, bent, weigh, FEW_ROUNDS, unsure=ROUGH, faint=WORTH_SAYING)
    better = _cost(problem, found.state, known.state) < _cost(problem, known.state, known.state)
    return found if better else known


def _cost(problem: ChainProblem, state: Chained, usual: Chained) -> float:
    """Return the robust cost of a state, with the limits of outliers that another has."""
    d, residual, limiting = problem.chain.points.shape[1], *map(problem.residuals, (state, usual))
    limits = (max(limit_of(limiting[part], d, 0.0), OUTLIER) for part in problem.parts)
    factors = 1.0, problem.slip, problem.slip
    limits = (factor * limit for factor, limit in zip(factors, limits, strict=True))
    of = zip(problem.parts, limits, strict=True)
    return sum(robust_cost(residual[part], limit) for part, limit in of)


def _weighing(
    problem: ChainProblem, function: Callable[[Floats, float], Floats], outlier: float
) -> Weigh:
    """Return the weight function, with separate limits for observations and odometry."""
    d, share = problem.chain.points.shape[1], outlier / OUTLIER

    def limit(residual: Floats, least: float) -> float:
        return max(share * limit_of(residual, d, 0.0), least)

    def weigh(residual: Floats) -> Floats:
        seen, *odometry = (residual[part] for part in problem.parts)
        # Odometry without other observations has no residuals.
        each = [function(part, problem.slip * limit(part, outlier)) for part in odometry]
        return np.concatenate([function(seen, limit(seen, 0.0)), *each])

    return weigh
