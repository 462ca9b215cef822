"""Refinement for bounded noise: least sum of p-th powers of the residuals.

Least squares is optimal for normal noise. For residuals with lighter tails, the sum of their p-th
powers is minimised instead: p = 2 is least squares, p to infinity Chebyshev's estimate. This is
optimal for noise of density ``exp(-|x|^p)`` (Subbotin, 1923), so p is chosen from the kurtosis of
the residuals, axis by axis in the robot frame. It requires every single observation.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from relmap.core.arrays import Floats
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.gauss_newton import gauss_newton
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.observations import Observations
from relmap.core.refinement.schur import Elimination, Linearised, NormalEquations

FIRST, LAST = 4, 16
"""Range of powers: below, least squares is as good; above, the steps become inaccurate."""
STEPS = 2
"""Newton steps for each intermediate power."""
SHARES = (1.0, 0.5, 0.25)
"""Fractions of Newton's step that are tried: with few observations the full step is too long."""
FAINT = 1e-4
"""Minimum weight, as a fraction of the largest: landmarks seen a few times have no residual."""
LOOSE, LOOSE_POSE = 1e-9, 1e-12
"""Damping of poorly determined landmarks and placements, as a fraction of the diagonal."""
EXACT = 1e-9
"""Residual treated as rounding, as a fraction of the map's size."""
SPARSE = 20
"""Iterations between two frames in which errors are evaluated."""
REPEATS = 4
"""Number of simulated runs from which the gain is estimated."""


def refine_by_powers(refined: Refined, seen: Observations) -> Refined:
    """Return the landmark positions that minimise the sum of powers suited to the residuals.

    `refined`: the least-squares result; `seen`: observations of its landmarks. The result is
    unchanged if no higher power suits.
    """
    solution = PowerSolution.of(seen, refined.positions)
    size = np.ptp(refined.positions, axis=0).max()
    anchor = int(np.searchsorted(seen.iterations, refined.anchor_iteration))
    if not np.abs(solution.left).max() > EXACT * size or anchor == len(seen.iterations):
        return refined
    powered = solution.by_powers()
    if powered.power == solution.power:
        return refined
    R, t = powered.state.R[anchor], powered.state.t[anchor]
    spread = refined.spread.scaled(np.sqrt(powered.gain()))
    return replace(
        refined,
        positions=(powered.state.positions - t) @ R,
        anchor_iteration=int(seen.iterations[anchor]),
        power=powered.power,
        spread=spread,
    )


def shape_of(residuals: Floats) -> float:
    """Return the power p for which noise of density ``exp(-|x|^p)`` has the residuals' kurtosis."""
    square = residuals**2
    kurtosis = np.mean(square**2) / np.mean(square) ** 2
    powers = np.geomspace(1, 4 * LAST, 500)
    kurtoses = np.exp(gammaln(5 / powers) + gammaln(1 / powers) - 2 * gammaln(3 / powers))
    return float(powers[np.argmin(np.abs(kurtoses - kurtosis))])


class Placed(NamedTuple):
    """Landmarks (m, d), and the poses of iterations, R (k, d, d) and t (k, d)."""

    positions: Floats
    R: Floats
    t: Floats

    def moved(self, by: Floats, placements: Floats) -> Placed:
        """Return the state after steps of the landmarks (m, d) and of the poses (k, p)."""
        turn, shift = np.split(placements, [-self.t.shape[1]], axis=1)
        return Placed(self.positions + by, rotations(turn) @ self.R, self.t + shift)


