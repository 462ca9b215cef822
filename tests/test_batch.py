from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from relmap import RelmapError
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.comparison.baselines.frames import FrameToMap
from relmap.core.arrays import Floats, Ints
from relmap.core.association import KnownAssociation
from tests.worlds import aligned_rmse, random_rotation, walk

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
Points = Floats


def observations(
    d: int, seed: int, sigma: float, poses: int = 5, n: int = 9
) -> tuple[Batch, Points, list[tuple[Points, Points]]]:
    """See most of n landmarks from a few poses; return that, the landmarks and the true poses."""
    rng = np.random.default_rng(seed)
    world = rng.uniform(-5, 5, (n, d))
    true, points, pose, landmark = [], [], [], []
    for k in range(poses):
        R = random_rotation(d, 1.0, rng)
        t: Points = rng.uniform(-3, 3, d)
        seen = np.sort(rng.permutation(n)[: n - 2]) if k else np.arange(n)
        points.append((world[seen] - t) @ R + sigma * rng.standard_normal((len(seen), d)))
        pose += [k] * len(seen)
        landmark += seen.tolist()
        true.append((R, t))
    return Batch(np.concatenate(points), np.array(pose), np.array(landmark)), world, true


def rotation(turn: Points) -> Points:
    vector = turn if len(turn) == 3 else np.array([0.0, 0.0, turn[0]])
    d = 3 if len(turn) == 3 else 2
    return np.asarray(Rotation.from_rotvec(vector).as_matrix()[:d, :d])


def dense_solution(
    batch: Batch, world: Points, poses: list[tuple[Points, Points]]
) -> tuple[Points, float]:
    """Solve for all landmarks and poses densely by scipy, from the truth; return map and cost."""
    (m, d), k = world.shape, len(poses)
    r = 1 if d == 2 else 3
    there = np.array([t for _, t in poses])

    def residuals(x: Points) -> Points:
        landmarks, motions = x[: m * d].reshape(m, d), x[m * d :].reshape(k, r + d)
        R = np.array([rotation(motions[p, :r]) @ poses[p][0] for p in range(k)])
        t = motions[:, r:] + there
        placed = np.einsum("nij,nj->ni", R[batch.pose], batch.points_robot) + t[batch.pose]
        return np.asarray((placed - landmarks[batch.landmark]).ravel())

    start = np.concatenate([world.ravel(), np.zeros(k * (r + d))])
    fit = least_squares(residuals, start, xtol=1e-12, ftol=1e-14, gtol=1e-12)
    return fit.x[: m * d].reshape(m, d), float(fit.cost)


def cost(batch: Batch, landmarks: Points) -> float:
    """Return half the sum of squares that is left of a map, each pose fitted by scipy."""
    total = 0.0
    for pose in range(int(batch.pose.max()) + 1):
        rows = batch.pose == pose
        here, there = batch.points_robot[rows], landmarks[batch.landmark[rows]]
        here, there = here - here.mean(axis=0), there - there.mean(axis=0)
        if here.shape[1] == 2:
            here, there = (np.column_stack([p, np.zeros(len(p))]) for p in (here, there))
        total += 0.5 * float(Rotation.align_vectors(there, here)[1]) ** 2
    return total


@both_dimensions
@pytest.mark.parametrize("seed", range(3))
def test_batch_is_the_dense_least_squares_solution(d: int, seed: int) -> None:
    batch, world, poses = observations(d, seed, 0.05)
    expected, least = dense_solution(batch, world, poses)
    rng = np.random.default_rng(seed)
    found = batch_least_squares(batch, world + 0.05 * rng.standard_normal(world.shape))
    assert aligned_rmse(found, expected) < 1e-5
    assert cost(batch, found) == pytest.approx(least, rel=1e-6)


@settings(max_examples=20)
@given(seeds, dimensions)
def test_batch_is_exact_without_noise(seed: int, d: int) -> None:
    batch, world, _ = observations(d, seed, 0.0)
    start = world + 0.05 * np.random.default_rng(seed).standard_normal(world.shape)
    found = batch_least_squares(batch, start)
    assert aligned_rmse(found, world) < 1e-8


