"""Links between laser scans: motions from walls, verified by beams."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.planes.linking import guess_kernels, scan_comparison
from relmap.planes.linking.judging import View
from relmap.planes.linking.placement import STILL, PlaneTracks
from relmap.planes.linking.scan_comparison import SLIDE_STEP
from relmap.planes.linking.search import Search
from relmap.planes.motions import inverse
from relmap.planes.scans.beams import NEAR_M, Beams, GivenBeams, compared, odds_over
from relmap.planes.scans.observation import PlaneObservation, checked_planes

# A room with a bay, seen from inside; one wall after another, counter-clockwise.
CORNERS = np.array([[4, -3], [4, 2], [1.5, 2], [1.5, 3.5], [-3, 3.5], [-3, -3]], dtype=np.float64)


def cast(corners: Floats, pose: tuple[float, float, float]) -> Floats:
    """Return where 361 beams over a half circle end, robot frame; x, y, yaw of the robot."""
    x, y, yaw = pose
    bearing = np.linspace(-np.pi / 2, np.pi / 2, 361)
    u = np.column_stack([np.cos(bearing + yaw), np.sin(bearing + yaw)])
    nearest = np.full(len(u), np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        A = np.stack([u, np.broadcast_to(a - b, u.shape)], axis=2)
        hit = np.abs(np.linalg.det(A)) > 1e-9
        r, s = np.linalg.solve(A[hit], np.tile((a - [x, y])[:, None], (hit.sum(), 1, 1)))[..., 0].T
        r = np.where((r > 0) & (s >= -1e-9) & (s <= 1 + 1e-9), r, np.inf)
        nearest[hit] = np.minimum(nearest[hit], r)
    return np.asarray(nearest[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)]))


def motion_between(first: tuple[float, float, float], second: tuple[float, float, float]) -> Floats:
    """Return the motion (3,) from the frame of one pose into that of another."""
    c, s = np.cos(second[2]), np.sin(second[2])
    dx, dy = first[0] - second[0], first[1] - second[1]
    return np.array([first[2] - second[2], c * dx + s * dy, -s * dx + c * dy])


def observed(points: Floats) -> PlaneObservation:
    from relmap.segmentation import PlaneSegmenter

    return checked_planes(PlaneSegmenter(view_rad=np.pi, range_m=20.0).fit(points).planes_, points)


def searched(
    corners: Floats,
    first: tuple[float, float, float],
    second: tuple[float, float, float],
    usual: Floats = STILL,
) -> Any:
    """Search for the motion between two scans of a room."""
    earlier, later = (observed(cast(corners, pose)) for pose in (first, second))
    return link_between(earlier, later, usual)


def link_between(earlier: PlaneObservation, later: PlaneObservation, usual: Floats) -> Any:
    """Search for the motion between two scans."""
    tracks = PlaneTracks.begun(np.arange(len(earlier)), earlier)
    tracks.corner_at = np.where(earlier.static[..., None], earlier.ends, np.nan)
    seen, before = (Beams.of(scan.beams, scan.ends) for scan in (later, earlier))
    return Search(tracks, later, seen, [View(before, np.zeros(3))], usual).found()


def corridor_with_doors(rng: np.random.Generator) -> Floats:
    """Return the corners of a corridor 2.2 m wide, 60 m long, with closed doors 0.1 m deep."""
    sides = []
    for y, deep_m in ((-1.1, -0.1), (1.1, 0.1)):
        at = np.cumsum(rng.uniform(3, 6, 12)) - 30
        x = (at[:, None] + [0, 0, 0.9, 0.9]).ravel()
        sides.append(np.column_stack([x, np.tile([y, y + deep_m, y + deep_m, y], len(at))]))
    ends = [-30, -1.1], [30, -1.1], [30, 1.1], [-30, 1.1]
    return np.vstack([ends[0], sides[0], ends[1], ends[2], sides[1][::-1], ends[3]])


@pytest.mark.parametrize("seed", [0, 3])
def test_jambs_determine_the_first_step_along_a_corridor_after_a_turn(seed: int) -> None:
    """Other motions that walls imply there, the usual turn among them, are excluded by beams."""
    rng = np.random.default_rng(seed)
    corners, poses, scans = corridor_with_doors(rng), ((-5.0, 0.1, 0.01), (-4.5, 0.08, -0.01)), []
    for pose in poses:
        points = cast(corners, pose)[::2]  # one beam a degree
        range_m = np.hypot(*points.T)
        scans.append(observed(points * (1 + rng.normal(0, 0.015, len(points)) / range_m)[:, None]))
    turning = np.array([0.19, -0.05, 0.0])
    found = link_between(scans[0], scans[1], turning)
    assert found.measured
    assert found.motion == pytest.approx(motion_between(*poses), abs=0.05)


def test_beams_agree_with_the_true_motion_alone() -> None:
    poses = (0.0, 0.0, 0.1), (0.4, -0.3, -0.2)
    scans = [cast(CORNERS, pose) for pose in poses]
    ends = np.stack([CORNERS, np.roll(CORNERS, -1, axis=0)], axis=1)
    every = [Beams.of(GivenBeams.checked(points, np.zeros(2)), ends) for points in scans]
    for beams in every:
        beams.solid[:] = True
    right = motion_between(*poses)
    wrong = right + np.array([[0.0, 0.6, 0.0], [0.0, 0.0, -0.6], [0.3, 0.0, 0.0]])
    sums = compared(every[0], every[1], np.concatenate([right[None], wrong]), NEAR_M)
    assert sums.sum(axis=1) == pytest.approx(2 * 361, abs=2 * 361 / 2)
    agree, contradict, _, _ = sums.T
    assert contradict[0] == 0
    assert agree[0] > 0.75 * 2 * 361
    assert (contradict[1:] > 20).all()
    assert (agree[1:] < agree[0]).all()


def in_corridor(at_m: float, ledge_m: float = 0.0) -> Beams:
    """Return a scan in a corridor 2 m wide, the ranges longer where beams graze the walls.

    `ledge_m`: the left wall stands back so much, from 2 to 3 m along the corridor.
    """
    bearing = np.deg2rad(np.arange(-179.5, 180.0))
    range_m = 1.0 / np.abs(np.sin(bearing))
    along_m = at_m + range_m * np.cos(bearing)
    range_m *= 1 + ledge_m * ((along_m > 2) & (along_m < 3) & (bearing > 0))
    range_m += 0.01 * np.abs(np.cos(bearing))
    near = range_m < 5.6
    points = (range_m * [np.cos(bearing), np.sin(bearing)]).T[near]
    solid = np.ones(len(points), dtype=np.bool_)
    return Beams(points, bearing[near], np.zeros(2), solid, ~solid)


@pytest.mark.parametrize(("ledge_m", "is_told"), [(0.0, False), (0.1, True)])
def test_a_bias_of_the_ranges_does_not_make_a_robot_stand_still(
    ledge_m: float, is_told: bool
) -> None:
    moved = np.array([0.0, -0.5, 0.0])
    earlier, later = in_corridor(0.0, ledge_m), in_corridor(0.5, ledge_m)
    odds, share = odds_over([(earlier, later, np.stack([STILL, moved]))])
    if is_told:
        assert odds > 3.0
    else:
        assert odds == share == 0.0


@pytest.mark.parametrize(("usual_m", "searches"), [(0.0, 0), (0.6, 1)])
def test_only_the_usual_motion_is_accepted_without_a_search_for_rivals(
    usual_m: float, searches: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, implied = [], guess_kernels.implied

    def counted(*arguments: Any) -> Floats:
        made.append(implied(*arguments))
        return made[-1]

    monkeypatch.setattr(guess_kernels, "implied", counted)
    stays = (-1.5, -1.0, 0.3)
    found = searched(CORNERS, stays, stays, np.array([0.0, usual_m, 0.0]))
    np.testing.assert_allclose(found.motion, 0, atol=1e-9)
    assert len(made) == searches


def test_a_motion_that_several_guesses_lead_to_is_slid_along_walls_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slid = list[Floats]()

    def counted(earlier: Beams, later: Beams, motions: Floats, *more: Any) -> Floats:
        slid.extend([motions] if len(motions) > 50 and more[1] == SLIDE_STEP else [])
        return compared(earlier, later, motions, *more)

    monkeypatch.setattr(scan_comparison, "compared", counted)
    stays = (-1.5, -1.0, 0.3)
    searched(CORNERS, stays, stays, np.array([0.0, 0.6, 0.0]))
    assert len(slid) == 1


def test_a_motion_back_undoes_it() -> None:
    motion = np.array([0.7, -1.2, 0.4])
    back = inverse(inverse(motion))
    np.testing.assert_allclose(back, motion, atol=1e-12)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, -60.0])
@pytest.mark.parametrize("step_m", [0.1, 1.2])
def test_wide_steps_and_turns_are_found(turn_deg: float, step_m: float) -> None:
    first, second = (-0.6, 0.0, 0.2), (-0.6 + step_m, 0.3, 0.2 + np.deg2rad(turn_deg))
    found = searched(CORNERS, first, second)
    motion = found.motion
    np.testing.assert_allclose(motion, motion_between(first, second), atol=0.03)


def test_walls_that_do_not_match_give_no_link() -> None:
    """Beams alone do not suffice, even if all of them agree."""
    points = cast(CORNERS, (0.0, 0.0, 0.1))
    scan = observed(points)
    tracks = PlaneTracks.begun(
        np.arange(1), observed(points + np.array([40.0, 0.0])).only(slice(0, 1))
    )
    beams = Beams.of(scan.beams, scan.ends)
    assert Search(tracks, scan, beams, [View(beams, np.zeros(3))], STILL).found() is None


def test_another_room_is_not_tied() -> None:
    other = np.array([[2.2, -5], [2.2, 5], [-1.5, 5], [-1.5, -5]])
    earlier, later = observed(cast(CORNERS, (0, 0, 0))), observed(cast(other, (0, 0, 0.4)))
    tracks = PlaneTracks.begun(np.arange(len(earlier)), earlier)
    seen, before = (Beams.of(scan.beams, scan.ends) for scan in (later, earlier))
    assert Search(tracks, later, seen, [View(before, np.zeros(3))], STILL).found() is None
