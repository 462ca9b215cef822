from __future__ import annotations

import pickle
from collections.abc import Generator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relmap import PointMapper
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.core.linalg.cholesky import level_flops
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement import joint_kernels as joint
from relmap.core.refinement import live, slices
from relmap.core.refinement.condensing import CondensedSegments
from relmap.core.state.table import LandmarkState
from relmap.simulation import FigureEight, simulate_figure_eight
from tests.worlds import aligned_rmse, mapped, walk


def driven(world: FigureEight, end: int) -> PointMapper:
    mapper = PointMapper()
    for scan in world.log.between(0, end).scans():
        mapper.update(scan.points_robot, scan.ids)
    return mapper


def live_error(mapper: PointMapper, world: FigureEight) -> float:
    found = mapper.map
    return aligned_rmse(found.positions, world.landmarks_map[found.landmark_ids])


def test_a_closed_loop_is_spread_over_the_live_map(monkeypatch: pytest.MonkeyPatch) -> None:
    spread, limits = [], []
    worlds = [simulate_figure_eight(seed=seed) for seed in (30, 31, 32)]
    for world in worlds:
        spread.append(live_error(driven(world, 900), world))
        assert world.log.ids is not None
        batch = Batch(world.log.points_robot, world.log.iteration, world.log.ids)
        limits.append(
            aligned_rmse(batch_least_squares(batch, world.landmarks_map), world.landmarks_map)
        )
    monkeypatch.setattr(live.LiveRefinement, "advance", lambda *_: False)
    chained = [live_error(driven(world, 900), world) for world in worlds]
    assert np.median(spread) < 0.6 * np.median(chained)
    assert np.median(spread) < 1.3 * np.median(limits)


def test_finishing_spreads_what_has_drifted_since_the_last_step() -> None:
    ratios = []
    for seed in range(200, 208):
        world = simulate_figure_eight(seed=seed)
        mapper = driven(world, 900)
        mapper.finish()
        finished = live_error(mapper, world)
        mapper.refine()
        ratios.append(finished / live_error(mapper, world))
    assert np.median(ratios) < 1.1
    assert max(ratios) < 1.5


def test_what_a_level_costs_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    levels: list[float] = []
    found = slices.StepInSlices._levels

    def noted(
        self: slices.StepInSlices, *graph: NDArray[np.int64]
    ) -> Generator[None, None, NDArray[np.int64]]:
        of = yield from found(self, *graph)
        levels.append(level_flops(of, 6).max())
        return of

    monkeypatch.setattr(slices.StepInSlices, "_levels", noted)
    driven(simulate_figure_eight(density=100, iterations=1800, seed=3), 1800)
    assert len(levels) >= 3
    assert max(levels) <= slices.MOST_FLOPS


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


def test_a_mapper_in_the_middle_of_a_step_can_be_stored() -> None:
    world = simulate_figure_eight(seed=2)
    mapper = PointMapper()
    for scan in world.log.scans():
        mapper.update(scan.points_robot, scan.ids)
        if mapper._engine.live._step is not None:
            break
    assert mapper._engine.live._step is not None
    again: PointMapper = pickle.loads(pickle.dumps(mapper))
    np.testing.assert_array_equal(again.map.positions, mapper.map.positions)
    mapper.refine()
    again = pickle.loads(pickle.dumps(mapper))
    np.testing.assert_array_equal(again.map.covariances, mapper.map.covariances)


def step(
    placed: NDArray[np.float64], landmark: NDArray[np.int64], placement: NDArray[np.int64]
) -> slices.StepInSlices:
    size = len(landmark), int(landmark.max()) + 1, int(placement.max()) + 1
    found = slices.StepInSlices(*size, placed.shape[1])
    for k in range(size[2]):
        of = placement == k
        found.add(placed[of], landmark[of], placement[of], np.ones(of.sum()))
    for _ in found.run():
        pass
    return found


def test_a_step_brings_displaced_bodies_together() -> None:
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (40, 2))
    landmark = np.concatenate([np.arange(10 * k, 10 * k + 20) % 40 for k in range(4)])
    placement = np.repeat(np.arange(4), 20)
    shift = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, -0.2], [0.1, 0.1]])
    placed = world[landmark] + shift[placement]
    found = step(placed, landmark, placement)
    means = np.stack([placed[landmark == i].mean(axis=0) for i in found.members])
    np.testing.assert_allclose(means + found.moves, world[found.members], atol=1e-6)


