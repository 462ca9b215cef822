"""Long chains of odometry: steps that turn a part as a whole, and places that are seen again."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from relmap import PointMapper
from relmap.core.arrays import Floats
from relmap.core.association.reobservation.coinciding import neighbours_fit, within
from relmap.core.association.reobservation.voting_kernels import most_voted
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.geometry.motions import derivatives
from relmap.core.geometry.robust import huber
from relmap.core.motion_noise import MotionNoise
from relmap.core.refinement.chain.chain_data import Chain, Chained, Sigmas
from relmap.core.refinement.chain.chained import ChainProblem
from relmap.core.refinement.chain.drift import Drift
from relmap.core.refinement.gauss_newton import Solution
from relmap.core.revisiting import mergeable
from relmap.core.state.table import LandmarkState
from relmap.evaluation.metrics import purity
from tests.worlds import turn

Array = Floats
SEES_M, STEP_M, NOISE_M = 2.5, 0.4, 0.02


def motion(x_m: float, yaw: float) -> Array:
    found = np.eye(4)
    found[:2, :2], found[0, 3] = turn(yaw), x_m
    return found


def straight_chain(n: int) -> tuple[ChainProblem, Chained]:
    """Return poses along a line, with a landmark beside each that the next one sees too."""
    R, t = np.tile(np.eye(2), (n, 1, 1)), np.zeros((n, 2))
    t[:, 0] = np.arange(n)
    positions: Array = t + np.array([0.3, 1.0])
    landmark = np.concatenate([np.arange(n), np.arange(n - 1)])
    iteration = np.concatenate([np.arange(n), np.arange(1, n)])
    order = np.argsort(iteration, kind="stable")
    landmark, iteration = landmark[order], iteration[order]
    points = positions[landmark] - t[iteration]
    root = np.tile(np.eye(2) / NOISE_M, (len(points), 1, 1))
    chain = Chain(points, landmark, iteration, root, np.tile(motion(1.0, 0.0), (n - 1, 1, 1)))
    step_sd = np.full(n - 1, 0.05), np.full(n - 1, 0.01)
    problem = ChainProblem(chain, step_sd, Sigmas(), positions, anchor=0)
    return problem, Chained(positions, R, t, np.zeros(3))


def test_a_step_turns_the_rest_of_a_chain_as_a_whole() -> None:
    n, knee, turn = 30, 10, 0.5
    problem, state = straight_chain(n)
    step = np.zeros(problem.pattern.n_unknowns)
    for unknowns, places in ((problem.unknown, state.positions), (problem.pose[:, 1:], state.t)):
        away = places[knee:] - state.t[knee]
        step[unknowns[knee:]] = derivatives(away)[:, :, 0] * turn
    step[problem.pose[knee:, 0]] = turn
    weight = np.ones(len(problem.residuals(state)))
    equations = problem.equations(state, weight, False, 0.0)
    left = problem.residuals(problem.stepped(state, equations, step, weight))
    seen, way, turns = problem.parts
    at = problem.chain.iteration
    # Beyond the knee nothing is stretched, as independent shifts would: by 12 % of each way.
    assert left[seen][at > knee].max() < 1e-6
    assert np.delete(left[way], knee - 1).max() < 1e-6
    assert np.flatnonzero(left[turns] > 1e-6).tolist() == [knee - 1]


def test_the_pull_of_hubers_weights_stays_the_same() -> None:
    residual = np.array([0.5, 2.0, 4.0, 400.0])
    assert (huber(residual, 2.0) * residual).tolist() == [0.5, 2.0, 2.0, 2.0]


def test_what_is_measured_badly_is_not_a_slip() -> None:
    noise = MotionNoise(sigma_way=0.01, sigma_m=0.001, sigma_rad=0.001)
    odometry, measured = motion(1.0, 0.0)[None], motion(1.0, 0.05)[None]
    assert noise.slipped(odometry, measured).tolist() == [True]
    assert noise.slipped(odometry, measured, 0.0, np.array([0.02])).tolist() == [False]


@pytest.mark.parametrize("yaw", [0.3, -0.7])
def test_votes_find_a_turn_and_a_shift(yaw: float) -> None:
    rng = np.random.default_rng(3)
    there = rng.uniform(-20, 20, (200, 2))
    points = (there[:12] - [3.0, -2.0]) @ turn(yaw)
    angles = np.linspace(-1, 1, 201)
    reach = np.full(len(there), 6.0)
    votes, shift = most_voted(points, there, reach, angles, 0.4)
    best = int(np.argmax(votes[:, 0]))
    assert votes[best, 0] >= 12
    assert abs(angles[best] - yaw) < 0.02
    assert np.abs(shift[best, 0] - [3.0, -2.0]).max() <= 0.4
    assert votes[best, 1] < 6


def test_votes_in_fine_cells_take_little_memory() -> None:
    rng = np.random.default_rng(3)
    there = rng.uniform(-100, 100, (60, 2))
    points = there[:12] - [31.0, -2.0]
    votes, shift = most_voted(points, there, np.full(60, 300.0), np.zeros(1), 1e-4)
    assert votes[0, 0] >= 12
    assert np.abs(shift[0, 0] - [31.0, -2.0]).max() <= 1e-4


def test_no_landmark_is_merged_into_one_that_is_itself_merged() -> None:
    table = LandmarkState()
    for landmark in range(5):
        table.enter(np.array([landmark]), np.zeros((1, 2)), landmark)
    pairs = np.array([[2, 1], [4, 2], [0, 3], [3, 1]])
    assert mergeable(table, pairs).tolist() == [[2, 1], [3, 0]]


def round_a_square(side_m: float, step_m: float, sides: int, more: int) -> list[Array]:
    """Return the poses (k, 4, 4) of a run along so many sides of a square, and some more steps."""
    poses, per_side = [np.eye(4)], round(side_m / step_m)
    for k in range(1, sides * per_side + more):
        poses.append(poses[-1] @ motion(step_m, np.pi / 2 if k % per_side == 0 else 0.0))
    return poses


def rounds(rng: np.random.Generator) -> tuple[Array, list[Array]]:
    """Return landmarks along a square corridor of 80 m, and the poses (k, 4, 4) of two rounds."""
    side, corners = 20.0, np.array([[0, 0], [20, 0], [20, 20], [0, 20]])
    along = rng.uniform(0, 4 * side, 130)
    leg, rest = (along // side).astype(int), along % side
    ahead = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    across = rng.uniform(0.4, 1.8, len(along)) * rng.choice([-1, 1], len(along))
    landmarks = corners[leg] + rest[:, None] * ahead[leg] + across[:, None] * ahead[leg - 1]
    return landmarks, round_a_square(side, STEP_M, 8, 30)


def driven(
    landmarks: Array,
    poses: list[Array],
    noise_m: float,
    rng: np.random.Generator,
    sees_m: float = SEES_M,
) -> tuple[PointMapper, list[tuple[int, int]]]:
    """Map a run with drifting odometry; return also number and landmark of each observation."""
    mapper, seen = PointMapper(), []
    for k, pose in enumerate(poses):
        local = (landmarks - pose[:2, 3]) @ pose[:2, :2]
        near = np.flatnonzero((np.linalg.norm(local, axis=1) < sees_m) & (local[:, 0] > 0))
        local = local[near] + rng.normal(0, noise_m, (len(near), 2))
        moved = np.linalg.inv(poses[k - 1]) @ pose if k else None
        if moved is not None:
            moved = moved @ motion(rng.normal(0, 0.005), 0.004 + rng.normal(0, 0.01))
        numbers = mapper.update(local, odometry=moved)
        seen += list(zip(numbers.tolist(), near.tolist(), strict=True))
    mapper.finish()
    mapper.refine()
    return mapper, seen


def test_a_loop_without_noise_of_observations_can_be_looked_for() -> None:
    rng = np.random.default_rng(5)
    landmarks, poses = rounds(rng)
    mapper, _ = driven(landmarks, poses, 0.0, rng)
    assert len(mapper.submaps) == 1
    assert np.isfinite(mapper.map.positions).all()


@pytest.mark.parametrize("n_seen", [0, 1])
def test_scans_of_one_landmark_or_none_are_refined_without_warnings(n_seen: int) -> None:
    mapper = PointMapper()
    for k in range(40):
        local = np.array([[2.5 - STEP_M * (k % 5), 1.0]])
        mapper.update(local[: n_seen * (k % 7)], odometry=motion(STEP_M, 0.0))
    mapper.finish()
    mapper.refine()
    assert len(mapper.submaps) == n_seen


def test_a_loop_that_drift_left_open_by_metres_is_closed() -> None:
    rng = np.random.default_rng(5)
    landmarks, poses = rounds(rng)
    mapper, seen = driven(landmarks, poses, NOISE_M, rng)
    found = mapper.map
    number, true = np.array(seen).T
    now = mapper.landmarks_of(number)
    of = np.array([np.bincount(true[now == one]).argmax() for one in found.landmark_ids])
    R, t = fit_rigid(found.positions[:, :2], landmarks[of])
    off = np.linalg.norm(found.positions[:, :2] @ R.T + t - landmarks[of], axis=1)
    assert len(mapper.submaps) == 1
    assert len(of) <= 1.1 * len(np.unique(of))
    assert np.sqrt(np.mean(off**2)) < 0.25
    assert mapper.odometry.is_used
    assert mapper.odometry.drift >= 1.0


def test_a_lattice_is_not_closed_one_period_off() -> None:
    along = np.arange(-12.0, 57.0, 3.0)
    lattice = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    poses = round_a_square(45.0, 0.75, 5, 10)
    mapper, seen = driven(lattice, poses, 0.09, np.random.default_rng(2), sees_m=4.5)
    number, true = np.array(seen).T
    assert mapper.odometry.is_used
    assert purity(mapper.landmarks_of(number), true) == 1.0


def test_a_lattice_that_drifted_by_a_period_is_ambiguous() -> None:
    rng = np.random.default_rng(3)
    lattice = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), axis=-1).reshape(-1, 2)
    scattered = rng.uniform(0, 12, (144, 2))
    for others, expected in ((lattice, True), (scattered, False)):
        old = others[np.linalg.norm(others - 5.5, axis=1) < 2.5]
        new = old + rng.normal(0, 0.01, old.shape)
        assert neighbours_fit(new, old, others, 1.5, 0.05) == expected
    assert not neighbours_fit(new, old, lattice, 0.5, 0.05)


def test_distances_vary_as_their_covariances_say() -> None:
    problem, state = straight_chain(12)
    weight = np.ones(len(problem.residuals(state)))
    drift = Drift(problem, Solution(state, weight))
    pattern, matrix = problem.pattern, problem.equations(state, weight, True, 0.0).matrix
    pattern.factorise(matrix)
    every = np.array([pattern.solve(matrix, column) for column in np.eye(pattern.n_unknowns)])
    near, far = problem.unknown[[3, 4]], problem.unknown[[0, 11]]
    expected = []
    for one, other in (near, far):
        across = every[np.ix_(one, other)]
        expected.append(every[np.ix_(one, one)] + every[np.ix_(other, other)] - across - across.T)
    assert_allclose(drift.between(np.array([near, far])), expected, rtol=1e-6, atol=1e-12)
    assert np.trace(expected[1]) > 9 * np.trace(expected[0])


def test_only_the_covariance_says_what_is_near() -> None:
    apart = np.array([[3.0, 0.0], [0.0, 3.0], [1.0, 1.0]])
    assert within(apart, np.diag([1.0, 0.01]), 4.0).tolist() == [True, False, False]
