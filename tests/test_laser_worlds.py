"""Simulated worlds for lasers: their plans, and what beams meet in them, against closed forms."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from relmap import RelmapError
from relmap.core.arrays import Floats
from relmap.simulation import Building, BuildingScan, simulate_building
from relmap.simulation.floor_plan import World, make_floor_plan
from relmap.simulation.sensor import LASER
from relmap.simulation.shapes import FloorPlan, wall_distances
from relmap.simulation.things import glass_ranges, round_ranges, walking
from relmap.simulation.visibility import SeenWalls
from tests.segments import cast, crossings
from tests.tables import poses_along

NEW: tuple[World, ...] = (
    "oblique",
    "glass",
    "furniture",
    "twin-rooms",
    "corridor",
    "bare-corridor",
    "curved",
)


def turned(points: Floats, quarters: int, about: Floats) -> Floats:
    """Rotate points (..., 2) by a number of right angles about a centre."""
    R = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), quarters)
    return np.asarray((points - about) @ R.T + about)


def plan_of(world: World, seed: int = 0) -> FloorPlan:
    return make_floor_plan(world, np.random.default_rng(seed))


def laser(world: World = "building", beams: int = 181, **others: Any) -> Building:
    return simulate_building(beams, 0.0, sampling="laser", world=world, **others)


def ranges_of(run: Building) -> Floats:
    return np.array([scan.ranges_m for scan in run.scans])


def _look_from(walls: Floats, centre: Floats) -> Floats:
    """Return how far rays into a room go; those towards the corridor are left out."""
    bearing = np.linspace(np.pi, 2 * np.pi, 90) + (np.pi if centre[1] > 0 else 0.0)
    ends = walls[:, :4].reshape(-1, 2, 2) - centre
    return np.array([cast(ends, angle)[0] for angle in bearing])


@pytest.mark.parametrize("world", NEW)
def test_walls_do_not_cross_and_the_robot_drives_clear_of_them(world: World) -> None:
    for seed in range(2):
        plan = plan_of(world, seed)
        assert crossings(plan.walls) == 0
        assert np.linalg.norm(plan.walls[:, 2:4] - plan.walls[:, :2], axis=1).min() > 0.09
        run = laser(world, beams=1, seed=seed, step_m=0.3)
        T = np.concatenate([run.trajectory, run.trajectory[:1]])
        steps = np.linalg.norm(np.diff(T[:, :2, 3], axis=0), axis=1)
        assert steps.max() < 0.32
        assert wall_distances(T[:, :2, 3], plan.walls).min() > 0.25


@pytest.mark.parametrize("step_m", [0.05, 0.22, 1.0])
def test_steps_and_turns_are_as_long_as_asked_for(step_m: float) -> None:
    run = laser(beams=1, step_m=step_m)
    T = run.trajectory
    steps = np.linalg.norm(np.diff(T[:, :2, 3], axis=0), axis=1)
    turns = np.abs(np.diff(np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))))
    assert np.median(steps) == pytest.approx(step_m, rel=0.02)
    assert 0.5 < turns.max() / np.deg2rad(4.0 * step_m / 0.22) < 1.5
    assert np.diff(run.stamps_s) == pytest.approx(0.2 * step_m / 0.22)


def test_no_two_walls_of_the_oblique_building_are_parallel_but_as_in_one_line() -> None:
    square, oblique = plan_of("building").walls, plan_of("oblique").walls
    assert len(square) == len(oblique)
    yaw = [np.arctan2(*(w[:, [3, 2]] - w[:, [1, 0]]).T) for w in (square, oblique)]
    straight = np.isclose(np.sin(2 * yaw[0]), 0, atol=1e-9)
    assert straight.sum() > 50
    right_angled = np.abs(np.sin(2 * (yaw[1][straight] - yaw[1][straight][0]))) < 0.02
    assert right_angled.mean() < 0.2


def test_all_twin_rooms_look_the_same() -> None:
    run = laser("twin-rooms", beams=1)
    T, plan = run.trajectory, plan_of("twin-rooms")
    walls, doors = plan.walls, plan.doors
    assert len(doors) == 6
    middle = (walls[:, :2].min(axis=0) + walls[:, :2].max(axis=0)) / 2
    moved = turned(walls[:, :4].reshape(-1, 2, 2), 2, middle).reshape(-1, 4)
    assert np.abs(moved[:, None] - walls[:, :4]).max(axis=2).min(axis=1).max() < 1e-9
    centres = doors.mean(axis=1) + [0.0, 2.25] * np.sign(doors.mean(axis=1) - middle)
    away = T[:, None, :2, 3] - centres
    for room in away.swapaxes(0, 1):
        inside = np.linalg.norm(room, axis=1) < 1.4
        assert np.histogram(np.arctan2(*room[inside].T), 12, (-np.pi, np.pi))[0].min() > 0
    looks = [_look_from(walls, centre) for centre in centres]
    for look in looks[1:]:
        np.testing.assert_allclose(look, looks[0], atol=1e-9)


def test_the_sides_of_the_corridor_are_all_the_same() -> None:
    walls = plan_of("corridor").walls[:, :4]
    middle = (walls[:, :2].min(axis=0) + walls[:, :2].max(axis=0)) / 2
    for quarters in (1, 2, 3):
        moved = turned(walls.reshape(-1, 2, 2), quarters, middle).reshape(-1, 4)
        assert np.abs(moved[:, None] - walls).max(axis=2).min(axis=1).max() < 1e-9


def test_half_way_along_a_bare_corridor_only_its_two_sides_are_seen() -> None:
    run = laser("bare-corridor")
    bare = [
        len(set(scan.seen.wall.tolist())) == 2 and "corner" not in scan.seen.end_type
        for scan in run.scans
    ]
    runs = "".join("x" if one else "." for one in [*bare, *bare]).split(".")
    assert 40 < max(map(len, runs)) < 100  # of 0.22 m


def unsure_m(run: Building, scan: int) -> float:
    """Return the standard deviation of the position from one scan, per metre of range noise."""
    ends = run.walls[run.scans[scan].wall, :4].reshape(-1, 2, 2)
    along = (ends[:, 1] - ends[:, 0]) @ run.trajectory[scan, :2, :2]
    x, y = along.T / np.linalg.norm(along, axis=1)
    points = run.scans[scan].points
    jacobian = np.column_stack([-y, x, points[:, 0] * x + points[:, 1] * y])
    least = np.linalg.eigvalsh(jacobian.T @ jacobian)[0]
    return float(1 / np.sqrt(max(least, 1e-12)))


@pytest.mark.parametrize("world", [world for world in NEW if world != "glass"])
def test_all_but_the_bare_corridor_determine_the_position_everywhere(world: World) -> None:
    run = laser(world, beams=361, step_m=0.4, seed=2)
    worst = max(unsure_m(run, scan) for scan in range(len(run.scans)))
    assert (worst > 1e3) if world == "bare-corridor" else (worst < 5)


def test_a_curve_is_round_and_has_no_corner_but_those_of_pilasters() -> None:
    run = laser("curved")
    ends = run.walls[:, :4].reshape(-1, 2, 2)
    length_m = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    chord = np.isclose(length_m, 0.1, rtol=0.03)
    away = ends[chord] - [2.0, 0.0] * np.sign(ends[chord, :, :1])
    radius_m = np.linalg.norm(away, axis=2)
    assert np.abs(np.stack([radius_m - 6.0, radius_m - 3.6])).min(axis=0).max() < 1e-9
    seen = run.times_seen()
    assert (seen[chord, 0] > 0).mean() > 0.95  # some are behind pilasters
    assert not seen[chord, 1:].any()
    assert (seen[~chord, 1:].max(axis=1) > 10).sum() >= 8


def test_beams_meet_round_objects_as_computed() -> None:
    bearing = np.deg2rad([-90.0, 0.0, 30.0, 89.0])
    discs = np.array([[3.0, 0.0, 0.5], [5.0, 0.0, 1.0], [-2.0, 0.0, 0.5]])
    assert round_ranges(discs, bearing).tolist() == [np.inf, 2.5, np.inf, np.inf]
    edge = np.arcsin(0.5 / 3.0)
    inside, beyond = round_ranges(discs[:1], edge + np.array([-1e-9, 1e-9]))
    assert inside == pytest.approx(np.sqrt(9.0 - 0.25), abs=1e-3)
    assert np.isinf(beyond)
    assert np.isinf(round_ranges(discs[:0], bearing)).all()


def test_random_round_objects_are_met_on_their_rim() -> None:
    rng = np.random.default_rng(0)
    discs = np.column_stack([rng.uniform(-6, 6, (20, 2)), rng.uniform(0.05, 0.4, 20)])
    discs = discs[np.hypot(*discs[:, :2].T) > 0.5]
    bearing = np.linspace(-np.pi, np.pi, 200)
    for angle, range_m in zip(bearing, round_ranges(discs, bearing), strict=True):
        way = np.linspace(0.0, min(range_m, 10.0), 2000)[:-1, None]
        ray = np.array([np.cos(angle), np.sin(angle)])
        away = np.linalg.norm(way * ray - discs[:, None, :2], axis=2) - discs[:, 2:]
        assert away.min() > -1e-9
        if np.isfinite(range_m):
            end = np.linalg.norm(range_m * ray - discs[:, :2], axis=1) - discs[:, 2]
            assert abs(end.min()) < 1e-9


def test_glass_returns_beams_that_meet_it_squarely_and_few_others() -> None:
    pane = np.array([[[2.0, -4.0], [2.0, 4.0]], [[2.0, 4.0], [2.0, -4.0]]])
    bearing = np.deg2rad(np.linspace(-80, 80, 4001))
    ranges = glass_ranges(pane, bearing, np.random.default_rng(0))
    returned = np.isfinite(ranges)
    np.testing.assert_allclose(ranges[returned], 2.0 / np.cos(bearing[returned]))
    square = np.abs(bearing) < np.deg2rad(12.0)
    met = np.abs(2.0 * np.tan(bearing)) < 4.0
    assert returned[square].all()
    assert returned[met & ~square].mean() == pytest.approx(0.05, abs=0.02)
    assert not returned[~met].any()
    behind = glass_ranges(pane[1:], bearing, np.random.default_rng(0))
    assert np.isinf(behind).all()


def test_beams_pass_through_panes_into_the_room_behind() -> None:
    plain, glass = (laser(world, seed=2, iterations=60) for world in ("building", "glass"))
    assert (plain.trajectory == glass.trajectory).all()
    there, through = ranges_of(plain), ranges_of(glass)
    deeper, nearer = (through > there + 0.1).mean(), (through < there - 1e-9).mean()
    assert deeper > 0.05
    assert nearer == 0.0
    ends = glass.walls[:, :4]
    returns = [scan.points[scan.stretch < 0, :2] for scan in glass.scans]
    T = glass.trajectory
    on = np.concatenate([p @ M[:2, :2].T + M[:2, 3] for p, M in zip(returns, T, strict=True)])
    assert len(on) > 50
    assert wall_distances(on, ends).min(axis=1).max() < 1e-9


def test_people_and_clutter_hide_walls_and_change_nothing_else() -> None:
    free, crowded, strewn = (
        laser(seed=1, iterations=80, **o) for o in ({}, {"people": 15}, {"clutter": 0.2})
    )
    for other in (crowded, strewn):
        assert (other.trajectory == free.trajectory).all()
        assert (other.walls == free.walls).all()
        there, now = ranges_of(free), ranges_of(other)
        hidden = now != there
        assert (now[hidden] < there[hidden]).all()
        of_wall = np.concatenate([scan.wall for scan in other.scans]) >= 0
        np.testing.assert_array_equal(of_wall, ~hidden[np.isfinite(now)])
        for scan in other.scans:
            bearing = np.arctan2(scan.points[:, 1], scan.points[:, 0])
            assert (np.diff(bearing) > 0).all()
    share = np.mean(ranges_of(strewn) != ranges_of(free))
    assert share == pytest.approx(0.2, abs=0.02)
    assert 0.01 < np.mean(ranges_of(crowded) != ranges_of(free)) < 0.4


@pytest.mark.parametrize("world", ["building", "twin-rooms", "curved"])
def test_people_walk_through_doors_and_not_through_walls(world: World) -> None:
    plan = plan_of(world, 3)
    stamps_s = np.arange(0.0, 200.0, 0.1)
    far = poses_along(np.full(len(stamps_s), 1e3))
    people = walking(plan, 4, stamps_s, far, np.random.default_rng(3))
    assert people.shape == (2000, 4, 3)
    for person in people.swapaxes(0, 1):
        way = person[:, :2]
        pace = np.linalg.norm(np.diff(way, axis=0), axis=1) / 0.1
        assert 0.5 < np.median(pace) < 1.5
        assert pace.max() < 1.5
        steps = np.hstack([way[:-1], way[1:]])
        steps = steps[pace > 0.1]
        assert crossings(plan.walls, steps) == 0
    near = far.copy()
    near[:, :2, 3] = people[:, 0, :2] + [0.2, 0.1]
    beside = walking(plan, 4, stamps_s, near, np.random.default_rng(3))
    away = np.linalg.norm(beside[..., :2] - near[:, None, :2, 3], axis=2)
    assert away.min() > 0.5 - 1e-9


def test_the_seen_extent_of_a_wall_is_given() -> None:
    walls = np.array([[0.0, 1.0, 4.0, 1.0, 0.0, 2.0], [9.0, 0.0, 9.0, 1.0, 0.0, 2.0]])
    nothing = SeenWalls(np.array([0]), np.zeros((1, 2, 2)), np.full((1, 2), "view"))

    def scan(low: float, high: float, points: int) -> BuildingScan:
        at = np.column_stack([np.linspace(low, high, points), np.ones(points), np.zeros(points)])
        return BuildingScan(at, nothing, np.zeros(points, dtype=np.int64))

    few = [scan(0.0, 4.0, 4)] * 20  # too few points each
    wide, narrow, other = [scan(1.0, 3.0, 50)] * 9, [scan(1.5, 3.5, 50)], [scan(0.5, 1.2, 9)]
    scans, poses = [*few, *wide, *narrow, *other], np.tile(np.eye(4), (31, 1, 1))
    run = Building(walls, np.zeros(2, dtype=bool), poses, np.arange(31.0), scans, LASER)
    told = run.seen_extents()
    assert told[0] == pytest.approx([1.0, 3.0], abs=0.051)  # in ten scans the one or the other
    assert np.isnan(told[1]).all()


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"step_m": 0.0}, "step is 0.0"),
        ({"people": -1}, "people is -1"),
        ({"clutter": 0.6}, "clutter is 0.6"),
        ({"people": 1, "sampling": "surface"}, "sampling must be laser"),
        ({"world": "glass", "sampling": "rays"}, "sampling must be laser"),
    ],
)
def test_what_no_laser_could_see_is_refused(bad: dict[str, Any], message: str) -> None:
    with pytest.raises(RelmapError, match=message):
        simulate_building(**({"sampling": "laser"} | bad))


def test_the_same_seed_gives_the_same_crowd() -> None:
    first, again = (laser(seed=4, iterations=20, people=5, clutter=0.1) for _ in range(2))
    for one, other in pairwise([first, again]):
        assert ranges_of(one).tobytes() == ranges_of(other).tobytes()
