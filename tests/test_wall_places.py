"""One scan among the walls of a map: found where it fits in one place alone."""

from __future__ import annotations

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.mapper import Place
from relmap.planes.places.finding import place_among
from relmap.planes.places.wall_tie import wall_ties
from relmap.planes.scans.observation import checked_planes
from relmap.simulation.visibility import SeenWalls, seen_walls
from tests.worlds import ROOM, turn

HALL = np.array([[[-30.0, 0.0], [30.0, 0.0]], [[30.0, 2.0], [-30.0, 2.0]]])


def place_in(walls: Floats, seen_of: Floats, x: float, y: float, yaw: float) -> Place:
    """Look for a scan of some walls, taken at a pose, among walls."""
    seen = seen_walls((seen_of - [x, y]) @ turn(yaw), 8.0, 3.0)
    step = np.linspace(0.0, 1.0, 60)[:, None]
    beams = np.concatenate([a + step * (b - a) for a, b in seen.ends])
    return place_among(checked_planes(seen, beams), walls)


def test_a_scan_is_found_where_it_fits_in_one_place_alone() -> None:
    one = place_in(ROOM, ROOM, 1.5, 1.0, 0.4)
    assert one.n_places == 1
    np.testing.assert_allclose(one.T_map_robot[:2, 3], [1.5, 1.0], atol=0.02)
    assert np.arctan2(one.T_map_robot[1, 0], one.T_map_robot[0, 0]) == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize(
    ("walls", "n_places"),
    [
        (np.concatenate([ROOM, np.add(ROOM, [20.0, 3.0])]), 2),
        (np.concatenate([ROOM, ROOM @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + [20.0, 3.0]]), 2),
        (HALL, 0),
        (np.empty((0, 2, 2)), 0),
    ],
    ids=["twins", "turned twins", "elsewhere", "nothing"],
)
def test_a_scan_that_fits_in_two_places_or_none_is_refused(walls: Floats, n_places: int) -> None:
    place = place_in(walls, ROOM, 1.5, 1.0, 0.4)
    assert place.n_places == n_places
    assert np.isnan(place.T_map_robot).all()


@pytest.mark.parametrize(
    ("shifted", "by_m", "n_places"), [(4, 0.5, 1), (2, 1.0, 2)], ids=["explains 0.62", "0.74"]
)
def test_a_room_that_explains_fewer_of_the_beams_does_not_compete(
    shifted: int, by_m: float, n_places: int
) -> None:
    """Of a second room like the first one some walls are elsewhere; the rest explain some beams."""
    alike = np.add(ROOM, [20.0, 3.0])
    alike[:shifted] += by_m
    assert place_in(np.concatenate([ROOM, alike]), ROOM, 1.5, 1.0, 0.4).n_places == n_places


@pytest.mark.parametrize("world", [0.1, 0.7, 1.2])
def test_walls_are_aligned_in_each_of_their_places(world: float) -> None:
    """Of six rooms in a row, turned by quarters; adjacent rotations and shifts score alike."""
    yaw, along = world + 0.5 * np.pi * np.arange(6), 12.0 * np.arange(6)
    at = np.column_stack([along, np.zeros(6)]) @ turn(world).T
    rooms = [ROOM @ turn(each).T + t for each, t in zip(yaw, at, strict=True)]
    ties = wall_ties(ROOM, np.concatenate(rooms))[:6]
    found = np.array([[*tie.t, *tie.R[:, 0]] for tie in ties])
    there = np.column_stack([at, np.cos(yaw), np.sin(yaw)])
    np.testing.assert_allclose(found[np.argsort(found[:, :2] @ at[1])], there, atol=1e-6)


def test_a_wall_far_away_does_not_fill_the_memory() -> None:
    far = np.array([[[1e6, 1e6], [1e6, 1e6 + 9.0]]])
    best, *_ = wall_ties(ROOM, np.concatenate([np.add(ROOM, [20.0, 3.0]), far]))
    np.testing.assert_allclose(best.t, [20.0, 3.0], atol=1e-6)


def test_a_scan_larger_than_the_map_is_not_aligned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("relmap.planes.places.finding.wall_ties")
    assert place_in(0.5 * ROOM, HALL, 1.0, 1.0, 0.1).n_places == 0


def test_walls_that_no_laser_sees_are_not_compared() -> None:
    seen = seen_walls(ROOM - [1.5, 1.0], 8.0, 3.0)
    far = np.array([[[1e5, -0.2], [1e5, 0.2]]])
    ends, end_type = np.concatenate([seen.ends, far]), np.append(seen.end_type, [["view"] * 2], 0)
    step = np.linspace(0.0, 1.0, 60)[:, None]
    beams = np.concatenate([a + step * (b - a) for a, b in ends])
    walls = SeenWalls(np.append(seen.wall, 9), ends, end_type)
    assert place_among(checked_planes(walls, beams), ROOM).n_places == 1


def test_along_a_bare_corridor_a_scan_may_be_anywhere() -> None:
    assert place_in(HALL, HALL, 1.0, 1.0, 0.1).n_places == 2


@pytest.mark.parametrize(
    ("clutter", "beyond", "n_places"),
    [(0, 0, 1), (126, 0, 1), (600, 0, 0), (0, 9, 1), (126, 9, 0)],
    ids=["bare", "cluttered", "hidden", "seen through", "both"],
)
def test_clutter_hides_a_place_only_if_walls_are_seen_through(
    clutter: int, beyond: int, n_places: int
) -> None:
    """Beams end on what stands around the robot, which the map lacks, and some beyond."""
    seen = seen_walls(ROOM - [1.5, 1.0], 8.0, 3.0)
    step = np.linspace(0.0, 1.0, 39)[:, None]
    beams = np.concatenate([a + step * (b - a) for a, b in seen.ends])
    if beyond:
        beams[::beyond] *= 1.5
    around = np.linspace(0.0, 2 * np.pi, clutter, endpoint=False)
    beams = np.concatenate([beams, 0.4 * np.column_stack([np.cos(around), np.sin(around)])])
    assert place_among(checked_planes(seen, beams), ROOM).n_places == n_places


@pytest.mark.parametrize(("clutter", "n_places"), [(0, 1), (10, 1), (40, 0)])
def test_a_few_walls_must_explain_nearly_all_beams(clutter: int, n_places: int) -> None:
    walls = np.array([[[0.0, 0.0], [5.0, 0.0]], [[5.0, 0.0], [5.0, 2.0]], [[5.0, 2.0], [2.0, 2.5]]])
    seen = seen_walls(walls - [1.5, 1.0], 8.0, 3.0)
    step = np.linspace(0.0, 1.0, 60)[:, None]
    beams = np.concatenate([a + step * (b - a) for a, b in seen.ends])
    around = np.linspace(0.0, 2 * np.pi, clutter, endpoint=False)
    beams = np.concatenate([beams, 0.4 * np.column_stack([np.cos(around), np.sin(around)])])
    assert place_among(checked_planes(seen, beams), walls).n_places == n_places
