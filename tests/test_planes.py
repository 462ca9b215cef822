"""The plane mapper in simulated worlds: association, positions, and moving walls."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from relmap import PlaneMapper, PlaneSegmenter, RelmapError
from relmap.core.arrays import Floats
from relmap.core.geometry.alignment import fit_rigid
from relmap.evaluation.sources import truth_of
from relmap.evaluation.walls import match_corners
from relmap.simulation import Building, simulate_building
from relmap.simulation.visibility import seen_walls
from tests.worlds import ate_m, fed, finished, turn

ROOM = np.array(
    [
        [[4.0, -3.0], [4.0, 3.0]],
        [[4.0, 3.0], [-2.0, 3.0]],
        [[-2.0, -3.0], [4.0, -3.0]],
        [[2.0, -1.0], [2.5, 0.5]],
    ]
)
"""Three sides of a room and a panel in it; right to left as seen from inside."""


def mapped(building: Building) -> PlaneMapper:
    """Map the true visible parts of the walls."""
    return finished(PlaneMapper(), (scan.seen for scan in building.scans))


def figures(mapper: PlaneMapper, building: Building) -> tuple[float, float, int]:
    """Return the largest error of a corner, the share of due ones mapped, and the false ones."""
    poses, truth = mapper.trajectory, truth_of(building)
    there = np.isfinite(poses[:, 0, 0])
    matched = match_corners(mapper.planes, truth, poses[there], building.trajectory[there])
    off = matched.position @ matched.R.T + matched.t - matched.truth
    due = np.flatnonzero(truth.corner_scans.ravel() >= 10)
    found = np.isin(due, 2 * matched.wall + matched.end)
    return float(np.abs(off).max()), float(found.mean()), matched.n_false


def seen_from(
    x: float,
    y: float,
    yaw: float,
    walls: Floats = ROOM,
    half_view: float = 1.2,
    range_m: float = 8.0,
) -> Any:
    """Return the visible parts of walls."""
    return seen_walls((walls - [x, y]) @ turn(yaw), range_m, half_view)


@pytest.mark.parametrize(("world", "seed"), [("building", 0), ("panels", 1)])
def test_without_noise_the_map_is_exact(world: Any, seed: int) -> None:
    building = simulate_building(points=10, sigma=0.0, seed=seed, world=world)
    mapper = mapped(building)
    error_m, coverage, n_false = figures(mapper, building)
    assert error_m <= 1e-9
    assert coverage >= 0.9
    assert n_false == 0
    mapper.refine()
    error_m, coverage, n_false = figures(mapper, building)
    assert error_m <= 1e-9
    assert coverage >= 0.9
    assert n_false == 0


def test_pure_translation_is_exact() -> None:
    """Two ends cut by the view move together and tie with the static ones (Fig. 4)."""
    mapper = PlaneMapper()
    path = np.linspace(-1.5, 0.5, 21)
    for x in path:
        mapper.update(seen_from(x, 0.2, 0.0, half_view=0.9))
    mapper.finish()
    poses = mapper.trajectory
    np.testing.assert_allclose(poses[:, 0, 3] - poses[0, 0, 3], path - path[0], atol=1e-9)
    np.testing.assert_allclose(poses[:, :2, :2], np.tile(np.eye(2), (21, 1, 1)), atol=1e-9)
    corners = mapper.map.positions[:, :2] + [path[0], 0.2]
    apart = np.linalg.norm(corners[:, None] - ROOM.reshape(-1, 2), axis=2).min(axis=1)
    assert len(corners) >= 3
    assert apart.max() < 1e-9


def test_the_frame_is_that_of_the_first_scan() -> None:
    mapper = finished(PlaneMapper(), (seen_from(-1.0 + 0.05 * k, 0.0, 0.02 * k) for k in range(15)))
    np.testing.assert_allclose(mapper.trajectory[0], np.eye(4), atol=1e-9)


def test_noisy_walls_come_out_better_refined() -> None:
    building = simulate_building(points=10, sigma=0.0, seed=3)
    rng = np.random.default_rng(0)
    mapper = PlaneMapper()
    for scan in building.scans:
        ends = scan.seen.ends + rng.normal(0.0, 0.01, scan.seen.ends.shape)
        front = ends[:, 0, 0] * ends[:, 1, 1] > ends[:, 0, 1] * ends[:, 1, 0]
        mapper.update(SimpleNamespace(ends=ends[front], end_type=scan.seen.end_type[front]))
    mapper.finish()
    chained_m = ate_m(mapper.trajectory, building.trajectory)
    mapper.refine()
    assert ate_m(mapper.trajectory, building.trajectory) < min(0.5 * chained_m, 0.03)


def test_walls_seen_again_are_joined() -> None:
    building = simulate_building(points=10, sigma=0.0, seed=0, loops=2)
    mapper = mapped(building)
    mapper.refine()
    corners = mapper.planes.corner
    truth = truth_of(building)
    matched = match_corners(mapper.planes, truth, mapper.trajectory, building.trajectory)
    n_true = len(np.unique(2 * matched.wall + matched.end))
    assert (corners >= 0).sum() <= 1.05 * n_true


def test_a_swinging_door_leaves_the_map() -> None:
    mapper, numbers, is_door = PlaneMapper(), [], []
    for k in range(60):
        angle = 0.8 + 0.6 * np.sin(k / 8)
        door = np.array([[1.0, 2.9], [1.0, 2.9]])
        door[0] += 0.9 * np.array([np.cos(angle), -np.sin(angle)])
        walls = np.concatenate([ROOM, door[None]])
        seen = seen_from(-1.5 + 0.02 * k, 0.0, 0.1, walls)
        numbers.append(mapper.update(seen))
        is_door.append(seen.wall == len(ROOM))
    mapper.finish()
    mapper.refine()
    corners = mapper.map.positions[:, :2]
    poses = mapper.trajectory
    first = turn(0.1)
    there = corners @ first.T + [-1.5, 0.0]
    fixed = np.concatenate([ROOM.reshape(-1, 2), [[1.0, 2.9]]])
    apart = np.linalg.norm(there[:, None] - fixed, axis=2).min(axis=1)
    assert len(corners) >= 4
    assert apart.max() < 1e-6
    assert np.isfinite(poses).all()
    table, of_door = mapper.planes, np.concatenate(is_door)
    number = mapper.landmarks_of(np.concatenate(numbers))
    door_row = np.isin(table.plane, number[of_door])
    assert not np.isin(table.plane[door_row], number[~of_door]).any()
    assert set(table.status[door_row & (table.observations >= 4)]) == {"dynamic"}
    assert set(table.status[door_row]) == {"dynamic", "unmapped"}
    assert set(table.status[~door_row]) == {"static"}


def test_numbers_of_walls_stay() -> None:
    mapper = PlaneMapper()
    first = mapper.update(seen_from(0.0, 0.0, 0.0))
    second = mapper.update(seen_from(0.1, 0.0, 0.02))
    assert sorted(first.tolist()) == sorted(second.tolist())
    assert mapper.landmarks_of(first).tolist() == first.tolist()


def test_the_map_of_groups_is_made_once_after_each_change() -> None:
    mapper = fed(PlaneMapper(), (seen_from(x, 0.0, 0.0) for x in np.linspace(0, 1, 12)))
    found = mapper.submaps
    assert mapper.submaps is found
    mapper.update(seen_from(1.1, 0.0, 0.0))
    assert len(mapper.submaps[0].poses) == len(found[0].poses) + 1
    mapper.finish()
    assert len(mapper.map.positions)
    mapper.refine()
    assert mapper.submaps[0].refined
    assert not found[0].refined


def test_scans_without_walls_are_bridged() -> None:
    mapper = PlaneMapper()
    nothing = SimpleNamespace(ends=np.empty((0, 2, 2)), end_type=np.empty((0, 2), dtype=str))
    for k in range(24):
        mapper.update(nothing if k in (0, 12) else seen_from(0.05 * k - 1, 0.0, 0.01 * k))
    mapper.finish()
    poses = mapper.trajectory
    assert np.isfinite(poses[1:]).all()
    assert abs(np.hypot(*(poses[13, :2, 3] - poses[11, :2, 3])) - 0.1) < 1e-6
    # Where nothing was seen, the robot is taken to have gone on as before.
    assert np.hypot(*(poses[12, :2, 3] - (poses[11, :2, 3] + poses[13, :2, 3]) / 2)) < 2e-3


def test_laser_scans_without_a_return_do_not_break_a_run() -> None:
    building = simulate_building(points=361, sampling="laser", sigma=0.01, iterations=40)
    segmenter, blank = PlaneSegmenter(view_rad=np.pi, range_m=8.0), [10, 25, 26]
    mapper = PlaneMapper(segmenter=segmenter)
    for k, scan in enumerate(building.scans):
        mapper.update(scan.points[: 0 if k in blank else None, :2])
    mapper.finish()
    (submap,) = mapper.submaps
    assert submap.span == (0, 40)
    off = np.linalg.inv(building.trajectory) @ building.trajectory[0] @ submap.poses
    assert np.delete(np.hypot(*off[:, :2, 3].T), blank).max() < 0.1
    weak = {step for k in blank for step in (k, k + 1)}
    assert set(mapper.weak_links.tolist()) == weak


def test_rooms_with_nothing_to_see_between_are_submaps() -> None:
    """Constant motion is not assumed over so many empty scans."""
    mapper = PlaneMapper()
    nothing = SimpleNamespace(ends=np.empty((0, 2, 2)), end_type=np.empty((0, 2), dtype=str))
    for k in range(70):
        room = ROOM + np.array([7.0 * (k >= 45), 0.0])
        mapper.update(nothing if 25 <= k < 45 else seen_from(0.1 * k - 1, 0.0, 0.0, room))
    mapper.finish()
    for _ in range(2):
        spans = sorted(submap.span for submap in mapper.submaps if len(submap.poses) > 1)
        assert [spans[0][0], spans[-1][1]] == [0, 70]
        for submap in mapper.submaps:
            begin, end = submap.span
            assert not (begin < 25 and end > 45)
            expected = np.column_stack([0.1 * np.arange(end - begin), np.zeros(end - begin)])
            path = submap.poses[:, :2, 3]
            np.testing.assert_allclose(path - path[0], expected, atol=1e-6)
        mapper.refine()


def test_the_same_scans_give_the_same_map() -> None:
    building = simulate_building(points=10, sigma=0.0, seed=2, iterations=60)
    maps = []
    for _ in range(2):
        mapper = mapped(building)
        mapper.refine()
        maps.append(mapper.map.positions.tobytes())
    assert maps[0] == maps[1]


@pytest.mark.parametrize(
    ("ends", "kind", "message"),
    [
        ([[[1.0, np.nan], [1.0, 1.0]]], [["corner", "view"]], "finite"),
        ([[[1.0, 1.0], [1.0, -1.0]]], [["corner", "view"]], "from behind"),
        ([[[1.0, -1.0], [1.0, 1.0]]], [["corner"]], "end_type has shape"),
        (ROOM[:3], np.full((2, 3), "corner"), "end_type has shape"),
    ],
)
def test_impossible_walls_are_refused(ends: Any, kind: Any, message: str) -> None:
    mapper = PlaneMapper()
    with pytest.raises(RelmapError, match=message):
        mapper.update(SimpleNamespace(ends=np.array(ends), end_type=np.array(kind)))
    assert len(mapper.planes.plane) == 0


def test_walls_may_have_a_number_of_points_and_no_noise() -> None:
    mapper = PlaneMapper()
    mapper.update(SimpleNamespace(ends=ROOM[:3], n_points=[9, 9, 9]))
    assert mapper.history.sd.tolist() == [0.0, 0.0, 0.0]


def test_a_wall_far_away_does_not_fill_the_memory() -> None:
    """A sensor that reports a large number where nothing returned sees walls there."""
    far = np.array([[[5e6, 1e4], [5e6, 2e4]]])
    mapper = PlaneMapper()
    for k in range(12):
        ends = np.concatenate([ROOM[:3], far]) - [0.1 * k, 0.0]
        mapper.update(SimpleNamespace(ends=ends, end_type=np.full((4, 2), "corner")))
    mapper.finish()
    mapper.refine()
    assert (mapper.planes.status == "static").sum() == 4


CORRIDOR = np.array(
    [
        [[30.0, 2.0], [-2.0, 2.0]],
        [[-2.0, -2.0], [4.0, -2.0]],
        [[26.0, -2.0], [30.0, -2.0]],
        [[30.0, -2.0], [30.0, 2.0]],
    ]
)
"""A long wall; nothing else is in view in the middle of the way along it."""


@pytest.mark.parametrize(("noise_m", "error_m"), [(0.0, 0.2), (0.005, 0.2)])
def test_along_a_single_partial_wall_the_speed_is_carried_on(
    noise_m: float, error_m: float
) -> None:
    """The motion model: what is across the wall stays observed, the link is weak (Fig. 6)."""
    rng = np.random.default_rng(0)
    mapper, path = PlaneMapper(), np.column_stack([0.2 * np.arange(130), np.zeros(130)])
    path[:, 1] = 0.1 * np.sin(np.arange(130) / 9)
    for k, (x, y) in enumerate(path):
        seen = seen_from(x, y, 0.1 * np.sin(k / 7), CORRIDOR, np.pi / 2, 5.0)
        ends = seen.ends + rng.normal(0.0, noise_m, seen.ends.shape)
        mapper.update(SimpleNamespace(ends=ends, end_type=seen.end_type))
    mapper.finish()
    for _ in range(2):
        poses = mapper.trajectory
        R, t = fit_rigid(poses[:20, :2, 3], path[:20])
        off = np.abs(poses[:, :2, 3] @ R.T + t - path)
        assert off[:, 0].max() < error_m
        assert off[:, 1].max() < 0.002 + 10 * noise_m
        mapper.refine()
    weak = mapper.weak_links
    assert 60 < len(weak) < 110
    assert np.isin(np.arange(40, 80), weak).all()
