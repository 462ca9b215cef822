from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap import PointMapper
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.core.arrays import Floats
from relmap.core.map.pose import trajectory
from relmap.core.refinement import equations as jointequations
from relmap.core.refinement import gauss_newton
from relmap.core.refinement.condensing import CondensedSegments, SegmentRows
from relmap.core.refinement.joint import Refined, refine
from relmap.core.state.store import ObservationStore
from relmap.simulation import WorldSpec, simulate_figure_eight, simulate_world
from tests.worlds import Walk, aligned_rmse, driven, random_rotation, walk

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
Points = Floats


@pytest.fixture(params=["exact", "segments as a whole"])
def both_equations(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Eliminate the placements in one run of a test, and the landmarks in another."""
    name: str = request.param
    flops = {"exact": 0.0, "segments as a whole": np.inf}[name]
    monkeypatch.setattr(jointequations, "exact_flops", lambda *_: flops)
    return name


def condensed(world: Walk) -> SegmentRows:
    store = ObservationStore()
    for ids, points in world.scans:
        store.append(ids, points)
    return CondensedSegments().with_rest(store, np.zeros(len(world.landmarks), dtype=bool))


def batch_of(world: Walk) -> Batch:
    return Batch(
        np.concatenate([points for _, points in world.scans]),
        np.repeat(np.arange(len(world.scans)), [len(ids) for ids, _ in world.scans]),
        np.concatenate([ids for ids, _ in world.scans]),
    )


def refined(world: Walk, start: Points) -> Refined:
    m = len(world.landmarks)
    everyone, nobody = np.ones(m, dtype=bool), np.zeros(m, dtype=bool)
    found = refine(condensed(world), start, everyone, np.arange(m), nobody)
    assert found.landmarks.tolist() == list(range(m))
    return found


def whole(world: Walk) -> Walk:
    """Return a walk of which every landmark was seen."""
    seen = np.unique(np.concatenate([ids for ids, _ in world.scans]))
    scans = [(np.searchsorted(seen, ids), points) for ids, points in world.scans]
    return Walk(world.landmarks[seen], world.poses, scans)


@settings(max_examples=10, deadline=None)
@given(seeds, dimensions)
def test_refinement_is_exact_without_noise(seed: int, d: int) -> None:
    world = whole(walk(d, seed, iterations=60))
    start = world.landmarks + 0.1 * np.random.default_rng(seed).normal(size=world.landmarks.shape)
    found = refined(world, start)
    np.testing.assert_allclose(found.positions, world.landmarks, atol=1e-9)


@both_dimensions
@pytest.mark.parametrize("seed", range(3))
def test_refinement_is_batch_least_squares(d: int, seed: int) -> None:
    world = whole(walk(d, seed, sigma=0.05, iterations=60))
    expected = batch_least_squares(batch_of(world), world.landmarks)
    limit = aligned_rmse(expected, world.landmarks)
    assert aligned_rmse(refined(world, world.landmarks).positions, expected) < 0.03 * limit


@pytest.mark.parametrize("seed", [1105, 1207, 1208])
def test_a_map_near_the_optimum_is_refined_as_well(seed: int) -> None:
    """The cost once assumed one placement for each segment, and the optimum was refused."""
    spec = WorldSpec(kind="field", length_m=200.0, iterations=100, sigma=0.03, seed=seed)
    mapper = driven(replace(simulate_world(spec).log, ids=None))
    mapper.refine()
    assert all(submap.converged for submap in mapper.refined)


@pytest.mark.parametrize("seed", [2004, 2005])
def test_the_optimum_is_not_refused_where_detections_fail(seed: int) -> None:
    """Segments as a whole fit it less well by up to a third."""
    spec = WorldSpec(kind="field", length_m=100.0, iterations=60, sigma=0.07, seed=seed)
    world = simulate_world(replace(spec, missed=0.2, spurious=0.1))
    mapper = driven(replace(world.log, ids=None))
    mapper.refine()
    assert all(submap.converged for submap in mapper.refined)
    assert mapper.refined[0].noise_m == pytest.approx(0.07, rel=0.05)


@both_dimensions
def test_refinement_says_that_it_did_not_converge(d: int, monkeypatch: pytest.MonkeyPatch) -> None:
    world = whole(walk(d, 0, sigma=0.05, iterations=400))
    start = np.random.default_rng(0).permutation(world.landmarks)
    assert refined(world, start).converged
    monkeypatch.setattr(gauss_newton, "ROUNDS", 3)
    found = refined(world, start)
    assert aligned_rmse(found.positions, world.landmarks) > 5.0
    assert not found.converged


@both_dimensions
def test_one_placement_for_a_segment_is_nearly_as_good(
    d: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jointequations, "exact_flops", lambda *_: np.inf)
    apart, limits = [], []
    for seed in range(5):
        world = whole(walk(d, seed, sigma=0.05, iterations=60))
        expected = batch_least_squares(batch_of(world), world.landmarks)
        found = refined(world, world.landmarks)
        apart.append(aligned_rmse(found.positions, expected))
        limits.append(aligned_rmse(expected, world.landmarks))
    # What is apart from the best estimate adds to its error in squares (Gauss and Markov).
    assert np.hypot(np.median(limits), np.median(apart)) < 1.1 * np.median(limits)


def jacobian(world: Walk) -> Points:
    """Return the derivatives of all observations by poses, but the first, and landmarks."""
    batch, d = batch_of(world), world.landmarks.shape[1]
    k, m = len(world.scans), len(world.landmarks)
    q = 3 if d == 2 else 6
    R0, t0 = world.poses[0]
    J = np.zeros((len(batch.pose), d, k * q + m * d))
    for row, (pose, landmark) in enumerate(zip(batch.pose, batch.landmark, strict=True)):
        R = R0.T @ world.poses[pose][0]
        from_robot = world.landmarks[landmark] - R0.T @ (world.poses[pose][1] - t0)
        turning = turnings(d)
        J[row, :, pose * q : pose * q + q - d] = (R.T @ turning @ from_robot).T
        J[row, :, pose * q + q - d : (pose + 1) * q] = R.T
        J[row, :, k * q + landmark * d : k * q + (landmark + 1) * d] = -R.T
    return J.reshape(-1, J.shape[2])[:, q:]


def dense_covariances(world: Walk, sigma: float) -> Points:
    """Return the landmarks' covariances by a dense inverse, the first pose being the frame."""
    J, (m, d) = jacobian(world), world.landmarks.shape
    inverse = np.linalg.inv(J.T @ J)[-m * d :, -m * d :]
    blocks = inverse.reshape(m, d, m, d)
    return sigma**2 * np.stack([blocks[i, :, i] for i in range(m)])


def turnings(d: int) -> Points:
    """Return the generators of rotations, (1, 2, 2) or (3, 3, 3)."""
    if d == 2:
        return np.array([[[0.0, -1.0], [1.0, 0.0]]])
    return np.stack([np.cross(axis, np.eye(3)).T for axis in np.eye(3)])


@both_dimensions
def test_covariances_are_those_of_a_dense_inverse(d: int, both_equations: str) -> None:
    world = whole(walk(d, 5, sigma=0.02, iterations=40))
    found = refined(world, world.landmarks)
    expected = dense_covariances(world, found.noise_m)
    deviation = np.sqrt(np.trace(found.covariances, axis1=1, axis2=2))
    reference = np.sqrt(np.trace(expected, axis1=1, axis2=2))
    if both_equations == "exact":
        np.testing.assert_allclose(deviation, reference, rtol=0.02)
        scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
        np.testing.assert_allclose(found.covariances / scale, expected / scale, atol=0.05)
    else:
        np.testing.assert_allclose(deviation, reference, rtol=0.2)


def corridor(d: int, length: int, seed: int = 0) -> Walk:
    """Walk along a corridor that never closes, seeing a few landmarks at a time, without noise."""
    rng = np.random.default_rng(seed)
    road = np.column_stack([np.arange(length), rng.uniform(-2, 2, (length, d - 1))])
    scans, poses = [], []
    for k in range(length):
        R, t = random_rotation(d, 0.1, rng), np.zeros(d)
        t[0] = k
        seen = np.flatnonzero(np.abs(road[:, 0] - k) < 3.5)
        scans.append((seen, (road[seen] - t) @ R))
        poses.append((R, t))
    R0, t0 = poses[0]
    return Walk((road - t0) @ R0, poses, scans)


def noisy(world: Walk, sigma: float, seed: int) -> Walk:
    rng = np.random.default_rng(seed)
    scans = [(ids, points + rng.normal(0, sigma, points.shape)) for ids, points in world.scans]
    return Walk(world.landmarks, world.poses, scans)


def deviations_by_qr(world: Walk, sigma: float) -> Points:
    """Return the landmarks' standard deviations from all observations and poses, undamped."""
    J = jacobian(world)
    root = np.linalg.inv(np.linalg.qr(J, mode="r"))[-world.landmarks.size :]
    squares = np.sum(root**2, axis=1).reshape(world.landmarks.shape)
    return np.asarray(sigma * np.sqrt(squares.mean(axis=1)))


@pytest.mark.parametrize(("d", "length"), [(2, 300), (3, 150)])
def test_how_sure_the_end_of_a_long_corridor_is(d: int, length: int) -> None:
    world = corridor(d, length)
    found = refined(noisy(world, 0.02, 0), world.landmarks)
    expected = deviations_by_qr(world, found.noise_m)
    assert expected[-1] > 2
    variance = np.trace(found.covariances, axis1=1, axis2=2) / d
    np.testing.assert_allclose(np.sqrt(variance), expected, rtol=0.05)


@both_dimensions
def test_errors_at_the_end_of_a_corridor_are_what_is_said(d: int) -> None:
    squares, world = [], corridor(d, 150)
    for seed in range(30):
        found = refined(noisy(world, 0.002, seed), world.landmarks)
        error = found.positions[-1] - world.landmarks[-1]
        squares.append(error @ np.linalg.solve(found.covariances[-1], error) / d)
    assert 0.6 < np.mean(squares) < 1.6


def test_undetermined_landmarks_stay_without_covariance() -> None:
    """Seven landmarks may turn about the one that they share with the others."""
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (15, 3))
    scans, poses = [], []
    for k in range(48):
        R, seen = random_rotation(3, 0.2, rng), np.arange(8) + (7 if k >= 24 else 0)
        scans.append((seen, world[seen] @ R + 0.02 * rng.standard_normal((8, 3))))
        poses.append((R, np.zeros(3)))
    found = refined(Walk(world, poses, scans), world)
    assert aligned_rmse(found.positions, world) < 0.03
    deviation = np.sqrt(np.trace(found.covariances, axis1=1, axis2=2) / 3)
    assert (deviation[:8] < 0.05).all()
    assert np.isnan(deviation[8:]).all()


