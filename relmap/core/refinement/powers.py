"""Refinement by the shape of the noise: bounded noise has edges, and they say more than the rest.

Least squares is best for normal noise.  Where residuals are spread more evenly, the sum of their
p-th powers is made least instead: p = 2 is least squares, p to infinity Chebyshev's estimate.  It
is the best for noise of density ``exp(-|x|^p)`` (Subbotin, 1923), so p is taken from the kurtosis
of the residuals, axis by axis in the robot's frame.  Every single observation is needed for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.equations import held, levels_of, rotations
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.observations import Observations

FIRST, LAST = 4, 16
"""Powers of use: below, least squares is as good; above, the steps get too rough."""
STEPS = 2
"""Newton steps for each power on the way."""
SHARES = (1.0, 0.5, 0.25)
"""Parts of Newton's step that are tried: where little is seen the whole of it is too long."""
FAINT = 1e-4
"""Least weight, as a share of the largest: what was seen a few times leaves no residual."""
LOOSE = 1e-9
"""What holds a landmark that hangs by too little, as a share of what holds others."""
EXACT = 1e-9
"""Residual, as a share of the map's size, that is taken for rounding."""
SPARSE = 20
"""Iterations from one in whose frame errors are told to the next."""
REPEATS = 4
"""Simulated runs from which the gain is told."""


def refine_by_powers(refined: Refined, seen: Observations) -> Refined:
    """Return where landmarks lie by the least sum of the powers that suit the residuals.

    Parameters
    ----------
    refined : Refined
        By least squares.
    seen : Observations
        Of its landmarks.

    Returns
    -------
    Refined
        As it came where no higher power suits.
    """
    solution = _Solution.of(seen, refined.positions)
    size = np.ptp(refined.positions, axis=0).max()
    anchor = int(np.searchsorted(seen.iterations, refined.anchor_iteration))
    if not np.abs(solution.left).max() > EXACT * size or anchor == len(seen.iterations):
        return refined
    powered = solution.by_powers()
    if powered.power == solution.power:
        return refined
    R, t = powered.R[anchor], powered.t[anchor]
    spread = refined.spread.scaled(np.sqrt(powered.gain()))
    return replace(
        refined, positions=(powered.positions - t) @ R, power=powered.power, spread=spread
    )


def shape_of(residuals: NDArray[np.float64]) -> float:
    """Return the power p for which noise of density ``exp(-|x|^p)`` has the residuals' kurtosis."""
    square = residuals**2
    kurtosis = np.mean(square**2) / np.mean(square) ** 2
    powers = np.geomspace(1, 4 * LAST, 500)
    kurtoses = np.exp(gammaln(5 / powers) + gammaln(1 / powers) - 2 * gammaln(3 / powers))
    return float(powers[np.argmin(np.abs(kurtoses - kurtosis))])


@dataclass(frozen=True, eq=False)
class _Solution:
    """Landmarks and placements of the least sum of powers of what is left."""

    seen: Observations
    pattern: Pattern
    positions: NDArray[np.float64]
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    power: int = 2

    @classmethod
    def of(cls, seen: Observations, positions: NDArray[np.float64]) -> _Solution:
        """Return the solution of least squares."""
        level = levels_of(seen.begin, seen.landmark, len(positions))[0]
        R, t, _ = seen.placed_on(positions)
        return cls(seen, Pattern.of_levels(level, positions.shape[1]), positions, R, t)

    @property
    def left(self) -> NDArray[np.float64]:
        """What is left of each observation (n, d), robot frame, metres."""
        away = self.positions[self.seen.landmark] - self.t[self.seen.iteration]
        there = np.einsum("nji,nj->ni", self.R[self.seen.iteration], away)
        return np.asarray(self.seen.points - there)

    def by_powers(self) -> _Solution:
        """Return the solution of the highest power that suits, found by doubling it."""
        solution, power = self, FIRST
        while power <= min(shape_of(solution.left), LAST):
            for _ in range(STEPS):
                solution = solution.step(power)
            power *= 2
        return solution

    def step(self, power: int) -> _Solution:
        """Return the solution after a step towards a power's: Newton's, or better part of it."""
        from relmap.core.refinement.power_kernels import placement_steps, power_equations

        at, of = self.seen.iteration, self.seen.landmark
        left = np.abs(self.left)
        weight = np.maximum((left / left.max()) ** (power - 2), FAINT)
        turned = np.einsum("nij,nj->ni", self.R[at], self.seen.points)
        residual = turned + self.t[at] - self.positions[of]
        right, buffer = np.zeros_like(self.positions), np.zeros(self.pattern.size)
        rows = self.seen.begin, of, turned, residual, weight, self.R
        power_equations(*rows, right, buffer, self.pattern.blocks)
        held(self.pattern, buffer, LOOSE, 0.0)
        self.pattern.factorise(buffer)
        move = self.pattern.solve(buffer, right)
        steps = placement_steps(self.seen.begin, turned, residual - move[of], weight, self.R)
        tried = [self._moved(share / (power - 1), move, steps, power) for share in SHARES]
        return min(tried, key=lambda each: float(np.sum((each.left / left.max()) ** power)))

    def _moved(
        self, share: float, move: NDArray[np.float64], steps: NDArray[np.float64], power: int
    ) -> _Solution:
        d = self.positions.shape[1]
        R, t = rotations(share * steps[:, :-d]) @ self.R, self.t + share * steps[:, -d:]
        return replace(self, positions=self.positions + share * move, R=R, t=t, power=power)

    def gain(self) -> float:
        """Return the mean squared error as a share of that of least squares.

        No formula holds where so few observations fix each placement, so runs with the same map and
        noise of the power's own density are estimated both ways (Efron, 1979).
        """
        rng = np.random.default_rng(0)
        left = self.left
        exact, scale = self.seen.points - left, np.sqrt(np.mean(left**2))
        squares = np.zeros(2)
        for _ in range(REPEATS):
            sign, share = rng.choice([-1.0, 1.0], left.shape), 1 / self.power
            noise = scale * sign * rng.gamma(share, size=left.shape) ** share
            seen = replace(self.seen, points=exact + noise)
            drawn = replace(self, seen=seen).step(2)
            squares += _apart(drawn, self), _apart(drawn.by_powers(), self)
        return float(squares[1] / squares[0])


def _apart(one: _Solution, other: _Solution) -> float:
    """Return the mean square distance of the landmarks of two solutions, as robots see them."""
    here, there = (
        np.einsum("kji,kmj->kmi", each.R[::SPARSE], each.positions - each.t[::SPARSE, None])
        for each in (one, other)
    )
    return float(np.mean((here - there) ** 2))