def test_bodies_that_share_nothing_are_each_brought_together() -> None:
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (40, 2))
    landmark = np.tile(np.arange(20), 2)
    landmark = np.concatenate([landmark, landmark + 20])
    placement = np.repeat(np.arange(4), 20)
    shift = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.0], [0.0, -0.2]])
    placed = world[landmark] + shift[placement]
    found = step(placed, landmark, placement)
    means = np.stack([placed[landmark == i].mean(axis=0) for i in found.members])
    assert aligned_rmse((means + found.moves)[:20], world[:20]) < 1e-6
    assert aligned_rmse((means + found.moves)[20:], world[20:]) < 1e-6


def test_bodies_are_joined_where_a_step_would_cost_too_much(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(slices, "MOST_FLOPS", 2000.0)
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (40, 2))
    landmark = np.concatenate([np.arange(10 * k, 10 * k + 20) % 40 for k in range(4)])
    found = step(world[landmark], landmark, np.repeat(np.arange(4), 20))
    np.testing.assert_allclose(found.moves, 0.0, atol=1e-9)


def test_of_a_long_run_neighbouring_placements_are_one_body(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(slices, "BODIES", 4)
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (40, 2))
    landmark = np.concatenate([np.arange(5 * k, 5 * k + 20) % 40 for k in range(8)])
    placement = np.repeat(np.arange(8), 20)
    shift = np.repeat([[0.0, 0.0], [0.1, 0.0], [0.0, -0.2], [0.1, 0.1]], 2, axis=0)
    placed = world[landmark] + shift[placement]
    found = step(placed, landmark, placement)
    assert len(found._bodies) == 4
    means = np.stack([placed[landmark == i].mean(axis=0) for i in found.members])
    np.testing.assert_allclose(means + found.moves, world[found.members], atol=1e-6)


def test_slices_do_not_grow_with_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    rows: list[int] = []
    equations = joint.placement_equations

    def noted(begin: NDArray[np.int64], *rest: Any) -> None:
        rows.append(int(begin[-1] - begin[0]))
        equations(begin, *rest)

    monkeypatch.setattr(joint, "placement_equations", noted)
    world = simulate_figure_eight(density=100, iterations=2500, seed=3)
    mapper = driven(world, 2500)
    seen = np.bincount(mapper._engine.rows.landmark).max()
    assert len(rows) > 50
    assert max(rows) <= slices.SLICE + seen


def test_what_merges_into_one_first_seen_later_takes_no_part_in_the_step_under_way() -> None:
    mapper = driven(simulate_figure_eight(seed=3), 300)
    engine = mapper._engine
    refinement, table = engine.live, engine.table
    refinement._back = live.BACK + 1
    refinement._step = step = refinement._begin()
    assert step is not None
    n = step.step.n_landmarks
    table.resize(n + 1, engine.store.n_iterations, 3)
    engine.map.place(step.submap, np.array([n]), np.array([[1.0, 2.0, 3.0]]), np.array([10.0]))
    merged = int(engine.segments.rows.landmark[0])
    table.landmark_of[merged] = n
    while not step.go_on(engine.segments, table):
        pass
    assert len(step.step.members) > 50
    assert not np.isin([merged, n], step.step.members).any()


def test_a_step_that_leaves_the_neighbourhood_it_holds_in_is_not_taken() -> None:
    """Wrong matches make such steps; a sound one moves what was mapped since along."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 10, (12, 2))
    table, members = LandmarkState(), np.arange(10)
    table.resize(12, 0, 2)
    global_map = GlobalMap(table)
    submap = global_map.new_submap()
    global_map.place(submap, np.arange(12), places.copy(), np.ones(12))
    refinement = live.LiveRefinement(CondensedSegments(), global_map)
    moves = np.zeros((10, 2))
    for size, shift in ((2.0, 0.0), (0.5, 1.0)):
        moves[3, 0] = size
        latest = np.eye(2), np.array([0.0, shift]), np.zeros(2)
        step: Any = SimpleNamespace(members=members, moves=moves, latest=latest)
        refinement._apply(live.StepUnderWay(submap, 0, 0, step))
        moved = table.position - places
        np.testing.assert_allclose(moved[:10], shift * moves, atol=1e-12)
        np.testing.assert_allclose(moved[10:], [[0.0, shift]] * 2, atol=1e-12)
