from __future__ import annotations

import pickle

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import sums_each
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement import live
from relmap.core.refinement.condensing import CondensedSegments
from relmap.core.refinement.live import after_step
from relmap.core.refinement.live_kernels import moments_between
from relmap.core.state.table import LandmarkState
from relmap.evaluation.metrics import majority_ids
from relmap.simulation import FigureEight, WorldSpec, simulate_figure_eight, simulate_world
from tests.worlds import aligned_rmse, fed, limit_of, mapped, random_rotation, seen, walk


def driven(world: FigureEight, end: int) -> PointMapper:
    return fed(PointMapper(), seen(world.log.between(0, end)))


def live_error(mapper: PointMapper, world: FigureEight) -> float:
    found = mapper.map
    return aligned_rmse(found.positions, world.landmarks_map[found.landmark_ids])


def test_a_closed_loop_is_spread_over_the_live_map(monkeypatch: pytest.MonkeyPatch) -> None:
    spread, limits = [], []
    worlds = [simulate_figure_eight(seed=seed) for seed in (30, 31, 32)]
    for world in worlds:
        spread.append(live_error(driven(world, 900), world))
        limits.append(limit_of(world.log, world.landmarks_map))
    monkeypatch.setattr(live.LiveRefinement, "advance", lambda *_: False)
    chained = [live_error(driven(world, 900), world) for world in worlds]
    assert np.median(spread) < 0.6 * np.median(chained)
    assert np.median(spread) < 1.3 * np.median(limits)


def test_finishing_spreads_what_has_drifted_since_the_last_step() -> None:
    ratios = []
    for seed in range(200, 202):
        world = simulate_figure_eight(seed=seed)
        mapper = driven(world, 900)
        mapper.finish()
        finished = live_error(mapper, world)
        mapper.refine()
        ratios.append(finished / live_error(mapper, world))
    assert np.median(ratios) < 1.1
    assert max(ratios) < 1.5


def test_finishing_spreads_the_drift_that_late_loops_reveal() -> None:
    world, mapper, errors = simulate_world(WorldSpec(space=True, seed=1)), PointMapper(), []
    labels = [mapper.update(scan.points_robot) for scan in world.log.scans()]
    for end in (mapper.finish, mapper.refine):
        end()
        now = mapper.landmarks_of(np.concatenate(labels))
        true_of = dict(zip(*majority_ids(now, world.true_ids)[:2], strict=True))
        there = world.landmarks_map[[true_of[one] for one in mapper.map.landmark_ids.tolist()]]
        errors.append(aligned_rmse(mapper.map.positions, there))
    assert errors[0] < 5 * errors[1]


def test_a_step_costs_no_more_in_a_long_run(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies: list[int] = []

    def noted(points: Floats, weight: Floats, landmark: Ints, body: Ints) -> Floats:
        bodies.append(int(body[-1]) + 1)
        return after_step(points, weight, landmark, body)

    monkeypatch.setattr(live, "after_step", noted)
    driven(simulate_figure_eight(density=12, iterations=3000, seed=3), 3000)
    assert len(bodies) >= 3
    assert max(bodies) <= live.BODIES


@pytest.mark.parametrize("d", [2, 3])
def test_live_refinement_is_exact_without_noise(d: int) -> None:
    world = walk(d, 4, iterations=400)
    mapper = mapped(world.scans)
    found = mapper.map
    np.testing.assert_allclose(
        found.positions[:, :d], world.landmarks[found.landmark_ids], atol=1e-9
    )


@pytest.mark.parametrize(("density", "seed"), [(6, 11), (3, 4), (4, 1)])
def test_a_sparse_world_is_mapped(density: int, seed: int) -> None:
    """Where little is seen, parts of one submap of the map share no segment."""
    world = simulate_figure_eight(density=density, seed=seed)
    mapper = driven(world, 900)
    mapper.finish()
    mapper.refine()
    assert np.isfinite(mapper.map.positions).all()


def test_a_mapper_can_be_stored_at_any_time() -> None:
    world = simulate_figure_eight(seed=2)
    mapper = driven(world, 600)
    again: PointMapper = pickle.loads(pickle.dumps(mapper))
    for scan in world.log.between(600, 900).scans():
        for each in (mapper, again):
            each.update(scan.points_robot, scan.ids)
    np.testing.assert_array_equal(again.map.positions, mapper.map.positions)
    mapper.refine()
    again = pickle.loads(pickle.dumps(mapper))
    np.testing.assert_array_equal(again.map.covariances, mapper.map.covariances)


def stepped(points: Floats, landmark: Ints, body: Ints) -> Floats:
    placed = after_step(points, np.ones(len(points)), landmark, body)
    return sums_each(placed, landmark, int(landmark.max()) + 1) / np.bincount(landmark)[:, None]


def test_a_step_brings_displaced_bodies_together() -> None:
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (40, 2))
    landmark = np.concatenate([np.arange(10 * k, 10 * k + 20) % 40 for k in range(4)])
    body = np.repeat(np.arange(4), 20)
    shift = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, -0.2], [0.1, 0.1]])
    found = stepped(world[landmark] + shift[body], landmark, body)
    np.testing.assert_allclose(found, world, atol=1e-6)


