"""Refinement by single observations, weighted by their covariances, given or estimated.

Observations with different, anisotropic noise cannot be summarised by segments. So they are kept,
and the map refined by segments is the initial estimate. The problem is that of a chain of poses
without odometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats, Ints, positions_of
from relmap.core.geometry.alignment import fit_rigid_each, sums_each
from relmap.core.geometry.robust import limit_of
from relmap.core.refinement.chain.chain_data import Chain, Chained, Sigmas, unexplained
from relmap.core.refinement.chain.chained import ChainProblem
from relmap.core.refinement.condensing import LENGTH
from relmap.core.refinement.gauss_newton import Solution, better, settle, size_of
from relmap.core.refinement.joint import Refined, Spread
from relmap.core.refinement.observations import Observations, observations_of
from relmap.core.refinement.trend import SURELY
from relmap.core.state.kept import KeptObservations

LEAST = 1e-6
"""Least weight of an observation in the first fit of its scan."""


def refine_weighed(
    refined: Refined,
    kept: KeptObservations,
    of: Ints,
    estimated: Callable[[Floats], Floats] | None = None,
    has_ids: bool = False,
) -> Refined:
    """Return the landmark positions by observations weighted with their covariances.

    `refined`: the map refined by segments; `of` (k,): the landmark that each number stands for,
    after merging. `estimated`: covariances of points, robot frame. They are kept as they are where
    the map predicts the observations: by measured distances, those that are measured too short
    would weigh more, and landmarks be too near. `has_ids`: whether ids are known; some may be
    wrong.
    """
    own = refined.landmarks, refined.positions
    seen, rows = observations_of(kept.location, of[kept.landmark], kept.iteration, *own)
    anchor = int(np.searchsorted(seen.iterations, refined.anchor_iteration))
    counts = np.bincount(seen.landmark, minlength=len(refined.landmarks))
    if anchor == len(seen.iterations) or not counts.all():
        return refined
    covariance = kept.covariance.copy()
    if estimated is not None:
        R, t = _poses(seen, _root(covariance[rows]), refined.positions)
        away = refined.positions[seen.landmark] - t[seen.iteration]
        covariance[rows] = estimated(np.einsum("nji,nj->ni", R[seen.iteration], away))
        kept.weigh(covariance)
    problem, settled = solve_weighed(seen, covariance[rows], refined.positions, anchor)
    if has_ids and (settled.weight < 1).any():
        settled = _settle_near(problem, seen, refined, settled)
    state, unit = settled.state, _unit(seen, problem, settled)
    R, t = state.R[anchor], state.t[anchor]
    every = np.ones(len(refined.landmarks), dtype=bool)
    return replace(
        refined,
        positions=(state.positions - t) @ R,
        anchor_iteration=int(seen.iterations[anchor]),
        spread=Spread(problem, settled, every, unit * R),
        converged=settled.converged,
        n_outliers=int(np.sum(settled.weight < 1)),
    )


def solve_weighed(
    seen: Observations, covariance: Floats, positions: Floats, anchor: int
) -> tuple[ChainProblem, Solution[Chained]]:
    """Solve for landmarks, starting from positions (m, d), and poses; return also the problem.

    `covariance` (n, d, d) of the observations `seen`; `anchor`: index of the fixed iteration.
    """
    root = _root(covariance)
    R, t = _poses(seen, root, positions)
    d, none = seen.points.shape[1], np.full((len(t) - 1, 4, 4), np.nan)
    chain = Chain(seen.points, seen.landmark, seen.iteration, root, none)
    step_sd = none[:, 0, 0], none[:, 0, 0]
    problem = ChainProblem(chain, step_sd, Sigmas(), positions, anchor, turns_whole=False)
    return problem, settle(problem, Chained(positions, R, t, np.zeros(2 * d - 1)))


def _settle_near(
    problem: ChainProblem, seen: Observations, refined: Refined, known: Solution[Chained]
) -> Solution[Chained]:
    """Return a known solution, or a better one that is found near the map refined by segments.

    Its outliers are left out of the first poses: a wrong id far away turns a scan that shows
    little, and then the map.
    """
    positions, d = refined.positions, refined.positions.shape[1]
    trust = np.maximum(_weight_by_segments(refined, seen), LEAST)
    R, t = _poses(seen, problem.chain.root * np.sqrt(trust)[:, None, None], positions)
    limit = limit_of(problem.residuals(known.state), d, size_of(positions))
    return better(problem, limit, known, [Chained(positions, R, t, np.zeros(2 * d - 1))])


def _weight_by_segments(refined: Refined, seen: Observations) -> Floats:
    """Return the weight (n,) of each observation in the map refined by segments; 0 if in none."""
    rows, weight = refined.spread.problem.rows, refined.spread.settled.weight
    row, bit = np.nonzero((rows.visible[:, None] >> np.arange(LENGTH)) & 1)
    when = refined.segments.first_iteration[rows.segment[row]] + bit
    end = int(max(when.max(), seen.iterations.max())) + 1
    keys = rows.landmarks[rows.landmark[row]] * end + when
    own = refined.landmarks[seen.landmark] * end + seen.iterations[seen.iteration]
    at = positions_of(keys, own)
    return np.where(at >= 0, weight[row[at]], 0.0)


def _unit(seen: Observations, problem: ChainProblem, settled: Solution[Chained]) -> float:
    """Return the size of the residuals, in standard deviations by the covariances.

    Of single observations, or, if they are significantly larger, of means over the iterations of a
    segment: errors that last are not averaged out.
    """
    state, explained, d = settled.state, settled.weight == 1, seen.points.shape[1]
    left = unexplained(problem.chain, state)[explained]
    variance = np.sum(left**2) / max(problem.freedoms - d * np.sum(~explained), 1)
    segment, landmark = seen.iterations[seen.iteration] // LENGTH, seen.landmark
    keys, of, n_seen = np.unique(
        (segment * len(state.positions) + landmark)[explained],
        return_inverse=True,
        return_counts=True,
    )
    means = sums_each(left, of, len(keys)) / np.sqrt(n_seen)[:, None]
    n_free = d * (len(keys) - len(state.positions)) - (3 * d - 3) * len(np.unique(segment))
    if n_free > 0:
        between = np.sum(means**2) / n_free
        if between > (1 + SURELY * np.sqrt(2 / n_free)) * variance:
            variance = between
    return float(np.sqrt(variance))


def _root(covariance: Floats) -> Floats:
    """Return matrices (n, d, d) that convert differences to standard deviations."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


def _poses(seen: Observations, root: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """Return approximate poses (k, d, d) and (k, d) of the iterations; see `solve_weighed`."""
    weight, there = np.sum(root**2, axis=(1, 2)), positions[seen.landmark]
    return fit_rigid_each(seen.points, there, weight, seen.iteration, len(seen.iterations))[:2]
