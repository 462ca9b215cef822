"""Submaps that show the same place become one; those that only look alike do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats, Ints
from relmap.planes import mapper as planes_mapper
from relmap.planes.places import submap_ties
from relmap.planes.places.map_part import MapPart
from relmap.planes.places.submap_ties import tied_parts
from relmap.planes.places.wall_tie import WallPoints, WallTie
from relmap.planes.places.wall_tie_kernels import fit
from relmap.planes.scans.beam_store import PlacedBeams
from relmap.planes.submaps.submap import WallSubmap, torn_in
from relmap.planes.walls.history import PlaneHistory
from tests.segments import cast
from tests.test_scan_breaks import driven, scans_of
from tests.worlds import ate_m

ROOM = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 3.0], [4.0, 3.0], [4.0, 4.0], [0.0, 4.0]])
"""A room with a niche, without symmetry."""
OBLIQUE = np.array([[0.02, 0.03], [7.0, -1.1], [9.5, 3.2], [6.1, 7.3], [3.1, 5.2], [-1.5, 6.1]])
"""A room whose walls fit no other ones at all."""
R, T = np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([7.0, -3.0])


def part_of(number: int, corners: Floats, sensors: Floats, moved: bool = False) -> MapPart:
    """Return a room with these corners, counterclockwise, and beams all round from sensors."""
    ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    bearing = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    stops = [
        at + cast(ends - at, angle)[0] * np.array([np.cos(angle), np.sin(angle)])
        for at in sensors
        for angle in bearing
    ]
    begins, stops_there = np.repeat(sensors, len(bearing), axis=0), np.array(stops)
    if moved:
        ends, begins, stops_there = ((each - T) @ R for each in (ends, begins, stops_there))
    beams = PlacedBeams(begins, stops_there, np.repeat(np.arange(len(sensors)), len(bearing)))
    on_the_way = (sensors - T) @ R if moved else sensors
    path = np.column_stack([100 * number + np.arange(len(sensors)), on_the_way])
    return MapPart.of(number, ends, 100 * number + np.arange(len(ends)), beams, path)


INSIDE = np.array([[1.0, 1.0], [3.0, 2.0], [5.0, 2.0]])


def test_one_room_in_two_frames_is_one() -> None:
    (joined,) = tied_parts([part_of(0, ROOM, INSIDE), part_of(1, ROOM, INSIDE, moved=True)])
    (first, own), (second, motion) = joined.members
    assert (first, second) == (0, 1)
    np.testing.assert_array_equal(own, np.eye(4))
    np.testing.assert_allclose(motion[:2, :2], R, atol=1e-6)
    np.testing.assert_allclose(motion[:2, 3], T, atol=1e-6)
    assert {(100 + k, k) for k in range(6)} <= {tuple(sorted(p)[::-1]) for p in joined.same}


def test_a_square_room_fits_itself_in_four_ways() -> None:
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    inside = np.array([[1.0, 1.0], [3.0, 2.0]])
    assert len(tied_parts([part_of(0, square, inside), part_of(1, square, inside, True)])) == 2


def test_a_round_room_fits_itself_after_any_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its walls coincide after one turn only, but beams end near them after others as well."""
    bearing = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    radius_m = 5.0 + np.random.default_rng(0).uniform(-0.3, 0.3, (12, 1))
    corners = radius_m * np.column_stack([np.cos(bearing), np.sin(bearing)])
    parts = [part_of(k, corners, INSIDE - 3.0, moved=bool(k)) for k in range(2)]
    assert len(tied_parts(parts)) == 2
    monkeypatch.setattr(submap_ties, "TURNS_RAD", np.empty(0))
    assert len(tied_parts(parts)) == 1


def test_beams_that_pass_through_a_wall_contradict() -> None:
    """The same room, but one end of it stands open for 3 m."""
    longer = ROOM.copy()
    longer[1:3, 0] = 9.0
    parts = [part_of(0, ROOM, INSIDE), part_of(1, longer, INSIDE, moved=True)]
    assert len(tied_parts(parts)) == 2


def test_bends_of_bare_corridors_are_not_joined() -> None:
    """Four walls are too few: with the ends of the corridors in view, the same bends are one."""
    bend = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [8.0, 10.0], [8.0, 2.0], [0.0, 2.0]])
    inside = np.array([[2.0, 1.0], [9.0, 1.0], [9.0, 8.0]])
    parts = [part_of(0, bend, inside), part_of(1, bend, inside, moved=True)]
    assert len(tied_parts(parts)) == 1
    bare = [0, 1, 3, 4]
    parts = [replace(part, ends=part.ends[bare], walls=part.walls[bare]) for part in parts]
    assert len(tied_parts(parts)) == 2