@settings(max_examples=20)
@given(seeds, dimensions)
def test_batch_keeps_the_frame_of_its_start(seed: int, d: int) -> None:
    batch, world, _ = observations(d, seed, 0.0)
    rng = np.random.default_rng(seed)
    start = world @ random_rotation(d, 3.0, rng).T + rng.uniform(-9, 9, d)
    np.testing.assert_allclose(batch_least_squares(batch, start), start, atol=1e-7)


@both_dimensions
def test_batch_converges_to_a_minimum(d: int) -> None:
    batch, world, _ = observations(d, 7, 0.1)
    found, rng = batch_least_squares(batch, world), np.random.default_rng(0)
    least = cost(batch, found)
    for _ in range(20):
        assert cost(batch, found + 1e-3 * rng.standard_normal(found.shape)) > least


def test_batch_error_is_the_cramer_rao_bound() -> None:
    """Where all poses see all landmarks, the mean of them is the answer: sigma / sqrt(poses)."""
    poses, n, d, sigma = 40, 30, 2, 0.02
    errors = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        world = rng.uniform(-5, 5, (n, d))
        points = [
            (world - rng.uniform(-3, 3, d)) @ random_rotation(d, 3.0, rng)
            + sigma * rng.standard_normal((n, d))
            for _ in range(poses)
        ]
        batch = Batch(
            np.concatenate(points), np.repeat(np.arange(poses), n), np.tile(np.arange(n), poses)
        )
        errors.append(aligned_rmse(batch_least_squares(batch, world), world))
    # Alignment takes three of the 2 n degrees of freedom away.
    bound = sigma / np.sqrt(poses) * np.sqrt(d * (1 - 3 / (d * n)))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(bound, rel=0.1)


def test_batch_names_a_pose_that_is_not_fixed() -> None:
    batch, world, _ = observations(3, 0, 0.0)
    few = (batch.pose != 2) | (np.cumsum(batch.pose == 2) <= 2)
    with pytest.raises(RelmapError, match="pose 2 is not determined"):
        batch_least_squares(
            Batch(batch.points_robot[few], batch.pose[few], batch.landmark[few]), world
        )
    absent = batch.pose != 2
    with pytest.raises(RelmapError, match="pose 2 is not determined"):
        batch_least_squares(
            Batch(batch.points_robot[absent], batch.pose[absent], batch.landmark[absent]), world
        )


@both_dimensions
def test_batch_of_one_pose_returns_its_observations(d: int) -> None:
    batch, world, _ = observations(d, 0, 0.1, poses=1)
    found = batch_least_squares(batch, world)
    assert aligned_rmse(found, batch.points_robot) < 1e-12
    twice = Batch(
        np.concatenate([batch.points_robot, batch.points_robot]),
        np.concatenate([batch.pose, batch.pose]),
        np.concatenate([batch.landmark, batch.landmark]),
    )
    np.testing.assert_allclose(batch_least_squares(twice, world), found)


def test_batch_reports_unsolvable_problems() -> None:
    batch, world, _ = observations(2, 0, 0.1)
    with pytest.raises(RelmapError, match="landmark 9 is not seen"):
        batch_least_squares(batch, np.vstack([world, [[0.0, 0.0]]]))
    first, second = observations(2, 1, 0.0)[0], observations(2, 2, 0.0)[0]
    apart = Batch(
        np.concatenate([first.points_robot, second.points_robot]),
        np.concatenate([first.pose, second.pose + 5]),
        np.concatenate([first.landmark, second.landmark + 9]),
    )
    worlds = np.vstack([observations(2, 1, 0.0)[1], observations(2, 2, 0.0)[1]])
    with pytest.raises(RelmapError, match="do not connect"):
        batch_least_squares(apart, worlds)


def test_batch_reports_that_it_did_not_converge() -> None:
    batch, world, _ = observations(2, 0, 0.1)
    with pytest.raises(RelmapError, match="did not converge in 1 iterations"):
        batch_least_squares(batch, world, iterations=1)


