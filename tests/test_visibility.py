"""Visible parts of walls: closed forms, and ray casting against every wall."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.simulation import simulate_building
from relmap.simulation.floor_plan import World, make_floor_plan
from relmap.simulation.visibility import SeenWalls, seen_walls
from tests.segments import cast
from tests.worlds import turn

RIGHT_ANGLE = np.deg2rad(90.0)


def look(*walls: tuple[float, float, float, float], range_m: float = 10.0) -> SeenWalls:
    """Return the parts of walls x0, y0, x1, y1 visible to a robot with a view of 90 degrees."""
    ends = np.array(walls, dtype=np.float64).reshape(-1, 2, 2)
    return seen_walls(ends, range_m, RIGHT_ANGLE / 2)


def bearings(seen: SeenWalls) -> Floats:
    return np.asarray(np.arctan2(seen.ends[..., 1], seen.ends[..., 0]))


def test_a_wall_wider_than_the_view_is_cut_by_both_its_edges() -> None:
    seen = look((2, -5, 2, 5))
    np.testing.assert_allclose(seen.ends, [[[2, -2], [2, 2]]], atol=1e-12)
    assert seen.end_type.tolist() == [["view", "view"]]


def test_a_wall_beyond_the_range_is_cut_by_it() -> None:
    seen = look((4, -10, 4, 10), range_m=5.0)
    np.testing.assert_allclose(seen.ends, [[[4, -3], [4, 3]]], atol=1e-12)
    assert seen.end_type.tolist() == [["range", "range"]]
    assert len(look((4, -10, 4, 10), range_m=3.9).wall) == 0


def test_a_wall_seen_whole_ends_in_its_corners() -> None:
    seen = look((3, -1, 3.5, 1))
    assert seen.ends.tolist() == [[[3, -1], [3.5, 1]]]
    assert seen.end_type.tolist() == [["corner", "corner"]]


def test_a_wall_behind_a_panel_has_two_stretches() -> None:
    seen = look((2, -5, 2, 5), (1, -0.25, 1, 0.25))
    assert seen.wall.tolist() == [0, 1, 0]
    expected = np.array([[2, -2, 2, -0.5], [1, -0.25, 1, 0.25], [2, 0.5, 2, 2]]).reshape(3, 2, 2)
    np.testing.assert_allclose(seen.ends, expected, atol=1e-12)
    types = [["view", "occluded"], ["corner", "corner"], ["occluded", "view"]]
    assert seen.end_type.tolist() == types


def test_walls_that_meet_in_a_corner_both_end_there() -> None:
    seen = look((1, -2, 3, -2), (3, -2, 3, 1))
    assert seen.wall.tolist() == [0, 1]
    assert seen.ends[0, 1].tolist() == seen.ends[1, 0].tolist() == [3, -2]
    assert seen.end_type.tolist() == [["view", "corner"], ["corner", "corner"]]


@pytest.mark.parametrize(
    "wall",
    [
        pytest.param((2, 5, 2, -5), id="from behind"),
        pytest.param((-2, 5, -2, -5), id="behind the robot"),
        pytest.param((1, 0, 3, 0), id="edge on"),
        pytest.param((1, 4, -3, 4), id="beside the view"),
    ],
)
def test_what_is_not_seen(wall: tuple[float, float, float, float]) -> None:
    assert len(look(wall).wall) == 0
    assert look(wall).ends.shape == (0, 2, 2)


def test_an_empty_world_shows_nothing() -> None:
    assert len(look().wall) == 0


@cache
def random_view(seed: int, most_deg: float) -> tuple[Floats, float, float]:
    """Return walls in the frame of a robot on a random place of a world, range and half view."""
    worlds: tuple[World, ...] = ("building", "panels")
    rng = np.random.default_rng(1000 + seed)
    plan = make_floor_plan(worlds[seed % 2], rng)
    R = turn(rng.uniform(-np.pi, np.pi))
    floor = plan.floors[rng.integers(len(plan.floors))]
    ends = plan.walls[:, :4].reshape(-1, 2, 2) - rng.uniform(floor[:2], floor[2:])
    return ends @ R, rng.uniform(4, 12), np.deg2rad(rng.uniform(25, most_deg))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("most_deg", [90, 179])
def test_ray_casting_meets_the_same_walls(seed: int, most_deg: float) -> None:
    ends, range_m, half_view = random_view(seed, most_deg)
    seen = seen_walls(ends, range_m, half_view)
    limits = bearings(seen)
    assert (limits[:, 0] < limits[:, 1]).all()
    assert (limits[1:, 0] >= limits[:-1, 1] - 1e-12).all()
    for bearing in np.linspace(-half_view, half_view, 122)[1:-1]:
        distance, wall = cast(ends, bearing)
        inside = np.flatnonzero((limits[:, 0] < bearing) & (bearing < limits[:, 1]))
        if distance > range_m:
            assert len(inside) == 0
        else:
            assert seen.wall[inside].tolist() == [wall]
            a, b = seen.ends[inside[0]]
            at = np.array([np.cos(bearing), np.sin(bearing)]) * distance
            off = (b - a)[0] * (at - a)[1] - (b - a)[1] * (at - a)[0]
            assert abs(off) < 1e-9


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("most_deg", [90, 179])
def test_ends_are_what_they_are_called(seed: int, most_deg: float) -> None:
    ends, range_m, half_view = random_view(seed, most_deg)
    seen = seen_walls(ends, range_m, half_view)
    for wall, pair, types in zip(seen.wall, seen.ends, seen.end_type, strict=True):
        for side, (point, kind) in enumerate(zip(pair, types, strict=True)):
            true = ends[wall, side]
            beyond = np.arctan2(point[1], point[0]) + (2 * side - 1) * 1e-6
            holds = {
                "corner": bool((point == true).all()),
                "view": abs(abs(np.arctan2(point[1], point[0])) - half_view) < 1e-9,
                "range": abs(np.hypot(*point) - range_m) < 1e-9,
                "occluded": cast(ends, beyond)[0] < np.hypot(*point) - 1e-6,
            }
            assert holds[kind]
            if kind != "corner":
                assert np.abs(point - true).max() > 1e-9
            if kind == "occluded":
                assert not holds["view"]
                assert not holds["range"]


def test_every_type_of_end_occurs_on_a_drive() -> None:
    scans = simulate_building(points=10).scans
    kinds = np.concatenate([scan.seen.end_type.ravel() for scan in scans])
    assert set(kinds.tolist()) == {"corner", "view", "range", "occluded"}