def test_along_a_bare_corridor_a_fit_does_not_slide() -> None:
    # It is narrower in the other map, and narrows by 0.3 degrees: 20 m away it would fit exactly.
    ends = np.array([[[0.0, -1.0], [20.0, -1.0]], [[20.0, 1.0], [0.0, 1.0]]])
    bent = ends + np.array([[[0.0, 0.0], [0.0, 0.05]], [[0.0, -0.05], [0.0, 0.0]]])
    points, among = WallPoints.of(ends), WallPoints.of(bent)
    motion = np.array([1.0, 0.0, 0.0, 0.0])
    n, across, _ = fit((points.at, points.normal), among.near, motion, np.full(9, 0.3))
    assert n == len(points.at)
    assert across < 0.01
    assert np.abs(motion[2:]).max() < 0.2


def corridor_past(doors_m: Floats) -> Floats:
    """Return the corners (c, 2) of a corridor of 60 m with niches that begin at these places."""
    below = [
        [[x, 0.0], [x, -0.3], [x + 0.9, -0.3], [x + 0.9, 0.0]]
        for x in np.sort(doors_m[::2]).tolist()
    ]
    above = [
        [[x + 0.9, 2.4], [x + 0.9, 2.7], [x, 2.7], [x, 2.4]]
        for x in np.sort(doors_m[1::2])[::-1].tolist()
    ]
    ends = np.array([[0.0, 0.0]]), np.array([[60.0, 0.0], [60.0, 2.4]]), np.array([[0.0, 2.4]])
    return np.concatenate([ends[0], *map(np.array, below), ends[1], *map(np.array, above), ends[2]])


def test_a_corridor_is_placed_by_its_doors() -> None:
    """Most of its walls also fit one or two doors further, but the ends of few walls do."""
    rng, sensors = np.random.default_rng(0), np.column_stack([np.arange(2.0, 59, 4), np.ones(15)])
    uneven = np.cumsum(rng.uniform(1.2, 2.6, 30))
    parts = [part_of(k, corridor_past(uneven), sensors, moved=bool(k)) for k in range(2)]
    (joined,) = tied_parts(parts)
    np.testing.assert_allclose(joined.members[1][1][:2, 3], T, atol=1e-3)
    even = corridor_past(np.arange(1.0, 58, 2))
    assert len(tied_parts([part_of(k, even, sensors, moved=bool(k)) for k in range(2)])) == 2


def corridor_with_rooms(number: int, open_m: Sequence[float]) -> MapPart:
    """Return a corridor with niches, and three doors: open to a room, or shut and not mapped."""
    depth_m = dict.fromkeys((3.0, 8.5, 18.7), 0.3) | dict.fromkeys((5.5, 11.0, 21.0), 0.1)
    depth_m |= dict.fromkeys(open_m, 3.0)
    below = [
        [[x, 0.0], [x, -depth], [x + 0.9, -depth], [x + 0.9, 0.0]]
        for x, depth in sorted(depth_m.items())
    ]
    end = [[24.0, 0.0], [24.0, 2.4], [15.0, 2.4], [15.0, 4.0], [13.0, 4.0], [13.0, 2.4], [0.0, 2.4]]
    sensors = np.column_stack([np.arange(1.0, 24.0), np.ones(23)])
    part = part_of(number, np.concatenate([[[0.0, 0.0]], *below, end]), sensors)
    mapped = (part.ends[:, :, 1] != -0.1).all(axis=1)
    return replace(part, ends=part.ends[mapped], walls=part.walls[mapped])


@pytest.mark.parametrize(
    ("open_m", "others_m", "n_maps"), [([], [], 1), ([5.5], [], 1), ([5.5], [11.0], 2)]
)
def test_corridors_whose_doors_differ_are_two(
    open_m: list[float], others_m: list[float], n_maps: int
) -> None:
    """Their walls are equal, and no beam passes through one; one door may have been opened."""
    parts = [corridor_with_rooms(0, open_m), corridor_with_rooms(1, others_m)]
    assert len(tied_parts(parts)) == n_maps


@pytest.mark.parametrize(
    ("walls", "ends", "n_maps", "n_hardly_contradicted"),
    [(14, 7, 2, 2), (13, 9, 2, 1), (16, 9, 2, 2), (23, 13, 2, 1), (12, 10, 1, 1), (30, 38, 1, 1)],
)
def test_ends_that_coincide_by_chance_do_not_join(
    monkeypatch: pytest.MonkeyPatch, walls: int, ends: int, n_maps: int, n_hardly_contradicted: int
) -> None:
    """Numbers from simulated corridors with doors; wrong alignments were up to 54 m off."""
    monkeypatch.setattr(submap_ties, "coinciding_ends", lambda *_: (walls, ends))
    same = [part_of(0, OBLIQUE, INSIDE), part_of(1, OBLIQUE, INSIDE, True)]
    assert len(tied_parts(same)) == n_hardly_contradicted
    monkeypatch.setattr(submap_ties, "HARDLY", -1.0)
    assert len(tied_parts(same)) == n_maps


