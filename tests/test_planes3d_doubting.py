"""Planes in space: placements that fit and are wrong all the same are not accepted."""

from __future__ import annotations

from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.evaluation.metrics import ate
from relmap.evaluation.space_run import submap_row
from relmap.planes3d.fitting import matched
from relmap.planes3d.hypotheses import Held
from relmap.planes3d.placing import Placed, apart, is_rival, place
from relmap.planes3d.sights import is_doubtful, is_tied_doubtfully, seen_through, with_ends
from relmap.planes3d.submap import Submap
from relmap.planes3d.table import plane_table
from relmap.plots.planes import plot_planes3d
from relmap.segmentation.space import PatchSegmenter
from relmap.simulation.house import house, moving_box
from relmap.simulation.storey import COLUMNS, FOCAL, ROWS, cast_rays, simulate_storey
from tests.test_planes3d_covariances import part_of, patches, wall
from tests.worlds import fed

STILL, ORIGIN = np.eye(3), np.zeros(3)
TABLE = wall(2, -0.3, (0.2, 0.9))


def placed(yaw: float, share: float = 1.0) -> Placed:
    R = Rotation.from_rotvec([0.0, 0.0, yaw]).as_matrix()
    return Placed(R, ORIGIN, np.arange(7), share, None, False)


def carried(count: int, first: int = 0) -> Submap:
    """Return a submap of scans that turn by 0.1 rad each, and of twelve planes."""
    sides = [wall(axis, at) for axis in range(3) for at in (-3.0, 3.0)]
    pieces = [wall(axis, at, (2.0, 3.0)) for axis in (0, 1) for at in (-1.0, 1.0, 2.0)]
    part, seen = Submap(), patches(*sides, *pieces)
    for k in range(first, first + count):
        R = Rotation.from_rotvec([0.0, 0.0, 0.1 * k]).as_matrix()
        part.add(k, seen, (R, ORIGIN), np.arange(12))
    return part


@pytest.mark.parametrize(("yaw", "doubtful"), [(0.8, False), (2.0, True), (np.pi, True)])
def test_a_leap_far_beyond_the_fastest_step_is_not_accepted(yaw: float, doubtful: bool) -> None:
    part = carried(7)
    planes = part.all_planes()
    assert is_doubtful(placed(yaw), part.seen[0], planes, part, 1) is doubtful
    # How fast the sensor turns is not known yet.
    part = carried(3)
    assert not is_doubtful(placed(np.pi), part.seen[0], planes, part, 1)


@pytest.mark.parametrize(
    ("planes", "way_m", "doubtful"), [(4, 1.5, True), (4, 0.5, False), (5, 1.5, False)]
)
def test_a_scan_that_jumps_needs_several_planes(planes: int, way_m: float, doubtful: bool) -> None:
    part = carried(7)
    there = replace(placed(0.6), t=np.array([way_m, 0.0, 0.0]), match=np.arange(planes))
    assert is_doubtful(there, part.seen[0], part.all_planes(), part, 1) is doubtful


@pytest.mark.parametrize(
    ("first", "yaw", "share", "shared", "doubtful"),
    [
        (4, 0.0, 0.6, 5, False),
        (4, 1.5, 1.0, 5, True),
        (9, 0.0, 0.6, 7, True),
        (9, 0.0, 0.9, 7, False),
        # Rooms have six sides, and look much the same after half a turn.
        (9, 0.0, 0.9, 6, True),
    ],
)
def test_submaps_are_tied_near_in_time_or_if_they_show_the_same(
    first: int, yaw: float, share: float, shared: int, doubtful: bool
) -> None:
    part = replace(placed(yaw, share), match=np.arange(shared))
    assert is_tied_doubtfully(part, carried(4, first), carried(4)) is doubtful


def passed(first: int, *walls: Floats) -> Submap:
    """Return a submap of four scans that pass walls."""
    part = Submap()
    for k in range(4):
        at = np.array([0.1 * k, 0.0, 0.0])
        seen = with_ends(patches(*(each - at for each in walls)))
        part.add(first + k, seen, (STILL, at), np.arange(len(walls)))
    return part


@pytest.mark.parametrize(
    ("first", "screens", "doubtful"),
    [(9, 0, False), (9, 1, True), (5, 1, False), (5, 4, True)],
)
def test_scans_that_see_through_another_submap_are_not_tied_to_it_less_so_near_in_time(
    first: int, screens: int, doubtful: bool
) -> None:
    room = [wall(axis, at) for axis in range(3) for at in (-3.0, 3.0)]
    there = placed(0.0, 0.9)
    screen = [wall(axis, at, (-1.5, 1.5)) for axis in (0, 1) for at in (2.0, -2.0)]
    part = passed(first, *room, *screen[:screens])
    assert is_tied_doubtfully(there, part, passed(0, *room)) is doubtful