@both_dimensions
def test_covariances_explain_the_errors(d: int, both_equations: str) -> None:
    """Over many runs of one world the squares of the errors are what the covariances say.

    The errors of one run share that of the first pose, so that the runs must be many.
    """
    ratios, world = [], whole(walk(d, 3, iterations=40))
    for seed in range(120):
        rng = np.random.default_rng(seed)
        scans = [(ids, points + rng.normal(0, 0.02, points.shape)) for ids, points in world.scans]
        found = refined(Walk(world.landmarks, world.poses, scans), world.landmarks)
        error = found.positions - world.landmarks
        solved = np.linalg.solve(found.covariances, error[:, :, None])[:, :, 0]
        ratios.append(np.mean(np.sum(error * solved, axis=1)) / d)
    assert 0.8 < np.mean(ratios) < 1.25


def test_noise_is_estimated_from_what_is_left() -> None:
    world = whole(walk(3, 1, sigma=0.03))
    assert refined(world, world.landmarks).noise_m == pytest.approx(0.03, rel=0.1)


def test_outliers_are_down_weighted() -> None:
    """One in a hundred observations is metres off: the map is right, unlike the batch solution."""
    errors, spoilt = [], []
    for seed in (40, 41, 42):
        world = whole(walk(3, seed, sigma=0.05, iterations=200))
        rng = np.random.default_rng(seed)
        scans = []
        for ids, points in world.scans:
            off = rng.random(len(ids)) < 0.01
            scans.append((ids, points + off[:, None] * rng.normal(0, 2.0, points.shape)))
        dirty = Walk(world.landmarks, world.poses, scans)
        errors.append(aligned_rmse(refined(dirty, world.landmarks).positions, world.landmarks))
        batch = batch_least_squares(batch_of(dirty), world.landmarks)
        spoilt.append(aligned_rmse(batch, world.landmarks))
    assert np.median(errors) < 0.5 * np.median(spoilt)