def test_fewer_ends_suffice_only_where_no_other_alignment_is_supported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A simulated corridor was joined 45 m off, by five ends at six walls."""

    def ends_of(_: Floats, __: Floats, tie: WallTie) -> tuple[int, int]:
        return 13, 9 if np.abs(tie.t - T).max() < 0.1 else 0

    monkeypatch.setattr(submap_ties, "coinciding_ends", ends_of)
    uneven = corridor_past(np.cumsum(np.random.default_rng(0).uniform(1.2, 2.6, 30)))
    sensors = np.column_stack([np.arange(2.0, 59, 4), np.ones(15)])
    for corners, inside, n_maps in ((OBLIQUE, INSIDE, 1), (uneven, sensors, 2)):
        parts = [part_of(k, corners, inside, moved=bool(k)) for k in range(2)]
        assert len(tied_parts(parts)) == n_maps


def with_rooms(number: int, rooms: Sequence[tuple[Floats, Floats]], moved: bool = False) -> MapPart:
    """Return several rooms, each given by its corners and sensors, as one part."""
    parts = [part_of(number, corners, sensors, moved) for corners, sensors in rooms]
    names = ("ends", "begins", "stops", "path")
    ends, begins, stops, path = (np.concatenate([getattr(p, n) for p in parts]) for n in names)
    path[:, 0] = 100 * number + np.arange(len(path))
    beams = PlacedBeams(begins, stops, np.zeros(len(begins), dtype=np.int64))
    return MapPart.of(number, ends, 100 * number + np.arange(len(ends)), beams, path)


def test_a_room_that_each_of_two_joined_parts_has_once_is_not_placed() -> None:
    hall = np.array([[20, 0], [29, 0], [29, 5], [27, 5], [27, 7], [24, 7], [24, 6], [20, 6.0]])
    yard = np.array([[40, 0], [47, 0], [47, 2], [50, 2], [50, 8], [44, 8], [44, 7], [40, 7.0]])
    both = [(hall, INSIDE + np.array([21.0, 1.0])), (yard, INSIDE + np.array([40.5, 1.0]))]
    far = np.array([100.0, 0.0])
    parts = [
        with_rooms(0, [(ROOM, INSIDE), *both]),
        with_rooms(1, [*both, (ROOM + far, INSIDE + far)], moved=True),
        with_rooms(2, [(ROOM, INSIDE)]),
    ]
    for pair in (parts[:2], parts[::2], parts[1:]):
        assert len(tied_parts(pair)) == 1
    assert [len(part.members) for part in tied_parts(parts)] == [2, 1]


def known_of(mapper: PlaneMapper) -> list[list[int]]:
    """Return the scans of each submap."""
    return [
        (submap.span[0] + np.flatnonzero(np.isfinite(submap.poses[:, 0, 0]))).tolist()
        for submap in mapper.submaps
    ]


def test_a_place_seen_again_after_a_jump_is_joined(tmp_path: Path) -> None:
    """Scans of another place in between stay a separate submap."""
    (log, scans), (_, foreign) = scans_of(0), scans_of(0, world="panels")
    mapper = driven(log, scans[:35] + foreign[20:35] + scans[5:40])
    again = [*range(35), *range(50, 85)]
    assert sorted(known_of(mapper)) == [again[:35], list(range(35, 50)), again[35:]]
    mapper.save(tmp_path / "mapper.npz")
    mapper.refine()
    assert sorted(known_of(mapper)) == [again, list(range(35, 50))]
    assert ate_m(mapper.trajectory[again], log.poses[[*range(35), *range(5, 40)]]) < 0.02
    same = PlaneMapper.load(tmp_path / "mapper.npz")
    same.refine()
    np.testing.assert_array_equal(same.trajectory, mapper.trajectory)
    mapper.refine()
    assert sorted(known_of(mapper)) == [again, list(range(35, 50))]


def test_if_a_joined_map_tears_its_parts_are_cut_and_joined_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Cutting the joined map would separate the scans before a tear from all later ones."""
    (log, scans), (_, foreign) = scans_of(0), scans_of(0, world="panels")
    mapper, told = driven(log, scans[:35] + foreign[20:35] + scans[5:40]), list[int]()

    def torn_once(submaps: list[WallSubmap], history: PlaneHistory) -> Ints:
        if told or history.submap[0] != history.submap[-1]:
            return torn_in(submaps, history)
        told.append(30)
        return np.array(told)

    monkeypatch.setattr(planes_mapper, "torn_in", torn_once)
    mapper.refine()
    assert told == [30]
    assert sorted(known_of(mapper)) == [[*range(35), *range(50, 85)], list(range(35, 50))]


@pytest.mark.parametrize("seed", [0, 1])
def test_two_buildings_stay_apart(seed: int) -> None:
    (log, first), (_, second) = scans_of(seed), scans_of(seed + 2)
    mapper = driven(log, first[:40] + second[:40])
    before = sorted(known_of(mapper))
    mapper.refine()
    assert sorted(known_of(mapper)) == before
