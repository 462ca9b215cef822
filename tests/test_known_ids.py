"""With known ids all that the observations determine is in one map, wherever groups end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap import PointMapper
from relmap.cli.outcome import overruled
from relmap.cli.warned import doubtful
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.core.arrays import Floats, Ints
from relmap.datasets import ObservationLog
from relmap.simulation import simulate_figure_eight
from relmap.simulation.worlds import World, WorldSpec, simulate_world
from tests.worlds import Scans, aligned_rmse, random_rotation, refined

Array = Floats


def driven(log: ObservationLog) -> PointMapper:
    return mapped([(scan.ids, scan.points_robot) for scan in log.scans()])


def mapped(scans: Scans) -> PointMapper:
    return refined(PointMapper(), ((points, ids) for ids, points in scans))


def limit(world: World) -> tuple[Ints, Array]:
    """Return the map of batch least squares with the true ids."""
    log, d = world.log, world.log.points_robot.shape[1]
    fixed = np.bincount(log.iteration)[log.iteration] >= d
    ids, landmark = np.unique(world.true_ids[fixed], return_inverse=True)
    pose = np.unique(log.iteration[fixed], return_inverse=True)[1]
    start = world.landmarks_map[ids, :d]
    return ids, batch_least_squares(Batch(log.points_robot[fixed], pose, landmark), start)


def ratio(mapper: PointMapper, world: World) -> float:
    """Return the error of a map relative to that of batch least squares."""
    d, (ids, best) = world.log.points_robot.shape[1], limit(world)
    assert len(mapper.submaps) == 1
    found = mapper.map
    assert len(found.landmark_ids) >= 0.98 * len(ids)
    at, truth = np.searchsorted(ids, found.landmark_ids), world.landmarks_map
    there = truth[found.landmark_ids, :d]
    return aligned_rmse(found.positions[:, :d], there) / aligned_rmse(best[at], there)


@pytest.mark.parametrize("kind", ["streets", "corridor", "plane"])
def test_missed_detections_leave_one_map_at_the_limit(kind: str) -> None:
    spec = WorldSpec(kind=kind, missed=0.3, length_m=200, iterations=150, seed=11)
    world = simulate_world(spec)
    assert ratio(driven(world.log), world) < 1.05


@pytest.mark.parametrize("share", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("kind", ["streets", "field"])
def test_wrong_ids_cost_next_to_nothing(kind: str, share: float) -> None:
    spec = WorldSpec(kind=kind, wrong_ids=share, length_m=200, iterations=150, seed=12)
    world = simulate_world(spec)
    mapper = driven(world.log)
    assert ratio(mapper, world) < 1.1
    iteration, row = mapper.rejected_observations.T
    overruled = np.searchsorted(world.log.iteration, iteration) + row
    wrong = np.flatnonzero(world.log.ids != world.true_ids)
    assert len(np.intersect1d(overruled, wrong)) > 0.6 * len(wrong)
    assert len(np.setdiff1d(overruled, wrong)) < 0.01 * len(world.log.ids)


@pytest.mark.parametrize("seed", [3, 5])
def test_ids_that_name_two_landmarks_cost_next_to_nothing(seed: int) -> None:
    """Seven landmarks of a hundred, elsewhere, have the id of another: maps were off by 50 m."""
    world = simulate_world(WorldSpec(seed=seed))
    places, ids = world.landmarks_map, world.log.ids.copy()
    order = np.argsort(places[:, 0])
    pairs = np.column_stack([order[: len(order) // 2], order[(len(order) + 1) // 2 :]])
    pairs = pairs[np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1) > 50][:20]
    for one, other in pairs.tolist():
        ids[world.true_ids == other] = one
    mapper = driven(replace(world.log, ids=ids))
    known, best = limit(world)
    found = mapper.map.landmark_ids
    own = ~np.isin(found, pairs)
    assert len(mapper.submaps) == 1
    assert own.sum() >= 0.98 * (len(known) - pairs.size)
    there, at = places[found[own], :2], np.searchsorted(known, found[own])
    error_m = aligned_rmse(mapper.map.positions[own, :2], there)
    assert error_m < 1.1 * aligned_rmse(best[at], there)


def visits(shared: int, d: int) -> tuple[Array, Scans]:
    """See two places one after the other; one scan between them sees some landmarks of both."""
    rng = np.random.default_rng(d)
    world = rng.uniform(-10, 10, (40, d))
    world[20:, 0] += 30
    bridge = np.concatenate([np.arange(shared), np.arange(20, 20 + shared)])
    scans: Scans = []
    for seen in [np.arange(20)] * 30 + [bridge] + [np.arange(20, 40)] * 30:
        R, t = random_rotation(d, 0.5, rng), rng.uniform(-1, 1, d)
        scans.append((seen, (world[seen] - t) @ R + 0.01 * rng.normal(size=(len(seen), d))))
    return world, scans


@pytest.mark.parametrize("d", [2, 3])
def test_submaps_are_tied_by_a_scan_that_shares_just_enough(d: int) -> None:
    world, scans = visits(d, d)
    mapper = mapped(scans)
    assert [len(submap.landmark_ids) for submap in mapper.submaps] == [40]
    assert aligned_rmse(mapper.map.positions[:, :d], world) < 0.5
    _, apart = visits(d - 1, d)
    assert [len(submap.landmark_ids) for submap in mapped(apart).submaps] == [20, 20]


@pytest.mark.parametrize(("seed", "every"), [(0, 2), (0, 3), (1, 5), (2, 5)])
def test_a_few_wrong_ids_do_not_tie_what_is_apart(seed: int, every: int) -> None:
    """One in every few scans: submaps were joined, 6 to 18 m off."""
    world, scans = visits(0, 2)
    rng = np.random.default_rng(seed)
    scans = [(ids.copy(), points) for ids, points in scans]
    for ids, _ in scans[1::every]:
        if len(ids):
            one, name = rng.integers(20), rng.integers(40)
            ids[one] = ids[one] if name in ids else name
    submaps = mapped(scans).submaps
    assert [len(submap.landmark_ids) for submap in submaps] == [20, 20]
    for submap in submaps:
        assert aligned_rmse(submap.positions[:, :2], world[submap.landmark_ids]) < 0.01


def test_a_landmark_that_is_noisier_than_others_is_at_rest() -> None:
    world = simulate_world(WorldSpec(kind="streets", length_m=150, iterations=150, seed=2))
    rng, log = np.random.default_rng(0), world.log
    assert log.ids is not None
    noisy = np.isin(log.ids, np.unique(log.ids)[::6])
    points = log.points_robot + noisy[:, None] * rng.normal(0, 0.3, log.points_robot.shape)
    mapper = driven(replace(log, points_robot=points))
    assert (mapper.landmarks.status == "static").mean() > 0.98
    assert len(mapper.submaps) == 1


@pytest.mark.parametrize("seed", [6, 8])
def test_what_moves_is_not_taken_for_noisy(seed: int) -> None:
    world = simulate_figure_eight(density=25, iterations=300, dynamic=0.4, seed=seed)
    table = driven(world.log).landmarks
    often = table.observations >= 30
    np.testing.assert_array_equal(table.status[often], world.status[table.landmark[often]])


def test_what_moves_is_not_mapped_where_the_map_is_still_bent() -> None:
    world = simulate_figure_eight(density=25, dynamic=0.65, seed=2)  # bent by 1.7 m before finish
    mapper = driven(world.log)
    table, static = mapper.landmarks, world.status == "static"
    assert np.mean((table.status == "static") == static[table.landmark]) > 0.97
    found = np.intersect1d(mapper.map.landmark_ids, np.flatnonzero(static))
    assert len(found) > 0.9 * static.sum()
    there = mapper.map.positions[np.isin(mapper.map.landmark_ids, found)]
    assert aligned_rmse(there, world.landmarks_map[found]) < 0.05


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_how_many_observations_contradict_their_ids_is_known(share: float) -> None:
    spec = WorldSpec(kind="corridor", length_m=150, iterations=120, wrong_ids=share)
    world = simulate_world(spec)
    mapper = driven(world.log)
    found = len(mapper.rejected_observations) + sum(one.n_outliers for one in mapper.refined)
    wrong = np.sum(world.log.ids != world.true_ids)
    assert abs(found - wrong) <= 0.2 * wrong


@pytest.mark.parametrize(("contradicting", "expected"), [(0.05, "5 %"), (0.02, ""), (None, "")])
def test_many_wrong_ids_give_a_warning(contradicting: float | None, expected: str) -> None:
    refinement = {"noise_m": 0.1, "median_range_m": 10.0, "converged": True}
    for given in (refinement, None):
        message = doubtful(given, contradicting)
        assert (expected in message) if expected else not message


@pytest.mark.parametrize("uses_odometry", [False, True])
def test_odometry_is_a_suspect_where_it_is_used(uses_odometry: bool) -> None:
    refinement = {"noise_m": 0.1, "median_range_m": 10.0, "converged": False}
    message = doubtful(refinement, 0.0, uses_odometry=uses_odometry)
    assert "converge" in message
    assert ("odometry" in message) == uses_odometry


@pytest.mark.parametrize(("contradicting", "expected"), [(0.03, "3.0 %"), (0.01, ""), (None, "")])
def test_a_map_without_ids_that_many_observations_contradict_gives_a_warning(
    contradicting: float | None, expected: str
) -> None:
    message = doubtful(None, contradicting, has_ids=False)
    assert (expected in message) if expected else not message


@pytest.mark.parametrize(
    ("rows", "scans", "expected"),
    [
        (0, 0, ""),
        (1, 0, "; overruled ids: of 1 observation"),
        (102, 2, "; overruled ids: of 102 observations, of all in 2 scans"),
        (0, 1, "; overruled ids: of all in 1 scan"),
    ],
)
def test_overruled_ids_are_said(rows: int, scans: int, expected: str) -> None:
    counts = {"rejected_observations": {"count": rows}, "rejected_iterations": {"count": scans}}
    assert overruled({"association": "known", **counts}) == expected
    assert overruled({"association": "nearest", **counts}) == ""


@pytest.mark.parametrize("seed", [1, 14, 59])
def test_two_halls_joined_by_two_landmarks_side_by_side_are_straight(seed: int) -> None:
    rng, mapper = np.random.default_rng(seed), PointMapper()
    halls = [np.column_stack([rng.uniform(x, x + 20, 40), rng.uniform(-8, 8, 40)]) for x in (0, 80)]
    along = [22, 26, 30, 33.2, 36, 45.82, 45.93, 58.4, 58.9, 62, 66, 70, 74, 78]
    across = [1.5, -1.5, 1.5, -1.4, 1.4, 1.52, 1.41, 1.57, -1.53, -1.5, 1.5, -1.5, 1.5, -1.5]
    true = np.concatenate([*halls, np.column_stack([along, across])])
    for at in [*np.arange(5, 95, 0.5), *np.arange(95, 5, -0.5)]:
        away = true - [at, 0.0]
        own = np.flatnonzero((np.linalg.norm(away, axis=1) < 12) & (rng.random(len(away)) > 0.05))
        mapper.update(away[own] + 0.05 * rng.normal(size=(len(own), 2)), ids=own)
    mapper.finish()
    mapper.refine()
    assert len(mapper.map) == len(true)
    assert aligned_rmse(mapper.map.positions[:, :2], true[mapper.map.landmark_ids]) < 0.15


def test_labels_are_the_ids_given_small_or_large() -> None:
    scans = list(simulate_figure_eight(density=40, iterations=30).log.scans())
    mapper, rng = PointMapper(), np.random.default_rng(0)
    for scan in scans:
        ids = np.where(scan.ids % 3 == 0, scan.ids + 2**40, scan.ids)
        ids[::7] = -1
        order = rng.permutation(len(ids))
        labels = mapper.update(scan.points_robot[order], ids[order])
        np.testing.assert_array_equal(labels, ids[order])


def test_of_two_detections_at_one_place_one_is_the_landmark_expected_there() -> None:
    world, mapper = np.random.default_rng(5).uniform(-8.0, 8.0, (12, 2)), PointMapper()
    for k in range(10):
        mapper.update(world - [0.1 * k, 0.0], ids=np.arange(12))
    row, ids = np.array([0, 3, 3, *range(4, 12)]), np.array([0, 30, 31, *range(4, 12)])
    points = world[row] - [1.0, 0.0]
    points[0] += 5.0  # After an observation far from its landmark new ids are doubtful.
    labels = mapper.update(points, ids=ids)
    assert labels.tolist() == [-1, 3, 31, *range(4, 12)]


def test_no_scan_is_taken_up_where_ids_connect_the_logs() -> None:
    world, mapper = np.random.default_rng(5).uniform(-8.0, 8.0, (12, 2)), PointMapper()
    for k in range(10):
        mapper.update(world - [0.1 * k, 0.0], ids=np.arange(12))
    mapper.finish()
    assert not mapper.take_up(world)  # Its landmarks may have other ids.


def clusters(seed: int, share: float) -> tuple[Array, Scans]:
    """Return clusters of stems, and scans on a round: few clusters are in view at some places."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform((0, 0), (140, 90), (70, 2))
    stems = np.concatenate([centre + rng.normal(0, 0.5, (4, 2)) for centre in centres])
    corners = np.array([(15, 15), (125, 15), (125, 75), (15, 75), (15, 15)])
    scans = []
    for at in np.arange(200) / 199 * 4:
        side = min(int(at), 3)
        step = corners[side + 1] - corners[side]
        ahead = step / np.linalg.norm(step)
        seen = stems - corners[side] - (at - side) * step
        seen = seen @ np.column_stack([ahead, [-ahead[1], ahead[0]]])
        in_view = (np.linalg.norm(seen, axis=1) < 25) & (seen[:, 0] > 0)
        ids = np.flatnonzero(in_view & (rng.random(len(stems)) > 0.15))
        points = seen[ids] + rng.normal(0, 0.1, (len(ids), 2))
        wrong = rng.random(len(ids)) < share
        ids = np.where(wrong, rng.integers(0, len(stems), len(ids)), ids)
        first = np.unique(ids, return_index=True)[1]
        scans.append((ids[first], points[first]))
    return stems, scans


def test_wrong_ids_far_away_do_not_turn_what_few_landmarks_connect() -> None:
    """The map was twice as far off as with right ids, and in two submaps."""
    errors = []
    for share in (0.0, 0.05):
        stems, scans = clusters(2, share)
        mapper = mapped(scans)
        assert len(mapper.submaps) == 1
        found = mapper.map
        errors.append(aligned_rmse(found.positions[:, :2], stems[found.landmark_ids]))
    assert errors[1] < 1.3 * errors[0]