class PowerProblem:
    """Residuals of single observations, per axis of the robot frame; a `Problem`.

    Newton's step for a sum of powers is that of weighted least squares, divided by the power minus
    one.
    """

    rounding = 0.0

    def __init__(self, seen: Observations, n_landmarks: int) -> None:
        d = seen.points.shape[1]
        self.seen, self.power, self._unit = seen, 2, 1.0
        self.freedoms = max(seen.points.size - d * n_landmarks, 1)
        width = np.full(n_landmarks, d)
        self.pattern = Pattern.of_pairs(width, seen.iteration, seen.landmark)
        self._unknown = self.pattern.first[:, None] + np.arange(d)
        kept = np.repeat(self._unknown[seen.landmark], d, axis=0)
        rows, every = np.arange(seen.points.size), np.arange(len(seen.iterations))
        self._eliminated = Elimination(self.pattern, kept, d * seen.begin, rows, every)

    def of_power(self, power: int, unit: float) -> PowerProblem:
        """Return the same problem for another power, with residuals normalised by their size."""
        found = copy(self)
        found.power, found._unit = power, unit
        return found

    def of_points(self, points: Floats) -> PowerProblem:
        """Return the same problem for other observations (n, d) of the same landmarks."""
        found = copy(self)
        found.seen = replace(self.seen, points=points)
        return found

    def left(self, state: Placed) -> Floats:
        """Return the residual of each observation (n, d), robot frame, metres."""
        at = self.seen.iteration
        away = state.positions[self.seen.landmark] - state.t[at]
        return np.asarray(self.seen.points - np.einsum("nji,nj->ni", state.R[at], away))

    def residuals(self, state: Placed) -> Floats:
        """Return the residuals (n d,), axis by axis."""
        return self.left(state).ravel()

    def weights(self, residual: Floats) -> Floats:
        """Return the weights for which least squares minimises the sum of powers."""
        size = np.abs(residual)
        return np.asarray(np.maximum((size / size.max()) ** (self.power - 2), FAINT))

    def equations(
        self, state: Placed, weight: Floats, with_matrix: bool, damping: float
    ) -> NormalEquations:
        """Return the normal equations of the landmarks."""
        at, d = self.seen.iteration, self.seen.points.shape[1]
        back = np.swapaxes(state.R[at], 1, 2)
        turned = np.einsum("nij,nj->ni", state.R[at], self.seen.points)
        by_placement = (back @ derivatives(turned)).reshape(len(weight), -1)
        linear = Linearised(self.residuals(state), by_placement, -back.reshape(-1, d))
        equations = self._eliminated.equations(linear, weight, LOOSE_POSE, with_matrix)
        if with_matrix:
            least = LOOSE * self.pattern.largest(equations.matrix)
            self.pattern.hold(equations.matrix, damping, least)
        return equations

    def stepped(
        self, state: Placed, equations: NormalEquations, step: Floats, weight: Floats
    ) -> Placed:
        """Return the state after a step, or after the best fraction of it."""
        placements = equations.eliminated_steps(step)
        shares = [share / (self.power - 1) for share in SHARES]
        by = step[self._unknown]
        tried = [state.moved(share * by, share * placements) for share in shares]
        return min(tried, key=lambda each: self.sum_of_powers(self.residuals(each)))

    def sum_of_powers(self, residual: Floats, _: Floats | None = None) -> float:
        """Return the cost."""
        return float(np.sum(np.abs(residual / self._unit) ** self.power))


@dataclass(frozen=True, eq=False)
class PowerSolution:
    """Landmarks and poses that minimise the sum of powers of the residuals."""

    problem: PowerProblem
    state: Placed

    @classmethod
    def of(cls, seen: Observations, positions: Floats) -> PowerSolution:
        """Return the least-squares solution."""
        R, t, _ = seen.placed_on(positions)
        return cls(PowerProblem(seen, len(positions)), Placed(positions, R, t))

    @property
    def power(self) -> int:
        """The minimised power."""
        return self.problem.power

    @property
    def left(self) -> Floats:
        """Residual of each observation (n, d), robot frame, metres."""
        return self.problem.left(self.state)

    def by_powers(self) -> PowerSolution:
        """Return the solution for the highest power that suits, found by doubling it."""
        solution, power = self, FIRST
        while power <= min(shape_of(solution.left), LAST):
            for _ in range(STEPS):
                solution = solution.towards(power)
            power *= 2
        return solution

    def towards(self, power: int) -> PowerSolution:
        """Return the solution after one Newton step towards that of a power."""
        problem = self.problem.of_power(power, float(np.abs(self.left).max()))
        cost_of = problem.sum_of_powers
        found = gauss_newton(problem, self.state, problem.weights, 1, cost_of=cost_of)
        return PowerSolution(problem, found.state)

    def gain(self) -> float:
        """Return the mean squared error relative to that of least squares.

        No asymptotic formula holds with so few observations per pose, so runs with the same map and
        noise of the corresponding density are simulated and solved both ways (Efron, 1979).
        """
        rng = np.random.default_rng(0)
        left = self.left
        exact, scale = self.problem.seen.points - left, np.sqrt(np.mean(left**2))
        squares = np.zeros(2)
        for _ in range(REPEATS):
            sign, share = rng.choice([-1.0, 1.0], left.shape), 1 / self.power
            noise = scale * sign * rng.gamma(share, size=left.shape) ** share
            drawn = replace(self, problem=self.problem.of_points(exact + noise)).towards(2)
            squares += _apart(drawn.state, self.state), _apart(drawn.by_powers().state, self.state)
        return float(squares[1] / squares[0])


def _apart(one: Placed, other: Placed) -> float:
    """Return the mean square distance of the landmarks of two solutions, in robot frames."""
    here, there = (
        np.einsum("kji,kmj->kmi", each.R[::SPARSE], each.positions - each.t[::SPARSE, None])
        for each in (one, other)
    )
    return float(np.mean((here - there) ** 2))
