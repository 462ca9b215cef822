"""Steps that the scans do not determine are listed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from relmap.planes import PlaneMapper
from relmap.planes.linking.judging import Candidates
from relmap.planes.linking.registration import PlaneRegistration
from relmap.planes.linking.search import Search
from relmap.planes.motions import from_matrices, inverse
from relmap.planes.places.implied_steps import ImpliedSteps
from relmap.planes.places.map_part import MapPart
from relmap.planes.places.wall_tie import WallTie
from relmap.planes.scans.beam_store import PlacedBeams
from relmap.planes.submaps.doubtful import (
    free_directions,
    undetermined_steps,
    unsupported_links,
)
from tests.worlds import turn

FAR = np.array([[6.0, -0.8], [6.8, 0.0], [7.0, 1.0]])
"""Two walls of a metre that meet at 34 degrees: an arc at the end of the range."""
NEAR = np.array([[1.0, -3.0], [3.0, -3.0], [3.0, -1.0]])
"""Two walls that meet at a right angle, nearby."""
BENT = np.column_stack([np.linspace(1.0, 6.0, 11), -2.5 + 0.15 * (np.arange(11) % 2)])
"""One wall, bent by 0.15 m to and fro."""
ROOM = 2.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
"""Four equal walls around the robot."""
TEETH = np.column_stack([np.linspace(-4.0, 4.0, 9), -4.0 + 0.8 * (np.arange(9) % 2)])
"""A wall that repeats every two metres."""
LEAP = 6
"""The scan after a leap."""


def along(line: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
    """Return points along a line (k, 2)."""
    parts = [
        a + (b - a) * np.arange(0.0, 1.0, spacing_m / np.linalg.norm(b - a))[:, None]
        for a, b in pairwise(line)
    ]
    return np.concatenate(parts)


def driven(
    *lines: NDArray[np.float64], leap_m: float = 0.0, turn_rad: float = 0.0, with_beams: bool = True
) -> PlaneMapper:
    """Return a mapper of walls along lines, whose robot advances by 2 cm a scan, and leaps once.

    There it turns, too; it goes on sideways. The noise of the points is 3 cm.
    """
    mapper, rng = PlaneMapper(), np.random.default_rng(0)
    ends = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    kind = [["corner", "corner"]] * len(ends)
    points = np.concatenate([along(line, 0.1) for line in lines])
    for k, x in enumerate(0.02 * np.arange(12) + leap_m * (np.arange(12) >= LEAP)):
        R = turn(turn_rad * (k >= LEAP))
        seen = SimpleNamespace(ends=(ends - [x, 0.0]) @ R, end_type=kind)
        beams = (points - [x, 0.0]) @ R + rng.normal(0.0, 0.03, points.shape)
        mapper.update(seen, beams=beams if with_beams else None)
    return mapper


def mapped(*lines: NDArray[np.float64], with_beams: bool = True) -> PlaneMapper:
    """Return a finished map in one part."""
    mapper = driven(*lines, with_beams=with_beams)
    mapper.finish()
    assert len(mapper.submaps) == 1
    return mapper


def registration_of(mapper: PlaneMapper) -> PlaneRegistration:
    registration = mapper.engine.association.registration
    assert isinstance(registration, PlaneRegistration)
    return registration


@pytest.mark.parametrize("refine", [False, True])
def test_an_arc_at_the_end_of_the_range_determines_no_step(refine: bool) -> None:
    """The robot may turn about it; its corners and crossing walls alone do not show that."""
    arc, room = mapped(FAR), mapped(FAR, NEAR)
    if refine:
        arc.refine()
        room.refine()
    assert len(room.weak_links) == 0
    assert arc.weak_links.tolist() == list(range(1, 12))
    assert arc.history.weak_links.tolist() == []


def test_a_wall_that_is_bent_determines_no_step_along_it() -> None:
    """Its bends are crossing walls with corners, which the beams confirm."""
    assert mapped(BENT).weak_links.tolist() == list(range(1, 12))


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_the_open_direction_is_that_of_the_corridor(yaw: float) -> None:
    """Without doors, and both ends out of view; the robot is turned by some angle."""
    mapper = PlaneMapper()
    walls = np.array([[[-6.0, -1.5], [6.0, -1.5]], [[6.0, 1.5], [-6.0, 1.5]]])
    mapper.update(SimpleNamespace(ends=walls @ turn(yaw), end_type=[["view", "view"]] * 2))
    (free,) = free_directions(mapper.history)
    np.testing.assert_allclose(np.abs(turn(yaw) @ free[1:]), [1.0, 0.0], atol=1e-3)


def test_each_weak_link_has_a_direction() -> None:
    bent, room = mapped(BENT), mapped(FAR, NEAR)
    assert bent.weak_directions.shape == (len(bent.weak_links), 2) == (11, 2)
    np.testing.assert_allclose(np.linalg.norm(bent.weak_directions, axis=1), 1)
    assert np.abs(bent.weak_directions[:, 0]).min() > 0.9  # along the wall, but for its bends
    assert room.weak_directions.shape == (0, 2)


@pytest.mark.parametrize(("away_m", "weak"), [(0.0, []), (20.0, [LEAP + 1])])
def test_a_submap_continues_where_its_last_scan_shows_the_same(
    away_m: float, weak: list[int]
) -> None:
    mapper = mapped(FAR, NEAR)
    registration, [submap] = registration_of(mapper), mapper.submaps
    assert isinstance(registration, PlaneRegistration)
    poses = submap.poses.copy()
    poses[LEAP - 1 : LEAP + 1] = np.nan
    poses[LEAP + 1 :, 0, 3] += away_m
    parted = replace(submap, poses=poses)
    assert undetermined_steps([parted], mapper.history, registration.links).tolist() == weak


def test_a_step_unlike_those_around_it_must_exclude_theirs() -> None:
    """Along a wall that repeats, standing still agrees as well as a step of its period."""
    mapper = mapped(TEETH)
    registration, [submap] = registration_of(mapper), mapper.submaps
    assert isinstance(registration, PlaneRegistration)
    poses = submap.poses.copy()
    poses[:, 0, 3] += 2.0 * np.arange(12)
    for stands, weak in ((False, []), (True, [LEAP])):
        poses[LEAP:, 0, 3] -= 2.0 * stands
        moved = replace(submap, poses=poses)
        assert undetermined_steps([moved], mapper.history, registration.links).tolist() == weak


@pytest.mark.parametrize("lines", [(TEETH,), (TEETH, FAR)])
def test_a_step_unlike_those_around_it_must_exclude_what_walls_imply_near_theirs(
    lines: tuple[NDArray[np.float64], ...],
) -> None:
    """The robot advances by half a metre more than usual, not by a period less than that."""
    mapper = driven(*lines, leap_m=0.5)
    mapper.finish()
    [submap], links, history = mapper.submaps, registration_of(mapper).links, mapper.history
    assert LEAP not in mapper.weak_links
    assert LEAP not in unsupported_links(history, links)
    poses, motion = submap.poses.copy(), history.motion.copy()
    poses[LEAP:, 0, 3] -= 2.0
    motion[LEAP, 1] += 2.0
    assert LEAP in undetermined_steps([replace(submap, poses=poses)], history, links)
    cut = unsupported_links(replace(history, motion=motion), links)
    assert cut.tolist() == [LEAP] * (len(lines) > 1)  # where beams show which one is right


@pytest.mark.parametrize("is_doubtful", [False, True])
def test_an_unusual_turn_must_exclude_what_walls_imply_nearer_to_the_usual_one(
    monkeypatch: pytest.MonkeyPatch, is_doubtful: bool
) -> None:
    """A square room looks the same from four sides, also where the robot did not turn.

    Motions that too few points support to tie two scans need not be excluded.
    """
    given = Search.candidates

    def candidates(search: Search, guesses: Sequence[NDArray[np.float64]] = ()) -> Candidates:
        found = given(search, guesses)
        return Candidates(*found[:3], found.doubtful | is_doubtful, found.matches)

    monkeypatch.setattr(Search, "candidates", candidates)
    mapper = mapped(ROOM)
    [submap], links = mapper.submaps, registration_of(mapper).links
    assert len(mapper.weak_links) == 0
    poses, R = submap.poses.copy(), np.eye(4)
    R[:2, :2] = turn(np.pi / 2)
    poses[LEAP:] = R @ poses[LEAP:]
    moved = replace(submap, poses=poses)
    assert undetermined_steps([moved], mapper.history, links).tolist() == [LEAP] * (not is_doubtful)


def test_a_link_is_not_cut_for_a_turn_that_walls_leave_open() -> None:
    """A square room does not tell a long step from a longer one with half a turn: it is listed."""
    mapper = driven(ROOM, leap_m=0.5)
    mapper.finish()
    [submap], links, history = mapper.submaps, registration_of(mapper).links, mapper.history
    poses, motion = submap.poses.copy(), history.motion.copy()
    poses[LEAP:] = np.diag([-1.0, -1.0, 1.0, 1.0]) @ poses[LEAP:]
    turned = np.linalg.inv(poses[LEAP - 1]) @ poses[LEAP]
    motion[LEAP] = inverse(from_matrices(turned[None]))[0]
    assert LEAP in undetermined_steps([replace(submap, poses=poses)], history, links)
    assert len(unsupported_links(replace(history, motion=motion), links)) == 0


def test_a_turn_that_beams_confirm_is_determined() -> None:
    cut_corner = np.vstack([ROOM[:3], [[-0.5, 2.0], [-2.0, 0.5]], ROOM[:1]])
    mapper = driven(cut_corner, turn_rad=np.pi / 2)
    mapper.finish()
    step = np.linalg.inv(mapper.trajectory[LEAP - 1]) @ mapper.trajectory[LEAP]
    assert step[1, 0] == pytest.approx(1.0, abs=0.01)
    assert len(mapper.weak_links) == 0


def test_no_small_changes_that_beams_prefer_lead_away_from_a_step() -> None:
    """It is too short by less than the difference that makes a step unusual."""
    mapper = mapped(FAR, NEAR)
    [submap], poses = mapper.submaps, mapper.submaps[0].poses.copy()
    poses[LEAP:, 0, 3] -= 0.28
    links, history = registration_of(mapper).links, mapper.history
    assert len(undetermined_steps([submap], history, links)) == 0
    assert undetermined_steps([replace(submap, poses=poses)], history, links).tolist() == [LEAP]


@pytest.mark.parametrize(("measures", "weak"), [(True, []), (False, [LEAP, LEAP + 1])])
def test_a_scan_that_repeats_the_one_before_it_determines_no_step(
    measures: bool, weak: list[int]
) -> None:
    """The sensor stands still for a scan, or measures the same place anew."""
    mapper, rng = PlaneMapper(), np.random.default_rng(0)
    ends = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in (FAR, NEAR)])
    points = np.concatenate([along(FAR, 0.1), along(NEAR, 0.1)])
    kind = [["corner", "corner"]] * len(ends)
    for k in range(12):
        at = [-0.4 * (k - (k == LEAP)), 0.0]
        if k != LEAP or measures:
            beams = points - at + rng.normal(0.0, 0.03, points.shape)
        mapper.update(SimpleNamespace(ends=ends - at, end_type=kind), beams=beams)
    mapper.finish()
    assert len(mapper.submaps) == 1
    assert mapper.weak_links.tolist() == weak


def test_without_beams_the_walls_decide() -> None:
    assert len(mapped(FAR, with_beams=False).weak_links) == 0


def test_a_link_turned_about_an_arc_is_cut() -> None:
    """The beams prefer another, and the others are steady."""
    mapper, about = driven(FAR), FAR[1]
    links = registration_of(mapper).links
    turned = about - turn(0.06) @ about
    links.motions[LEAP] = 0.06, *(turned - [0.02, 0.0])
    links.evidence[LEAP] = 20.0  # Not evaluated again by `tie`.
    mapper.finish()
    assert [submap.span for submap in mapper.submaps] == [(0, LEAP), (LEAP, 12)]


@pytest.mark.parametrize("leap_m", [1.0, 2.0])
def test_a_link_is_cut_where_beams_prefer_the_usual_step(leap_m: float) -> None:
    """Beams need not tell it from those 0.3 m beside it."""
    mapper = driven(FAR, NEAR)
    links = registration_of(mapper).links
    links.motions[LEAP] = 0.0, -leap_m, 0.0
    links.evidence[LEAP] = 20.0  # Not evaluated again by `tie`.
    mapper.finish()
    assert [submap.span for submap in mapper.submaps] == [(0, LEAP), (LEAP, 12)]


def test_a_leap_that_beams_confirm_is_kept() -> None:
    mapper = driven(FAR, NEAR, leap_m=0.5)
    mapper.finish()
    assert len(mapper.submaps) == 1
    steps = np.diff(mapper.trajectory[:, 0, 3])
    assert abs(steps[LEAP - 1]) == pytest.approx(0.52, abs=0.02)


@pytest.mark.parametrize(("off_m", "refuted"), [(0.0, False), (0.4, False), (5.0, True)])
def test_scans_that_follow_each_other_refute_an_alignment(
    off_m: float, refuted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A part that is bent by decimetres is in place; another room is not."""
    mapper = mapped(FAR, NEAR)
    [submap], links = mapper.submaps, registration_of(mapper).links
    after = np.arange(len(submap.poses)) >= LEAP
    halves = [
        replace(submap, poses=np.where(own[:, None, None], submap.poses, np.nan))
        for own in (~after, after)
    ]
    none = np.empty((0, 2))
    beams = PlacedBeams(none, none, np.empty(0, dtype=np.int64))
    parts = [
        MapPart.of(number, np.empty((0, 2, 2)), np.empty(0, dtype=np.int64), beams, half.path)
        for number, half in enumerate(halves)
    ]
    steps = ImpliedSteps(halves, mapper.history, links)
    tie, back = (WallTie(np.eye(2), np.array([x_m, 0.0]), 10.0) for x_m in (off_m, -off_m))
    assert steps.refute(parts[0], parts[1], tie) == refuted
    assert steps.refute(parts[1], parts[0], back) == refuted
    scans = replace(links.scans, begun=np.array([LEAP]))  # another log begins anywhere
    monkeypatch.setattr(type(links), "scans", property(lambda _: scans))
    assert not ImpliedSteps(halves, mapper.history, links).refute(parts[0], parts[1], tie)