# Frame to map.


def naive_frame_to_map(scans: list[tuple[Ints, Points]], d: int) -> dict[int, Points]:
    """Average each scan, fitted by scipy, into lists of all that was placed so far."""
    placed: dict[int, list[Points]] = {}
    for ids, points in scans:
        spatial = np.zeros((len(points), 3))
        spatial[:, :d] = points
        known = [row for row, i in enumerate(ids) if int(i) in placed]
        if placed:
            if len(known) < d:
                continue
            there = np.array([np.mean(placed[int(ids[row])], axis=0) for row in known])
            a, b = spatial[known].mean(axis=0), there.mean(axis=0)
            if d == 3:
                R = Rotation.align_vectors(there - b, spatial[known] - a)[0]
            else:
                cross = np.cross(spatial[known] - a, there - b)[:, 2].sum()
                angle = np.arctan2(cross, np.sum((spatial[known] - a) * (there - b)))
                R = Rotation.from_euler("Z", angle)
            spatial = R.apply(spatial - a) + b
        for i, point in zip(ids, spatial, strict=True):
            if i >= 0:
                placed.setdefault(int(i), []).append(point)
    return {i: np.mean(all_of_it, axis=0) for i, all_of_it in sorted(placed.items())}


@settings(max_examples=10)
@given(seeds, dimensions)
@example(seed=14890, d=2)  # one observation is rejected
def test_frame_to_map_is_the_naive_average(seed: int, d: int) -> None:
    scans = walk(d, seed, sigma=0.05, iterations=40).scans
    scans = [(np.where(ids % 7 == 3, -1, ids), points) for ids, points in scans]
    baseline, association = FrameToMap(d), KnownAssociation()
    for ids, points in scans:
        baseline.update(points, ids)
        ids[association.match(points, ids) < 0] = -1
    expected = naive_frame_to_map(scans, d)
    assert baseline.map.landmark_ids.tolist() == list(expected)
    np.testing.assert_allclose(baseline.map.positions, list(expected.values()), atol=1e-6)


@settings(max_examples=10)
@given(seeds, dimensions)
def test_frame_to_map_is_exact_without_noise(seed: int, d: int) -> None:
    world = walk(d, seed, iterations=60)
    baseline = FrameToMap(d)
    for ids, points in world.scans:
        baseline.update(points, ids)
    found = baseline.map
    assert (np.diff(found.landmark_ids) > 0).all()
    np.testing.assert_allclose(
        found.positions[:, :d], world.landmarks[found.landmark_ids], atol=1e-8
    )
    assert (found.positions[:, d:] == 0).all()


def test_frame_to_map_leaves_out_undetermined_scans() -> None:
    baseline = FrameToMap(2)
    baseline.update(np.empty((0, 2)), np.empty(0, dtype=np.int64))
    assert len(baseline.map.landmark_ids) == 0
    baseline.update(np.array([[0.0, 0.0], [2.0, 0.0]]), np.array([5, 3]))
    baseline.update(np.array([[1.0, 1.0], [9.0, 9.0]]), np.array([5, 8]))  # one known: not fixed
    assert baseline.map.landmark_ids.tolist() == [3, 5]
    baseline.update(np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 2.0]]), np.array([5, 3, 8]))
    assert baseline.map.landmark_ids.tolist() == [3, 5, 8]
    np.testing.assert_allclose(
        baseline.map.positions, [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 1.0, 0.0]], atol=1e-12
    )


def test_frame_to_map_leaves_out_an_inconsistent_observation() -> None:
    places = np.random.default_rng(0).uniform(-5.0, 5.0, (8, 2))
    baseline = FrameToMap(2)
    for k in range(10):
        points = places - [0.1 * k, 0.0]
        if k == 6:
            points[3] += 2.0
        baseline.update(points, np.arange(8))
    np.testing.assert_allclose(baseline.map.positions[:, :2], places, atol=1e-9)