@pytest.mark.parametrize(("shared", "doubtful"), [(11, True), (12, False)])
def test_a_jump_between_submaps_needs_more_planes(shared: int, doubtful: bool) -> None:
    seen = patches(*(wall(axis, at) for axis in range(3) for at in (-3.0, 3.0)))
    parts = Submap(), Submap()
    for k in range(6):
        R = Rotation.from_rotvec([0.0, 0.0, 0.5 * k]).as_matrix()
        parts[k // 3].add(k, seen, (R, np.array([0.2 * k, 0.0, 0.0])), np.arange(6))
    for way, expected in ((0.0, False), (1.0, doubtful)):
        there = Placed(STILL, np.array([way, 0.0, 0.0]), np.arange(shared), 1.0, None, False)
        assert is_tied_doubtfully(there, parts[1], parts[0]) is expected


@pytest.mark.parametrize(("at", "least", "most"), [(3.0, 0, 0), (4.0, 0, 0), (1.5, 0.6, 1)])
def test_a_scan_sees_no_surface_through_another(at: float, least: float, most: float) -> None:
    there = part_of((patches(wall(0, at)), [0])).all_planes()
    share = seen_through((STILL, ORIGIN), with_ends(patches(wall(0, 3.0))), there)
    assert least <= share <= most


def test_a_scan_that_sees_through_the_map_begins_a_submap() -> None:
    sides: list[Floats] = [wall(0, 3.0), wall(1, 3.0), wall(2, 3.0)]
    screen = wall(0, 2.0, (-1.5, 1.5))
    mapper = fed(Plane3dMapper(), (patches(*sides, screen) for _ in range(3)))
    mapper.update(patches(*sides))
    assert [len(part.iteration) for part in mapper.submaps] == [3, 1]


@pytest.mark.parametrize(
    ("best", "other", "rival"), [(18, 12, False), (18, 14, True), (8, 4, True)]
)
def test_of_many_planes_a_rival_matches_most(best: int, other: int, rival: bool) -> None:
    first, second = (
        Placed(STILL, ORIGIN, np.arange(count), share, None, False)
        for count, share in ((best, 0.87), (other, 0.79))
    )
    assert is_rival(second, first) is rival


def test_clutter_that_passed_for_a_plane_does_not_take_planes_within_it() -> None:
    planes = part_of((patches(wall(0, 3.012)), [0]), (patches(wall(0, 3.1)), [1])).all_planes()
    planes.spread[1, 2] = 0.2
    near = np.ones((1, 2), dtype=bool)
    match, _ = matched(STILL, ORIGIN, patches(wall(0, 3.0)), planes, near, loose=1.0)
    assert match.tolist() == [0]


def test_the_way_between_two_parts_of_a_path_is_not_drawn_nor_counted() -> None:
    seen = patches(*(wall(axis, at) for axis in range(3) for at in (-3.0, 3.0)))
    part = Submap()
    for k, x in [(0, 0.0), (1, 0.1), (2, 0.2), (9, 1.7), (10, 1.8), (11, 1.9)]:
        part.add(k, seen, (STILL, np.array([x, 0.0, 0.0])), np.arange(6))
    assert submap_row(part, 0)["metres"] == pytest.approx(0.4)
    stamps_s, weak = np.array(part.iteration, dtype=np.float64), np.array([], dtype=np.int64)
    figure = plot_planes3d(plane_table([part], True), part.trajectory, stamps_s, weak)
    drawn = [line.get_xdata() for line in figure.axes[1].lines]
    assert max(np.nanmax(np.abs(np.diff(x)), initial=0.0) for x in drawn) < 0.2


def test_headings_of_the_picture_are_inside_of_it() -> None:
    # The panel from above is square, and as high as the picture allows.
    square, part = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]]), Submap()
    corners = np.insert(square, 2, 0.0, axis=1)
    for k in range(2):
        seen = patches(wall(2, -1.0), wall(0, 3.0), wall(1, 3.0))
        part.add(k, seen, (STILL, np.array([0.1 * k, 0.0, 0.0])), np.arange(3))
    planes = replace(plane_table([part], True), outline=[corners] * 3)
    figure = plot_planes3d(planes, part.trajectory, np.arange(2.0), np.arange(0))
    figure.draw_without_rendering()  # as when it is saved
    for axes in figure.axes:
        assert axes.title.get_window_extent().y1 < figure.bbox.y1
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["path of the sensor"]
    marked = plot_planes3d(planes, part.trajectory, np.arange(2.0), np.arange(1), 3)
    assert marked.axes[0].get_title() == "the first of 3 submaps: 3 planes, 2 scans"
    assert "pose partly undetermined" in [t.get_text() for t in marked.legends[0].get_texts()]
    space: Any = figure.axes[0]
    for axis in (space.xaxis, space.yaxis):
        numbers = [label.get_window_extent() for label in axis.get_ticklabels()]
        assert not any(axis.label.get_window_extent().overlaps(number) for number in numbers)


