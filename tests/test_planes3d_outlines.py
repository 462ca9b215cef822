"""Outlines of planes in space end in straight edges where planes meet."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from relmap import Plane3dMapper
from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes3d.outlines import ENDS, UNSEEN, Surface, surfaces_of
from relmap.segmentation.space import Patches, PatchSegmenter

STEP_M = 0.05


def rectangle(corner: list[float], u: list[float], v: list[float]) -> Floats:
    """Return points that fill a rectangle evenly, with a margin of half of their distance."""
    sides = np.array([u, v])
    counts = np.round(np.linalg.norm(sides, axis=1) / STEP_M).astype(int)
    a, b = (
        axis.ravel() for axis in np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts.tolist()))
    )
    return np.asarray(corner + a[:, None] * sides[0] + b[:, None] * sides[1])


BOX = [
    rectangle([-3, -2, -1], [6, 0, 0], [0, 4, 0]),  # floor
    rectangle([-3, -2, -1], [6, 0, 0], [0, 0, 2]),  # walls
    rectangle([-3, 2, -1], [6, 0, 0], [0, 0, 2]),
    rectangle([-3, -2, -1], [0, 4, 0], [0, 0, 2]),
    rectangle([3, -2, -1], [0, 4, 0], [0, 0, 2]),
]


def surfaces(*faces: Floats, panel: Floats | None = None) -> tuple[list[Surface], Patches]:
    """Return the surfaces of faces that several scans saw, in the frame of the first.

    `panel`: points of a rectangle x = constant that hides what is behind it.
    """
    mapper = Plane3dMapper(PatchSegmenter(voxel_m=0.2))
    for way in np.linspace(0, 1, 12):
        seen, place = np.concatenate(faces), way * np.array([0.23, 0.31, 0.19])
        if panel is not None:
            seen = np.concatenate([seen[~is_behind(panel, seen, place)], panel])
        mapper.update(seen - place)
    assert len(mapper.submaps) == 1
    planes = mapper.submaps[0].all_planes()
    return surfaces_of(planes, np.arange(len(planes))), planes


def is_behind(panel: Floats, points: Floats, place: Floats) -> Bools:
    """Return which points (n, 3) a panel hides from a place (3,)."""
    depth = points[:, 0] - place[0]
    beyond = depth > panel[0, 0] - place[0] + 1e-9
    share = (panel[0, 0] - place[0]) / np.where(beyond, depth, 1.0)
    at = place + share[:, None] * (points - place)
    inside = (at >= panel.min(axis=0)) & (at <= panel.max(axis=0))
    return np.asarray(beyond & inside[:, 1:].all(axis=1))


def one_facing(planes: Patches, normal: list[float], offset_m: float) -> int:
    off = np.abs(planes.normal - normal).max(axis=1) + np.abs(planes.offset - offset_m)
    assert off.min() < 1e-6
    return int(np.argmin(off))


def area_m2(outline: Floats, normal: Floats) -> float:
    cross = np.cross(outline, np.roll(outline, -1, axis=0)).sum(axis=0)
    return float(cross @ normal / 2)


def test_the_floor_of_a_room_is_a_rectangle_and_names_its_walls() -> None:
    found, planes = surfaces(*BOX)
    floor = one_facing(planes, [0, 0, 1], -1.0)
    outline, meets = found[floor].outline()
    assert area_m2(outline, planes.normal[floor]) == pytest.approx(24.0, rel=0.01)
    assert sorted(set(meets.tolist()) - {UNSEEN}) == sorted(set(range(5)) - {floor})
    for begin, end, other in zip(outline, np.roll(outline, -1, axis=0), meets, strict=True):
        if other >= 0:  # both ends are on the wall
            for point in (begin, end):
                assert abs(planes.normal[other] @ point - planes.offset[other]) < 1e-6
    length_m = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)
    assert length_m[meets >= 0].sum() > 0.95 * 20.0


def test_the_open_side_of_a_wall_is_not_an_edge() -> None:
    found, planes = surfaces(*BOX)
    wall = one_facing(planes, [0, 1, 0], -2.0)
    outline, meets = found[wall].outline()
    top = outline[:, 2] > 0.7
    assert (meets[top & np.roll(top, -1)] == UNSEEN).all()
    # It was seen up to 1 m; the outline is that of squares of 0.2 m.
    assert outline[:, 2].max() == pytest.approx(1.0, abs=0.2)
    assert outline[:, 2].min() == pytest.approx(-1.0, abs=1e-6)


def test_a_partition_does_not_cut_the_floor_on_which_it_stands() -> None:
    partition = rectangle([1, -1, -1], [0, 2, 0], [0, 0, 1.5])
    found, planes = surfaces(*BOX, partition)
    floor = one_facing(planes, [0, 0, 1], -1.0)
    middle = int(np.argmin(np.abs(planes.centre - [1, 0, -0.25]).sum(axis=1)))
    outline, meets = found[floor].outline()
    assert area_m2(outline, planes.normal[floor]) == pytest.approx(24.0, rel=0.01)
    assert middle not in meets
    assert floor in found[middle].outline()[1]


def test_a_floor_of_two_parts_keeps_its_concave_corner() -> None:
    # An L: the walls of the notch meet the floor, and the floor goes on beside them.
    floor = [
        rectangle([-3, -2, -1], [6, 0, 0], [0, 3, 0]),
        rectangle([-3, 1, -1], [4, 0, 0], [0, 1, 0]),
    ]
    notch = [
        rectangle([1, 1, -1], [0, 1, 0], [0, 0, 2]),
        rectangle([1, 1, -1], [2, 0, 0], [0, 0, 2]),
    ]
    found, planes = surfaces(*floor, *BOX[1:2], BOX[3], *notch)
    k = one_facing(planes, [0, 0, 1], -1.0)
    outline, _ = found[k].outline()
    assert area_m2(outline, planes.normal[k]) == pytest.approx(22.0, rel=0.03)
    corner_m = np.linalg.norm(outline - [1, 1, -1], axis=1)
    assert corner_m.min() < 0.2  # a voxel


def test_polygons_cover_what_the_outline_encloses() -> None:
    found, planes = surfaces(*BOX)
    for surface, normal in zip(found, planes.normal, strict=True):
        outline, _ = surface.outline()
        whole = sum(abs(area_m2(each, normal)) for each in surface.polygons())
        assert whole == pytest.approx(area_m2(outline, normal), abs=0.05)
        for polygon in surface.polygons():
            sides = np.diff(np.concatenate([polygon, polygon[:2]]), axis=0)
            turns = [np.cross(a, b) @ normal for a, b in pairwise(sides)]
            assert min(turns) > -1e-9 or max(turns) < 1e-9  # convex


def test_a_small_plane_on_a_line_is_not_cut_away() -> None:
    rail = rectangle([-1, 0, -1], [2, 0, 0], [0, 0.35, 0.35])
    found, planes = surfaces(*BOX, rail)
    tilted = int(np.argmin(np.abs(np.abs(planes.normal[:, 1]) - np.sqrt(0.5))))
    outline, _ = found[tilted].outline()
    assert abs(area_m2(outline, planes.normal[tilted])) > 0.5


def meeting(surface: Surface) -> Ints:
    return np.unique(surface.outline()[1])


def test_the_order_of_planes_does_not_matter() -> None:
    found, planes = surfaces(*BOX)
    back, reversed_planes = surfaces(*BOX[::-1])
    for k, surface in enumerate(found):
        other = one_facing(reversed_planes, planes.normal[k].tolist(), float(planes.offset[k]))
        assert len(meeting(surface)) == len(meeting(back[other]))


def test_a_panel_ends_where_scans_see_past_it() -> None:
    # It stands on the floor; above and beside it the walls behind are seen. These and the floor do
    # not end in its shadow.
    panel = rectangle([1.5, -1, -1], [0, 2, 0], [0, 0, 1.2])
    found, planes = surfaces(*BOX, panel=panel)
    middle = one_facing(planes, [-1, 0, 0], -1.5)
    outline, meets = found[middle].outline()
    length_m = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)
    assert length_m[meets < 0].sum() > 4.0
    assert length_m[meets == ENDS].sum() > 0.9 * length_m[meets < 0].sum()
    for face in set(range(len(planes))) - {middle}:
        assert ENDS not in found[face].outline()[1]


def test_the_only_plane_of_a_submap_may_end() -> None:
    # Too few rays for a plane end behind it.
    panel = rectangle([1.0, -0.5, -0.5], [0, 1, 0], [0, 0, 1])
    beyond = np.random.default_rng(0).uniform([1.0, -0.9, -0.9], [1.0, 0.9, 0.9], (350, 3))
    beyond = 3.0 * beyond[(np.abs(beyond[:, 1:]) > 0.55).any(axis=1)]
    mapper = Plane3dMapper(PatchSegmenter(voxel_m=0.2, min_points=300))
    assert mapper.update(np.concatenate([panel, beyond])).tolist() == [0]
    assert (mapper.planes.meets[0] == ENDS).any()
