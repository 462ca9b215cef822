"""The map of all observations and odometry, where landmarks alone leave gaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relmap.core.geometry.alignment import fit_rigid, fixes_rotation, sums_each
from relmap.core.geometry.robust import OUTLIER, lenient, limit_of, strict
from relmap.core.motion_noise import MotionNoise
from relmap.core.refinement.bridging import Bridged
from relmap.core.refinement.chained import Chain, Chained, ChainProblem, Sigmas
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.gauss_newton import Weigh, gauss_newton
from relmap.core.refinement.joint import Refined, Spread, joint_rows
from relmap.core.refinement.residuals import (
    MergeResiduals,
    SegmentResiduals,
    merge_residuals,
    segment_residuals,
)
from relmap.core.refinement.settling import WORTH_SAYING, Settled, size_of
from relmap.core.state.kept import KeptObservations
from relmap.core.state.table import LandmarkState

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TIMES, FEW_ROUNDS, ROUNDS = 15, 10, 50
"""How often noise is estimated from what is left, and the map solved with it; steps each time, and
in the end."""
ROUGH, FINE = 1e-2, 1e-4
"""Gain that no further step is taken for, in squared standard deviations of the whole map."""
ALIKE = 0.1
"""How far apart landmarks of two parts may lie, in sizes of what they share, to be joined."""
GUESS_M = 0.1
"""Noise of an observed coordinate where nothing is known of it yet."""
SETTLED = 0.02
"""Change of the noise, as a share, that makes no difference."""
DOUBT = 0.25
"""Weight below which a step of odometry is not believed."""


@dataclass(frozen=True, eq=False)
class Solved:
    """A part of a run, solved.

    Attributes
    ----------
    refined : Refined
    poses : (k, 4, 4) float64
        Of its iterations, in the frame of `refined`.
    iterations : (k,) int64
    doubted : (i,) int64
        Iterations to which odometry does not fit.
    sigmas : Sigmas
    """

    refined: Refined
    poses: Array
    iterations: Indices
    doubted: Indices
    sigmas: Sigmas


def solve_part(
    table: LandmarkState,
    rows: SegmentRows,
    kept: KeptObservations,
    roots: Array | None,
    bridged: Bridged,
    part: int,
    motions: Array,
    noise: MotionNoise,
    noise_m: float,
    sigmas: Sigmas | None,
    to_the_last: bool,
    fewest: int,
) -> Solved | None:
    """Return a part of the run as all that was seen and odometry have it; None where nothing was.

    Parameters
    ----------
    table, rows, kept
    roots : (n, d, d) float64, optional
        Roots of the information of each observation, where covariances came.
    bridged : Bridged
        Where to start from.
    part : int
    motions : (k, 4, 4) float64
        Odometry without its constant errors; NaN where it is not known or not believed.
    noise : MotionNoise
    noise_m : float
        About that of an observed coordinate; NaN if nothing is known of it.
    sigmas : Sigmas, optional
        How much noisier all of these are, where that was found before.
    to_the_last : bool
        Whether what fits nowhere is let go, and the least cost is found to the last digit.
    fewest : int
        Observations below which a landmark is left out.
    """
    iterations = np.flatnonzero(bridged.part == part)
    every = table.now(kept.landmark)
    there = (bridged.part[kept.iteration] == part) & ~table.dynamic[every]
    often = np.bincount(every[there], minlength=len(table)) >= fewest
    chosen = np.flatnonzero(there & often[every])
    if not len(chosen):
        return None
    landmarks, of = np.unique(every[chosen], return_inverse=True)
    begin = np.searchsorted(iterations, kept.iteration[chosen])
    sigma = noise_m if np.isfinite(noise_m) and noise_m > 0 else GUESS_M
    points = kept.location[chosen]
    d = points.shape[1]
    root = (
        np.broadcast_to(np.eye(d) / sigma, (len(chosen), d, d)) if roots is None else roots[chosen]
    )
    between = motions[iterations[1:]].copy()
    between[np.diff(iterations) != 1] = np.nan
    chain = Chain(points, of, begin, root, between)
    poses = bridged.poses[iterations]
    state = _start(chain, poses, len(landmarks))
    settled, problem = _settled(
        chain, noise.sigmas(between), state, int(begin[0]), sigmas, to_the_last
    )
    state, anchor = settled.state, int(begin[0])
    R, t = state.R[anchor], state.t[anchor]
    placed = np.tile(np.eye(4), (len(iterations), 1, 1))
    placed[:, :d, :d], placed[:, :d, 3] = R.T @ state.R, (state.t - t) @ R
    seen_m = sigma * problem.sigmas.seen
    segments, merges = _residuals(rows, table, landmarks, (state.positions - t) @ R, seen_m)
    spread = Spread(problem, settled, np.ones(len(landmarks), dtype=bool), R)
    refined = Refined(
        landmarks,
        (state.positions - t) @ R,
        int(iterations[anchor]),
        seen_m,
        segments,
        merges,
        spread,
        converged=settled.converged,
    )
    way, turn = problem.parts[1:]
    weight = np.minimum(settled.weight[way], settled.weight[turn])
    doubted = iterations[problem.moved[weight < DOUBT] + 1]
    return Solved(refined, placed, iterations, doubted, problem.sigmas)


def join_parts(bridged: Bridged, solved: Sequence[Solved]) -> Bridged | None:
    """Return all scans with a part joined to the largest that shares landmarks with it.

    Parts of one log, between which no odometry came, may show the same landmarks; ids say so.

    Parameters
    ----------
    bridged : Bridged
    solved : sequence of Solved
        Its parts, the smallest first.

    Returns
    -------
    Bridged or None
        None where no part shares enough, or what it shares lies otherwise.
    """
    for k, other in enumerate(solved):
        for base in reversed(solved[k + 1 :]):
            one, another = other.refined, base.refined
            _, mine, its = np.intersect1d(one.landmarks, another.landmarks, return_indices=True)
            here, there = one.positions[mine], another.positions[its]
            if len(mine) <= here.shape[1] or not fixes_rotation(there):
                continue
            R, t = fit_rigid(here, there)
            apart = np.linalg.norm(here @ R.T + t - there, axis=1)
            if np.median(apart) > ALIKE * size_of(there):
                continue
            d, move = len(t), np.eye(4)
            move[:d, :d], move[:d, 3] = R, t
            poses, part = bridged.poses.copy(), bridged.part.copy()
            poses[base.iterations] = base.poses
            poses[other.iterations] = move @ other.poses
            part[other.iterations] = part[base.iterations[0]]
            return replace(bridged, poses=poses, part=part)
    return None


def _settled(
    chain: Chain,
    odds: tuple[Array, Array],
    state: Chained,
    anchor: int,
    sigmas: Sigmas | None,
    to_the_last: bool,
) -> tuple[Settled[Chained], ChainProblem]:
    """Return the state of the least robust cost, and estimate the noise from its residuals."""
    known = sigmas is not None
    problem = ChainProblem(chain, odds, sigmas or Sigmas(), state.positions, anchor)
    for _ in range(TIMES):
        found = gauss_newton(problem, state, _weighing(problem, lenient), FEW_ROUNDS, unsure=ROUGH)
        state = found.state
        if known and (found.converged or not to_the_last):
            break
        sigmas, before = problem.components(state, found.weight), problem.sigmas
        known = max(abs(np.log(a / b)) for a, b in zip(sigmas, before, strict=True)) < SETTLED
        problem = ChainProblem(chain, odds, sigmas, state.positions, anchor, problem.pattern)
    if to_the_last:
        found = gauss_newton(problem, state, _weighing(problem, strict), ROUNDS, unsure=FINE)
    converged = found.converged or found.gain <= WORTH_SAYING
    return Settled(found.state, found.weight, converged or not to_the_last), problem


def _weighing(problem: ChainProblem, function: Callable[[Array, float], Array]) -> Weigh:
    """Return weights by what noise explains of observations, and of odometry: each by itself."""
    d = problem.chain.points.shape[1]

    def weigh(residual: Array) -> Array:
        seen, *odometry = (residual[part] for part in problem.parts)
        return np.concatenate(
            [
                function(seen, limit_of(seen, d, 0.0)),
                # Where it is all there is, nothing is left of it.
                *(function(part, max(limit_of(part, d, 0.0), OUTLIER)) for part in odometry),
            ]
        )

    return weigh


def _start(chain: Chain, poses: Array, m: int) -> Chained:
    """Return the state in which each landmark is in the middle of where it was seen."""
    d = chain.points.shape[1]
    R, t = poses[:, :d, :d], poses[:, :d, 3]
    at = chain.iteration
    placed = np.einsum("nij,nj->ni", R[at], chain.points) + t[at]
    counts = np.bincount(chain.landmark, minlength=m)
    positions = sums_each(placed, chain.landmark, m) / counts[:, None]
    return Chained(positions, R, t, np.zeros(2 + (3 if d == 3 else 1)))


def _residuals(
    rows: SegmentRows, table: LandmarkState, landmarks: Indices, positions: Array, noise_m: float
) -> tuple[SegmentResiduals, MergeResiduals]:
    """Return what segments and merges are apart from the map."""
    whole = np.full((len(table), positions.shape[1]), np.nan)
    whole[landmarks] = positions
    chosen = np.zeros(len(table), dtype=bool)
    chosen[landmarks] = True
    landmark, none = table.now(rows.landmark), np.zeros(len(table), dtype=bool)
    joint, start = joint_rows(rows, whole, chosen, landmark, none)
    placed, at = start.placed, whole[joint.landmarks]
    return (
        segment_residuals(rows, joint, placed, at, noise_m),
        merge_residuals(
            joint.landmarks,
            joint.landmark,
            rows.landmark[joint.rows],
            placed - at[joint.landmark],
            joint.n_seen,
            np.full(len(placed), noise_m**2),
        ),
    )
