"""Merges that a refined map contradicts are undone; right ones are found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap import MapperConfig, PointMapper
from relmap.core.arrays import Ints
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.association.reobservation.undoing import merged_across
from relmap.core.map.leaps import gaps_of, may_have_gaps
from relmap.core.map.pose import known_poses
from relmap.core.state.schedule import GroupingSchedule
from relmap.core.state.table import NONE, LandmarkState
from relmap.io.state import StateReader, StateWriter
from relmap.simulation import World, WorldSpec, simulate_figure_eight, simulate_world
from tests.worlds import aligned_rmse, purity_of, stands_for, without_ids


def mapped_world(world: World) -> tuple[PointMapper, Ints]:
    """Return a refined map made without ids, and the label of every observation."""
    mapper, labels = without_ids(world.log)
    mapper.refine()
    return mapper, labels


def error_m(mapper: PointMapper, labels: Ints, world: World) -> float:
    """Return the landmark RMSE of the largest submap."""
    now = mapper.landmarks_of(labels)
    ids = stands_for(now, world.true_ids)
    rows = [k for k, label in enumerate(mapper.map.landmark_ids) if label in ids]
    true = [ids[mapper.map.landmark_ids[k]] for k in rows]
    return aligned_rmse(mapper.map.positions[rows], world.landmarks_map[true])


def test_a_track_that_is_parted_is_as_if_it_had_never_been_merged() -> None:
    table = LandmarkState()
    for iteration, label in enumerate([0, 0, 1, 1, 1, 2, 2]):
        table.enter(np.array([label]), np.zeros((1, 2)), iteration)
        GroupingSchedule(table, MapperConfig()).see(np.array([label]), iteration)
    columns = ["landmark_of", "first", "last", "since", "observations"]
    before = {name: getattr(table, name).copy() for name in columns}
    table.merge(np.array([1]), np.array([0]))
    table.merge(np.array([2]), np.array([0]))
    assert (table.first[0], table.since[0], table.last[0], table.observations[0]) == (0, 5, 6, 7)
    table.part(1)
    assert table.landmark_of.tolist() == [0, 1, 0]
    assert (table.first[0], table.last[0], table.observations[0]) == (0, 6, 4)
    table.part(2)
    for name in columns:
        np.testing.assert_array_equal(getattr(table, name), before[name])


def test_the_tracks_of_a_landmark_are_in_the_same_order_once_it_was_saved() -> None:
    table, restored = LandmarkState(), LandmarkState()
    for iteration in range(3):
        table.enter(np.array([iteration]), np.zeros((1, 2)), iteration)
    for track in (2, 1):
        table.merge(np.array([track]), np.array([0]))
    writer = StateWriter()
    writer.add(table)
    StateReader(writer.columns).restore(restored)
    assert restored.members(0) == table.members(0)


def test_wrong_merges_are_undone_and_right_ones_are_not() -> None:
    world = simulate_figure_eight(density=25, iterations=900, seed=1)
    mapper, labels = without_ids(world.log)
    right = mapper.landmarks_of(labels)
    assert purity_of(right, world.log.ids) == 1
    table = mapper.engine.table
    mapped = np.flatnonzero(table.weight > 0)
    apart = np.linalg.norm(table.position[mapped, None] - table.position[mapped], axis=2)
    true = stands_for(right, world.log.ids)
    for k in np.argsort(apart, axis=None).tolist():  # the nearest two that were never seen at once
        new, old = mapped[list(divmod(k, len(mapped)))].tolist()
        if table.is_later(new, old) and true[new] != true[old]:
            break
    mapper.engine.merge_pairs(np.array([[new, old]]))
    assert purity_of(mapper.landmarks_of(labels), world.log.ids) != 1
    mapper.refine()
    assert purity_of(mapper.landmarks_of(labels), world.log.ids) == 1
    assert len(mapper.map.landmark_ids) == len(world.landmark_ids)
    assert len(mapper.submaps) == 1


def test_a_map_that_wrong_merges_bend_is_repaired() -> None:
    """Two stretches are joined by one merge: unless it is undone, three landmarks are double."""
    world = simulate_world(WorldSpec(noise="range", seed=1))
    part = world.log.between(0, 250)
    world = replace(world, log=part, true_ids=world.true_ids[: len(part.points_robot)])
    mapper, labels = mapped_world(world)
    ids = stands_for(mapper.landmarks_of(labels), world.true_ids)
    shown = [ids[label] for label in mapper.map.landmark_ids.tolist()]
    assert len(mapper.submaps) == 1
    assert len(shown) == len(set(shown))
    assert error_m(mapper, labels, world) < 0.2


def test_merges_across_a_break_that_hold_its_sides_apart_are_undone() -> None:
    """Two breaks show one corner; merged while the map had drifted, it was 1.0 m off there."""
    world = simulate_world(WorldSpec(noise="bearing", seed=12))
    mapper, labels = mapped_world(world)
    assert len(mapper.submaps) == 1
    assert error_m(mapper, labels, world) < 0.2


def test_merges_across_a_blind_stretch_that_a_slow_robot_crosses_faster_are_kept() -> None:
    """It moves by less than the distance of two landmarks more than usual."""
    rng = np.random.default_rng(0)
    landmarks = rng.uniform(-9, 9, (30, 2))
    speed_m = np.repeat([0.02, 0.06, 0.02], [60, 30, 60])
    mapper = PointMapper()
    for x, is_blind in zip(np.cumsum(speed_m) - 2, speed_m > 0.05, strict=True):
        seen = landmarks - [x, 0] + rng.normal(0, 0.01, landmarks.shape)
        mapper.update(seen[:0] if is_blind else seen)
    mapper.finish()
    mapper.refine()
    assert mapper.n_undone == 0
    assert len(mapper.map.landmark_ids) == len(landmarks)
    # That distance is the one within a scan: in the map, landmarks may be mapped twice.
    table, rows, [refined] = mapper.engine.table, mapper.engine.rows, mapper.engine.refined
    merged = np.setdiff1d(np.arange(len(table)), refined.landmarks)
    assert len(merged) >= len(landmarks)
    places = refined.positions + 1e-3
    doubled = replace(
        refined,
        landmarks=np.append(refined.landmarks, merged[: len(places)]),
        positions=np.concatenate([refined.positions, places]),
    )
    assert len(merged_across(doubled, table, rows)) == 0


def test_tracks_of_several_landmarks_are_not_repaired() -> None:
    world = simulate_figure_eight(density=100, iterations=900, seed=1)
    mapper = PointMapper(MapperConfig(registration="nearest-previous"))
    labels = np.concatenate([mapper.update(scan.points_robot) for scan in world.log.scans()])
    assert purity_of(labels, world.log.ids) < 0.999
    mapper.finish()
    mapper.refine()
    assert mapper.n_undone == 0


def test_rows_keep_the_number_under_which_a_landmark_was_seen() -> None:
    world = simulate_world(WorldSpec(length_m=200.0, iterations=140, seed=1))
    mapper, labels = mapped_world(world)
    table, rows = mapper.engine.table, mapper.engine.rows
    assert (np.isin(rows.landmark, labels)).all()
    sightings = Sightings(rows, table)
    scans = {k: set(world.log.iteration[labels == k]) for k in np.unique(labels).tolist()}
    own = np.flatnonzero(table.weight > 0)[:40].tolist()
    for one in own:
        for other in own:
            met = set.union(*(scans[k] for k in table.members(one))) & set.union(
                *(scans[k] for k in table.members(other))
            )
            assert met or not sightings.together(one, other)


def test_a_merge_of_landmarks_seen_together_is_undone_without_a_trace() -> None:
    """By the time alone, the observations of one would be taken for those of the other."""
    world = simulate_world(WorldSpec(length_m=200.0, iterations=140, seed=1))
    mapper, _ = without_ids(world.log)
    engine = mapper.engine
    table, before = engine.table, engine.rows.landmark.copy()
    times = np.bincount(before, minlength=len(table))
    old, new = sorted(np.argsort(-times, kind="stable")[:2].tolist())
    engine.merge_pairs(np.array([[new, old]]))
    assert table.landmark_of[new] == old
    table.part(new)
    np.testing.assert_array_equal(engine.rows.landmark, before)


def test_landmarks_that_were_mapped_twice_are_one() -> None:
    """Matches that fail begin tracks of what is mapped: without the repair seven are double."""
    world = simulate_world(
        WorldSpec(missed=0.3, spurious=0.1, length_m=300.0, iterations=200, seed=7)
    )
    mapper, labels = mapped_world(world)
    assert len(mapper.submaps) == 1
    assert error_m(mapper, labels, world) <= 0.05
    often = np.bincount(world.true_ids[world.true_ids >= 0]) >= 10
    id_of = stands_for(mapper.landmarks_of(labels), world.true_ids)
    mapped = [id_of[label] for label in mapper.map.landmark_ids.tolist()]
    assert len(mapped) == len(set(mapped))
    assert len({*mapped} & {*np.flatnonzero(often).tolist()}) >= 0.97 * often.sum()


def test_a_landmark_that_few_scans_of_its_neighbours_show_is_seldom() -> None:
    """Wrong matches make a second landmark beside one, however often: here ten times."""
    rng = np.random.default_rng(3)
    places = np.vstack([rng.uniform(-8, 8, (20, 2)), [[0.0, 0.0], [0.1, 0.0]]])
    mapper = PointMapper()
    for k in range(60):
        ids = np.arange(22 if k % 6 == 0 else 21)
        mapper.update(places[ids] + rng.normal(0, 0.02, (len(ids), 2)), ids)
    mapper.finish()
    engine = mapper.engine
    assert 21 in mapper.map.landmark_ids
    seldom = Sightings(engine.rows, engine.table).seldom(np.zeros(22, dtype=bool))
    assert np.flatnonzero(seldom).tolist() == [21]


def test_finishing_a_refined_map_again_leaves_it() -> None:
    mapper, _ = mapped_world(simulate_world(WorldSpec(kind="ring", length_m=250.0, iterations=180)))
    before = mapper.map.positions
    mapper.finish()
    np.testing.assert_allclose(mapper.map.positions, before, atol=1e-9)


def test_observations_kept_once_odometry_begins_have_the_number_before_a_merge() -> None:
    points = np.random.default_rng(0).uniform(-10, 10, (20, 2))
    mapper, ids = PointMapper(), np.arange(20)
    for _ in range(6):
        mapper.update(points, ids)
    mapper.engine.merge_pairs(np.array([[7, 3]]))
    mapper.update(points, ids, odometry=np.eye(4))
    assert np.bincount(mapper.engine.kept.landmark).tolist() == [7] * 20


def test_a_run_goes_on_after_a_merge_is_undone_that_a_group_had_replaced() -> None:
    world = simulate_figure_eight(iterations=190, seed=1)
    mapper, scans = PointMapper(), [scan.points_robot for scan in world.log.scans()]
    for points in scans[:150]:
        mapper.update(points)
    engine, table = mapper.engine, mapper.engine.table
    in_view = engine.schedule.in_view
    new = int(in_view[(table.group[in_view] != NONE) & (table.weight[in_view] > 0)][-1])
    older = [k for k in np.flatnonzero(table.weight > 0).tolist() if table.is_later(new, k)]
    engine.merge_pairs(np.array([[new, older[-1]]]))
    for points in scans[150:165]:
        mapper.update(points)
    mapper.refine()
    assert table.landmark_of[new] == new
    for points in scans[165:]:
        mapper.update(points)
    assert table.last[new] == mapper.n_iterations - 1
    assert new in engine.schedule.in_view
    mapper.finish()
    assert new in mapper.map.landmark_ids


@pytest.mark.parametrize(("missed", "expected"), [((), False), (range(100, 116), True)])
def test_gaps_are_looked_for_where_there_may_be_some(
    missed: tuple[int, ...] | range, expected: bool
) -> None:
    mapper = PointMapper()
    for k, scan in enumerate(simulate_figure_eight(density=25, iterations=200).log.scans()):
        seen = slice(0 if k in missed else None)
        mapper.update(scan.points_robot[seen], scan.ids[seen])
    mapper.refine()
    table, rows = mapper.engine.table, mapper.engine.rows
    positions = np.where(table.weight[:, None] > 0, table.position, np.nan)
    known, poses = known_poses(rows, positions, table.landmark_of)
    found = gaps_of(rows, positions, table.landmark_of, known, poses[:, :3, 3])
    assert may_have_gaps(rows, positions, table.landmark_of) == expected == (len(found.before) > 0)


@pytest.mark.parametrize("d", [2, 3])
def test_pieces_of_a_submap_that_nothing_connects_are_cut_apart(d: int) -> None:
    rng, mapper = np.random.default_rng(3), PointMapper()
    for n in (25, 14):
        places = rng.uniform(-15, 15, (n, d))
        for k in range(40):
            mapper.update(places + [0.1 * k] * d + rng.normal(0, 0.02, places.shape))
    mapper.finish()
    table = mapper.engine.table
    table.submap[table.submap != NONE] = table.submaps[0]
    assert [len(submap.landmark_ids) for submap in mapper.submaps] == [39]
    mapper.refine()
    assert [len(submap.landmark_ids) for submap in mapper.submaps] == [25, 14]


@pytest.mark.parametrize(
    ("kind", "spurious", "seed", "mapped"), [("streets", 0.1, 51, 99), ("corridor", 0.2, 61, 116)]
)
def test_landmarks_that_coincide_after_their_merge_was_undone_are_one(
    kind: str, spurious: float, seed: int, mapped: int
) -> None:
    """Three of 99 and seven of 116 landmarks were mapped twice."""
    spec = WorldSpec(kind=kind, length_m=250.0, iterations=200, missed=0.3, spurious=spurious)
    world = simulate_world(replace(spec, seed=seed))
    mapper, labels = mapped_world(world)
    true = stands_for(mapper.landmarks_of(labels), world.true_ids)
    found = {true[label] for label in mapper.map.landmark_ids.tolist()}
    assert len(mapper.map.landmark_ids) == len(found) == mapped
