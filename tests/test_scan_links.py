"""Links between laser scans: motions from walls, verified by beams."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import segment_scan, segmenter_for
from relmap.evaluation.sources import log_of
from relmap.planes.linking import guess_kernels, scan_comparison
from relmap.planes.linking.judging import View
from relmap.planes.linking.placement import STILL, PlaneTracks
from relmap.planes.linking.scan_comparison import SLIDE_STEP
from relmap.planes.linking.search import Search
from relmap.planes.motions import inverse
from relmap.planes.scans.beams import NEAR_M, Beams, GivenBeams, compared, odds_over
from relmap.planes.scans.observation import PlaneObservation, checked_planes
from relmap.planes.submaps.submap import torn_in
from relmap.segmentation.scanline import lines
from relmap.segmentation.scanline.lines import beam_noise
from relmap.simulation import simulate_building
from relmap.simulation.floor_plan import World
from tests.worlds import refined, submap_ate_m

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


def driven(log: ScanLog, scans: list[Floats]) -> PlaneMapper:
    """Map scans with the sensor of a log, without refinement."""
    mapper, segmenter = PlaneMapper(), segmenter_for(log.sensor)
    for points in scans:
        mapper.update(segment_scan(segmenter, points, log.sensor), beams=points)
    mapper.finish()
    return mapper


def scans_of(
    seed: int, step_m: float = 0.2, world: World = "building"
) -> tuple[ScanLog, list[Floats]]:
    """Return a laser log of a building, and its scans."""
    run = simulate_building(
        361, 0.01, sampling="laser", seed=seed, iterations=60, step_m=step_m, world=world
    )
    log = log_of(run)
    return log, [scan.points_robot for scan in log.scans()]


@pytest.mark.parametrize("seed", range(5))
def test_scans_of_another_world_begin_a_submap(seed: int) -> None:
    """Corridors of two buildings may look alike; those among panels look like no other."""
    (log, first), (_, second) = scans_of(seed), scans_of(seed, world="panels")
    mapper = driven(log, first[:25] + second[:25])
    assert sorted(submap.span for submap in mapper.submaps) == [(0, 25), (25, 50)]


def test_a_scan_that_fits_nothing_stays_alone() -> None:
    (log, scans), (_, foreign) = scans_of(3), scans_of(3, world="panels")
    scans[30] = foreign[50]
    mapper = driven(log, scans)
    largest, alone = mapper.submaps
    assert (largest.n_scans, alone.n_scans) == (59, 1)
    assert alone.span == (30, 31)
    assert np.isnan(mapper.trajectory[30]).all()
    known = np.delete(np.arange(60), 30)
    off = np.linalg.inv(log.poses[known[:-1]]) @ log.poses[known[1:]]
    found = np.linalg.inv(mapper.trajectory[known[:-1]]) @ mapper.trajectory[known[1:]]
    np.testing.assert_allclose(found[:, :2, 3], off[:, :2, 3], atol=0.1)
    mapper.refine()
    assert np.isnan(mapper.trajectory[30]).all()
    np.testing.assert_allclose(mapper.submaps[0].poses[31, :2, 3], mapper.trajectory[31, :2, 3])


def test_ties_last_in_saved_states_and_journals(tmp_path: Path) -> None:
    (log, scans), (_, foreign) = scans_of(3), scans_of(3, world="panels")
    scans[30] = foreign[50]
    mapper = driven(log, scans)
    mapper.save(tmp_path / "mapper.npz")
    again = PlaneMapper.load(tmp_path / "mapper.npz")
    for each in (mapper, again):
        each.refine()
    np.testing.assert_array_equal(again.trajectory, mapper.trajectory)
    np.testing.assert_array_equal(again.planes.ends, mapper.planes.ends)


@pytest.mark.parametrize("seed", [0, 4])
def test_long_steps_through_a_building(seed: int) -> None:
    """Steps of 1 m: every submap is right, and the largest holds most of the scans."""
    run = simulate_building(361, 0.01, sampling="laser", seed=seed, step_m=1.0)
    log = log_of(run)
    mapper = driven(log, [scan.points_robot for scan in log.scans()])
    assert mapper.submaps[0].n_scans > 0.6 * len(log)
    for submap in mapper.submaps:
        if submap.n_scans > 2:
            assert submap_ate_m(submap, log.poses) < 0.3


def test_a_run_with_beams_is_the_same_again() -> None:
    log, scans = scans_of(6, 0.6)
    first, second = (driven(log, scans[:40]) for _ in range(2))
    np.testing.assert_array_equal(first.trajectory, second.trajectory)


def test_a_map_torn_at_a_link_is_cut_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a third of the noise is known, some links, not corrected along walls, are wrong."""
    monkeypatch.setattr("relmap.planes.linking.scan_comparison.CROSSINGS", 0.0)
    monkeypatch.setattr("relmap.planes.linking.scan_comparison.EXCLUDED", np.inf)
    monkeypatch.setattr(lines, "beam_noise", lambda xy: 0.35 * beam_noise(xy))
    run = simulate_building(361, 0.05, sampling="laser", seed=8, step_m=0.1)
    log = log_of(run)
    mapper = driven(log, [scan.points_robot for scan in log.scans()])
    before = len(mapper.submaps)
    mapper.refine()
    assert len(mapper.submaps) > before
    assert not len(torn_in(mapper.submaps, mapper.history))
    for submap in mapper.submaps:
        assert submap_ate_m(submap, log.poses) < 1.0


@pytest.mark.parametrize(
    ("world", "beams", "step_m", "seed", "least"),
    [("oblique", 60, 1.0, 2, 46), ("building", 90, 0.1, 7, 600)],
)
def test_a_coarse_laser_breaks_rather_than_err(
    world: World, beams: int, step_m: float, seed: int, least: int
) -> None:
    """A doubtful tie would displace 48 scans by half a metre; a corridor was 3 m too short."""
    run = simulate_building(
        points=beams, sigma=0.01, sampling="laser", world=world, step_m=step_m, seed=seed
    )
    mapper = refined(PlaneMapper(), (scan.points[:, :2] for scan in run.scans))
    own = [submap for submap in mapper.submaps if submap.n_scans >= 10]
    assert sum(submap.n_scans for submap in own) >= least
    for submap in own:
        assert submap_ate_m(submap, run.trajectory) < 0.3