def test_bodies_that_share_nothing_are_each_brought_together() -> None:
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (40, 2))
    landmark = np.tile(np.arange(20), 2)
    landmark = np.concatenate([landmark, landmark + 20])
    body = np.repeat(np.arange(4), 20)
    shift = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.0], [0.0, -0.2]])
    found = stepped(world[landmark] + shift[body], landmark, body)
    assert aligned_rmse(found[:20], world[:20]) < 1e-6
    assert aligned_rmse(found[20:], world[20:]) < 1e-6


def test_moments_of_bodies_are_those_of_a_dense_elimination() -> None:
    rng, n, b, m = np.random.default_rng(1), 300, 5, 50
    body, columns, weight = np.sort(rng.integers(0, b, n)), rng.normal(size=(n, 4)), rng.random(n)
    landmark = np.append(np.arange(m), rng.integers(0, m, n - m))  # some twice in a body
    total = np.bincount(landmark, weights=weight)
    begin = np.append(0, np.cumsum(np.bincount(landmark, minlength=m)))
    order = np.argsort(landmark, kind="stable")
    found = moments_between(columns, weight, body, begin, order, b)
    of = np.zeros((n, m))
    of[np.arange(n), landmark] = weight
    reduced = np.diag(weight) - of / total @ of.T
    for k, k_rows in enumerate(body == k for k in range(b)):
        for j, j_rows in enumerate(body == j for j in range(b)):
            dense = columns[k_rows].T @ reduced[np.ix_(k_rows, j_rows)] @ columns[j_rows]
            np.testing.assert_allclose(found[k, j], dense, atol=1e-12)


def test_stretches_that_share_enough_are_aligned() -> None:
    rng = np.random.default_rng(0)
    world, R = rng.uniform(-5, 5, (12, 3)), random_rotation(3, 0.5, rng)
    one = live.Body(np.arange(8), world[:8], np.full(8, 2.0))
    landmark = np.append(np.arange(4, 12), 5)
    other = live.Body(landmark, (world[landmark] + 3.0) @ R, np.ones(9))
    together = live.merged(one, other)
    np.testing.assert_array_equal(together.landmark, np.arange(12))
    np.testing.assert_allclose(together.points, world, atol=1e-9)
    np.testing.assert_array_equal(together.weight, [2, 2, 2, 2, 3, 4, 3, 3, 1, 1, 1, 1])
    few = live.Body(np.arange(7, 12), world[7:] @ R, np.ones(5))
    assert live.merged(one, few) is None


@pytest.mark.parametrize(("apart", "moved"), [(5.0, 0.0), (0.5, 1.0)])
def test_a_step_that_leaves_the_neighbourhood_it_holds_in_is_not_taken(
    apart: float, moved: float
) -> None:
    """Wrong matches make such steps; a sound one moves what was mapped since along."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 10, (12, 2))
    table, members = LandmarkState(), np.arange(10)
    table.resize(12, 0, 2)
    global_map = GlobalMap(table)
    submap = global_map.new_submap()
    global_map.place(submap, np.arange(12), places.copy(), np.ones(12))
    body, shift = np.repeat(np.arange(2), 10), np.array([apart, 0.0])
    points = np.concatenate([places[:10], places[:10] + shift])
    refinement = live.LiveRefinement(CondensedSegments(), global_map)
    refinement.move(submap, members, points, np.ones(20), np.tile(members, 2), body)
    moves = table.position - places
    np.testing.assert_allclose(moves[:10], np.tile(-moved * shift / 2, (10, 1)), atol=1e-6)
    np.testing.assert_allclose(moves[10:], np.tile(-moved * shift, (2, 1)), atol=1e-6)