@pytest.mark.parametrize("off_m", [0.0, 0.5])
def test_few_scans_are_placed_to_fix_the_frame_unless_its_own_has_outliers(
    monkeypatch: pytest.MonkeyPatch, off_m: float
) -> None:
    placed = list[float]()

    def counted(rows: SegmentRows, *others: Any) -> Any:
        placed.append(len(np.unique(rows.segment)) / rows.n_segments)
        return trajectory(rows, *others)

    monkeypatch.setattr("relmap.core.refinement.joint.trajectory", counted)
    log = simulate_figure_eight(density=25, iterations=300, seed=1).log
    points = log.points_robot.copy()
    # Of a segment, what differs from the others is an outlier; what differs within it is left out.
    assert log.ids is not None
    for landmark in np.unique(log.ids[log.iteration < 8])[::7].tolist():
        points[(log.iteration < 8) & (log.ids == landmark)] += [off_m, -off_m, off_m]
    mapper = driven(replace(log, points_robot=points))
    mapper.refine()
    assert max(placed) == 1.0 if off_m else max(placed) < 1 / 8
    pose = mapper.trajectory[mapper.refined[0].anchor_iteration]
    np.testing.assert_allclose(pose, np.eye(4), atol=1e-9)


def test_a_long_chain_that_drifts_stays_whole() -> None:
    """Its standard deviations grow to a tenth of its length; only a hinge leaves more open."""
    rng, mapper = np.random.default_rng(0), PointMapper()
    landmarks = np.column_stack([rng.uniform(-4, 104, 100), rng.uniform(-4, 4, 100)])
    for x in 0.5 * np.arange(200):
        seen = np.flatnonzero(np.abs(landmarks[:, 0] - x) < 4)
        points = landmarks[seen] - [x, 0] + rng.normal(0, 0.4, (len(seen), 2))
        mapper.update(points, seen)
    mapper.finish()
    before = len(mapper.submaps[0].landmark_ids)
    mapper.refine()
    assert len(mapper.submaps[0].landmark_ids) == before > 90