@pytest.mark.parametrize("seed", [33, 39, 41])
def test_a_scan_does_not_follow_a_box_that_moves_before_a_wall(seed: int) -> None:
    # A box that is nearer, and so more accurate, than the wall behind it.
    world = simulate_storey("depth", 0.005, 30, seed, moving=2)
    mapper = Plane3dMapper()
    for scan in world.scans:
        mapper.update(scan)
    assert len(mapper.submaps[0].iteration) > 20
    for part in mapper.submaps:
        steps, truly = (
            np.linalg.inv(path[:-1]) @ path[1:]
            for path in (part.trajectory, world.trajectory[part.iteration])
        )
        assert np.linalg.norm((steps - truly)[:, :3, 3], axis=1).max(initial=0.0) < 0.1


def test_what_moves_holds_no_scan_of_a_refined_map() -> None:
    # For some scans a box alone shows well how far the sensor went; the last ones see no end.
    world = simulate_storey("depth", 0.005, 60, 1, moving=2)
    mapper = Plane3dMapper()
    for scan in world.scans:
        mapper.update(scan)
    mapper.finish()
    mapper.refine()
    assert (mapper.planes.status == "dynamic").sum() > 5
    assert ate(mapper.trajectory, world.trajectory, False) < 0.005


def photographed(place_m: list[float], angles: list[float], share: float, seed: int) -> Floats:
    """Return the points of a depth camera in a house with a box this far along its track."""
    rooms, rng = house(2), np.random.default_rng(seed)
    origin, sides = moving_box(rooms.tracks[0], share)
    row, column = np.mgrid[:ROWS, :COLUMNS]
    across, up = (COLUMNS - 1) / 2 - column, (ROWS - 1) / 2 - row
    rays = np.stack([np.full(row.shape, FOCAL), across, up], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    faces = np.concatenate([rooms.origin, origin]), np.concatenate([rooms.sides, sides])
    R = Rotation.from_euler("ZYX", angles).as_matrix()
    depth_m = cast_rays(np.array(place_m), rays @ R.T, *faces)[0]
    noise = 0.005 * (depth_m * rays[:, 0] / 2) ** 2 * rng.standard_normal(len(rays))
    return np.asarray((depth_m + noise)[:, None] * rays)


@pytest.mark.parametrize(
    ("share", "step_m", "seed"), [(0.65, 0.13, 2), (0.8, 0.13, 2), (0.8, 0.155, 4)]
)
def test_the_wall_behind_a_box_counts_by_the_fit_to_it(
    share: float, step_m: float, seed: int
) -> None:
    # A fit that begins at the box ends at the wall, but seems to explain less of the scan.
    mapper = Plane3dMapper()
    mapper.update(photographed([1.889, 2.079, 1.311], [0.723, 0.0, 0.0], share, seed))
    there = [1.951, 2.133, 1.318], [0.7536, 0.0327, 0.035]
    mapper.update(photographed(*there, share + step_m / 5.0, seed + 1))
    R = Rotation.from_euler("ZYX", [0.723, 0.0, 0.0]).as_matrix()
    truly = np.array([0.062, 0.054, 0.007]) @ R
    assert np.linalg.norm(mapper.trajectory[1, :3, 3] - truly) < 0.02


def narrow(*more: Floats) -> list[Floats]:
    """Return the six sides of a room, and other planes."""
    ends = (0, 1.0), (0, -1.4), (1, 0.7), (1, -0.9), (2, -1.2), (2, 1.3)
    return [*(wall(axis, at) for axis, at in ends), *more]


def found(yaw: float, *more: Floats, **given: Any) -> Placed | None:
    """Return the placement of a scan that is turned in a narrow room with a table."""
    segmenter, held = PatchSegmenter(), Held(ORIGIN, np.inf)
    there = segmenter.fit(np.concatenate(narrow(TABLE))).patches_
    R = Rotation.from_rotvec([0.0, 0.0, yaw]).as_matrix()
    seen = segmenter.fit(np.concatenate(narrow(*more)) @ R).patches_
    return place(seen, there, (STILL, ORIGIN), held, **given)


def test_a_turn_in_a_narrow_room_is_accepted_if_seven_planes_match() -> None:
    placed = found(1.2, TABLE, wall(0, 2.5), wall(1, 2.0))
    assert placed.share < 0.85
    assert apart(placed.R, placed.t, STILL, ORIGIN)[0] == pytest.approx(1.2, abs=0.02)


def test_instead_of_a_doubtful_placement_one_that_matches_more_planes_is_taken() -> None:
    turns = []
    for least in (0, 7):
        placed = found(np.pi, TABLE, is_doubtful=lambda each, n=least: each.n_planes < n)
        turns.append(apart(placed.R, placed.t, STILL, ORIGIN)[0])
    assert turns == pytest.approx([0.0, np.pi], abs=0.02)


def test_a_scan_after_one_from_close_by_is_placed_as_fast() -> None:
    mapper, cloud = Plane3dMapper(), np.concatenate(narrow(TABLE))
    mapper.update(cloud)
    mapper.update(0.02 * cloud)
    began = process_time()
    mapper.update(cloud)
    assert process_time() - began < 5.0
    assert [part.iteration for part in mapper.submaps] == [[0], [1], [2]]
