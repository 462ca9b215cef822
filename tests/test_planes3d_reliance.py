"""Planes in space: unsteady steps that a single landmark implies are listed, others are not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import Plane3dMapper
from relmap.core.arrays import Floats, Ints
from relmap.planes3d import mapper as mapper3d
from relmap.planes3d.certainty import changes, fragile, turn_changes
from relmap.planes3d.misled import comes_along, quick_step_m
from relmap.planes3d.refining import refined, scene, sightings, unsure_steps
from relmap.planes3d.submap import Submap
from tests.test_planes3d_covariances import patches, wall


def carried(way_m: list[float], *walls_m: float) -> Submap:
    """Return scans at positions on the x axis, of walls across it, of another wall and a floor."""
    part = Submap()
    for k, x in enumerate(way_m):
        seen = patches(*(wall(0, at - x) for at in walls_m), wall(1, 2.0), wall(2, -2.0))
        part.add(k, seen, (np.eye(3), np.array([x, 0.0, 0.0])), np.arange(len(seen)))
    return part


@pytest.mark.parametrize("walls_m", [(3.0,), (3.0, -3.0)])
def test_a_jump_that_one_wall_implies_is_listed(walls_m: tuple[float, ...]) -> None:
    # If the wall moved in the fourth scan, the planes agree all the same.
    way_m = [0.0, 0.1, 0.2, 0.6, 0.4, 0.5, 0.6]
    part, _ = refined(carried(way_m, *walls_m), 4)
    assert sorted(unsure_steps(part)) == ([3, 4] if len(walls_m) == 1 else [])


def test_steps_by_a_landmark_that_moves_steadily_are_listed() -> None:
    # Both ends of a room are seen before and after, and something that moves in between.
    part = Submap()
    for k in range(16):
        x, moves = 0.1 * k + 0.3 * min(max(k - 5, 0), 5), 5 < k < 11
        across = [wall(0, 3.0 - x)] if moves else [wall(0, 9.0 - x), wall(0, -6.0 - x)]
        number = np.array([4, 0, 1] if moves else [2, 3, 0, 1])
        part.add(
            k,
            patches(*across, wall(1, 2.0), wall(2, -2.0)),
            (np.eye(3), np.array([x, 0.0, 0.0])),
            number,
        )
    assert set(unsure_steps(refined(part, 5)[0])) >= {7, 8, 9, 10}


@pytest.mark.parametrize(("noise_m", "listed"), [(0.0, True), (0.02, True), (0.1, False)])
def test_a_jump_is_listed_where_steps_differ_far_less(noise_m: float, listed: bool) -> None:
    # Whatever implies it.
    way_m = [0.1 * k + (0.3 if k > 4 else 0.0) + noise_m * (k % 4 == 1) for k in range(9)]
    part, _ = refined(carried(way_m, 3.0, -3.0), 4)
    assert (5 in unsure_steps(part)) == listed


def test_a_stretch_unlike_the_path_around_it_is_listed_whatever_implies_it() -> None:
    # Two cars drive before and behind the sensor at its pace, and hide the street.
    way_m = np.cumsum([0.0, *(0.0 if 11 < k < 16 else 0.1 for k in range(30))])
    part, _ = refined(carried(way_m.tolist(), 3.0, -3.0), 4)
    assert set(unsure_steps(part)) >= {13, 14, 15, 16}


def test_a_slow_first_step_of_a_few_is_not_listed() -> None:
    way_m = np.cumsum([0.0, 0.27, 0.3, 0.3, 0.3, 0.3])
    assert unsure_steps(refined(carried(way_m.tolist(), 3.5, -3.0), 4)[0]) == {}


@pytest.mark.parametrize(("less_rad", "listed"), [(0.0, []), (0.15, [5])])
@pytest.mark.parametrize("noise_rad", [0.0, 0.005])
def test_a_turn_unlike_those_before_and_after_is_listed(
    noise_rad: float, less_rad: float, listed: list[int]
) -> None:
    # In a square room with a fast turn by 80 degrees the scans agree with one by -10, too.
    part, sides = Submap(), [wall(axis, at) for axis in range(3) for at in (-3.0, 3.0)]
    for k in range(9):
        yaw = 0.07 * k - less_rad * (k > 4) + noise_rad * (k % 4 == 1)
        R = turned(yaw)
        part.add(k, patches(*(side @ R for side in sides)), (R, np.zeros(3)), np.arange(6))
    assert sorted(unsure_steps(refined(part, 6)[0])) == listed


def test_a_steady_path_that_depends_on_one_wall_is_not_listed() -> None:
    part, _ = refined(carried([0.1 * k for k in range(7)], 3.0), 3)
    assert unsure_steps(part) == {}


@pytest.mark.parametrize(
    ("extent", "scans", "listed"), [(0.14, 6, True), (0.14, 7, False), (0.3, 6, False)]
)
def test_steps_that_only_small_planes_of_few_scans_determine_are_listed(
    extent: float, scans: int, listed: bool
) -> None:
    # Along a corridor two people walk ahead of the sensor, which seems to stand still.
    long, small = np.array([3.0, 1.0, 1.0]), np.array([1.0, extent, extent])
    backs = [wall(0, 3.0) * small + [0.0, 0.8, 0.0], wall(0, 3.3) * small - [0.0, 0.8, 0.0]]
    seen, part = patches(wall(1, 2.0) * long, wall(2, -2.0) * long, *backs), Submap()
    for k in range(2 * scans):
        number = np.array([0, 1, 2 + 2 * (k // scans), 3 + 2 * ((k + 3) // scans)])
        part.add(k, seen, (np.eye(3), np.zeros(3)), number)
    assert sorted(unsure_steps(part)) == (list(range(1, 2 * scans)) if listed else [])


@pytest.mark.parametrize("rests", [False, True])
def test_steps_by_landmarks_that_came_along_are_listed_but_not_a_rest(rests: bool) -> None:
    # The sensor moves, seems to stand still for 30 scans, and moves on. Meanwhile the walls across,
    # large and seen for long, are others, as the backs of companions, or those seen before.
    part = Submap()
    for k in range(50):
        x, moves = 0.1 * (min(k, 10) + max(k - 40, 0)), 10 < k < 40
        seen = patches(wall(1, 2.0), wall(2, -2.0), wall(0, 9.0 - x), wall(0, -6.0 - x))
        number = np.array([0, 1, 4, 5] if moves and not rests else [0, 1, 2, 3])
        part.add(k, seen, (np.eye(3), np.array([x, 0.0, 0.0])), number)
    still = set(range(20, 31))
    assert not still & set(unsure_steps(part))
    listed = still & set(unsure_steps(part, quick_m=quick_step_m([part])))
    assert listed == (set() if rests else still)


def test_a_run_at_rest_is_not_listed() -> None:
    # By noise the sensor moves by up to 0.3 % of the range.
    way_m = 0.01 * np.random.default_rng(0).uniform(-1.0, 1.0, 40)
    part = carried(way_m.tolist(), 3.0, -3.0)
    assert unsure_steps(part, quick_m=quick_step_m([part])) == {}


def test_a_sensor_that_drives_in_laps_does_not_rest() -> None:
    # After every 12 scans the sensor is where it was.
    part = carried([0.1 * abs(k % 12 - 6) for k in range(40)], 3.0, -3.0)
    assert not comes_along(part, quick_step_m([part])).any()


def test_the_mapper_compares_with_the_steps_of_a_sensor_that_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[float] = []

    def noted(part: Submap, is_broken: bool, quick_m: float) -> dict[int, Floats]:
        given.append(quick_m)
        return {}

    monkeypatch.setattr(mapper3d, "unsure_steps", noted)
    mapper, corner = Plane3dMapper(), np.concatenate([wall(axis, 3.0) for axis in range(3)])
    for x in [0.0] * 4 + [0.1, 0.2, 0.3, 0.4]:
        mapper.update(corner - [x, 0.0, 0.0])
    mapper.finish()
    assert given == pytest.approx([0.1], abs=0.01)


@pytest.mark.parametrize(("scans", "listed"), [(2, [1]), (6, [1, 2, 3, 4, 5]), (7, [])])
def test_the_steps_of_a_few_scans_that_a_break_left_are_listed(
    scans: int, listed: list[int]
) -> None:
    part, _ = refined(carried([0.1 * k for k in range(scans)], 3.0, -3.0), 4)
    assert unsure_steps(part) == {}
    assert sorted(unsure_steps(part, is_broken=True)) == listed


def test_a_step_that_planes_leave_open_does_not_slide() -> None:
    # No scan shows both ends of a corridor that is wider by 4 mm for the scans behind the break;
    # its walls are not quite parallel, so that it would be as wide 0.8 m farther on.
    part = Submap()
    for k in range(8):
        x, half, end = 0.1 * k, 2.0 + 0.002 * (k > 3), 3.0 if k < 4 else -3.0
        sides = [wall(1, side * half) @ turned(side * 0.0025) for side in (1, -1)]
        seen = patches(*(side - [x, 0.0, 0.0] for side in (*sides, wall(2, -2.0), wall(0, end))))
        part.add(k, seen, (np.eye(3), np.array([x, 0.0, 0.0])), np.array([0, 1, 2, 3 + (k > 3)]))
    part, _ = refined(part, 5)
    assert np.diff(scene(part).t[:, 0]) == pytest.approx(0.1, abs=0.01)
    assert 4 in part.weak


def test_a_step_that_planes_leave_open_in_two_directions_slides_in_none() -> None:
    # As above, and the height is known to a metre only: a step fits that is half a metre high.
    part = Submap()
    for k in range(8):
        x, half, end = 0.1 * k, 2.0 + 0.002 * (k > 3), 3.0 if k < 4 else -3.0
        sides = [wall(1, side * half) @ turned(side * 0.0025) for side in (1, -1)]
        floor = wall(2, -2.0 - 0.5 * (k > 3))
        seen = patches(*(side - [x, 0.0, 0.0] for side in (*sides, floor, wall(0, end))))
        seen.information[2, 2] = 1.0
        part.add(k, seen, (np.eye(3), np.array([x, 0.0, 0.0])), np.array([0, 1, 2, 3 + (k > 3)]))
    part, _ = refined(part, 5)
    steps = np.diff(scene(part).t, axis=0)
    assert steps[3] == pytest.approx([0.1, 0.0, 0.0], abs=0.01)
    assert 4 in part.weak


def test_what_follows_an_open_step_moves_with_the_scans_before_it() -> None:
    # A wall that the first three scans see, of which the second and third were placed 0.3 m off;
    # the others see no end of the corridor.
    part = Submap()
    for k in range(8):
        x, off = 0.1 * k, 0.3 * (k > 0)
        walls = [wall(1, 2.0), wall(2, -2.0), *([wall(0, 3.0 - x)] if k < 3 else [])]
        pose = np.eye(3), np.array([x + off, 0.0, 0.0])
        part.add(k, patches(*walls), pose, np.arange(len(walls)))
        if k > 2:
            part.weak[k] = np.array([1.0, 0.0, 0.0])
            part.held.add(k)
    part, _ = refined(part, 3)
    assert scene(part).t[:, 0] == pytest.approx(0.1 * np.arange(8), abs=1e-3)


def test_a_direction_that_later_scans_determine_is_not_kept() -> None:
    # It was weak when the scan was placed.
    part = carried([0.0, 0.1, 0.23, 0.3, 0.4], 3.0)
    part.weak[2] = np.array([1.0, 0.0, 0.0])
    R, t = part.poses[2]
    part.poses[2] = R, t + np.array([0.05, 0.0, 0.0])
    assert scene(refined(part, 3)[0]).t[2, 0] == pytest.approx(0.23, abs=1e-3)


def turned(yaw: float) -> Floats:
    return Rotation.from_rotvec([0.0, 0.0, yaw]).as_matrix()


def test_a_room_with_parallel_walls_is_not_fragile_but_a_corner_is() -> None:
    room_scan, *_ = fragile_of(carried([0.0, 0.1], 3.0, -3.0))
    assert sorted(room_scan.tolist()) == [0, 0, 1, 1]  # across the single walls only
    for way_m in np.linspace(0.05, 0.4, 8):
        corner_scan, _, along = fragile_of(carried([0.0, way_m], 3.0))
        assert sorted(corner_scan.tolist()) == [0, 0, 0, 1, 1, 1]
        assert np.sort(np.abs(along).argmax(axis=1)).tolist() == [0, 0, 1, 1, 2, 2]


@pytest.mark.parametrize(("share", "lost"), [(0.01, False), (0.05, True)])
def test_a_scan_depends_on_a_wall_without_which_it_is_uncertain(share: float, lost: bool) -> None:
    part = carried([0.0, 0.1], 3.0, -3.0)
    for seen in part.seen:
        seen.information[1] = (share * seen.reach_m) ** -2.0
    scan, landmark, along = fragile_of(part)
    by_walls = np.abs(along[:, 0]) > 0.9
    assert scan[by_walls].tolist() == ([0, 1] if lost else [])
    assert (landmark[by_walls] == 0).all()


@pytest.mark.parametrize(("share", "elsewhere"), [(0.002, False), (0.02, True)])
def test_a_scan_depends_on_a_wall_without_which_it_is_elsewhere(
    share: float, elsewhere: bool
) -> None:
    part = carried([0.0, 0.1, 0.2, 0.3], 3.0, -3.0)
    last = part.seen[-1]
    last.information[1] = (0.002 * last.reach_m) ** -2.0
    last.centre[1, 0] += share * last.reach_m
    scan, landmark, along = fragile_of(part)
    by_walls = np.abs(along[:, 0]) > 0.9
    assert scan[by_walls].tolist() == ([3] if elsewhere else [])
    assert (landmark[by_walls] == 0).all()


def fragile_of(part: Submap) -> tuple[Ints, Ints, Floats]:
    reach_m = np.array([each.reach_m for each in part.seen])
    return fragile(sightings(part), scene(part), 0.0, reach_m)


def steps(*steps_m: float) -> Floats:
    return np.column_stack([steps_m, np.zeros((len(steps_m), 2))])


def test_changes_compare_a_step_with_its_neighbours() -> None:
    iteration = np.arange(6)
    assert np.abs(changes(steps(*[0.3] * 5), iteration)).max() < 1e-12
    jump = changes(steps(0.3, 0.3, 0.8, 0.3, 0.3), iteration)
    np.testing.assert_allclose(jump[:, 0], [0.0, -0.25, 0.5, -0.25, 0.0], atol=1e-12)
    # A missing scan makes a step twice as long, not unsteady.
    later = np.array([0, 1, 2, 4, 5, 6])
    assert np.abs(changes(steps(0.3, 0.3, 0.6, 0.3, 0.3), later)).max() < 1e-12
    assert not changes(steps(0.3), np.arange(2)).any()


def test_turns_are_compared_whatever_the_heading() -> None:
    yaw = Rotation.from_euler("z", 0.4 * np.arange(6)[:, None] + 3.0).as_matrix()
    assert np.abs(turn_changes(yaw, np.arange(6))).max() < 1e-12
    # A missing scan makes a turn twice as large, not unsteady.
    assert np.abs(turn_changes(yaw[[0, 1, 2, 4, 5]], np.array([0, 1, 2, 4, 5]))).max() < 1e-12
