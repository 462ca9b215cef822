"""Figures 4 to 7 of the plane variant: the data behind them, and that they are drawn from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

from relmap.cli import main
from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.evaluation.metrics import align_poses
from relmap.evaluation.sources import log_of, truth_of
from relmap.figures import figure04, figure06
from relmap.figures.figure04 import corner_tests
from relmap.figures.figure06 import PartialWall, longest, run_partial_wall
from relmap.planes import PlaneMapper
from relmap.planes.scans.observation import checked_planes
from relmap.planes.walls.history import PlaneHistory
from relmap.plots.bench import FPS, HOLD, plot_bench, write_bench_gif
from relmap.plots.bench_recorder import BenchFrame, BenchRecorder, frame_step
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import simulate_building
from tests.commands import Check, unrendered

WALLS = np.array([[[4.0, -2.0], [4.0, 2.0]], [[4.0, 2.0], [-1.0, 2.0]]])


def history_of(
    scans: list[Floats], kinds: list[list[str]], corners: list[list[int]]
) -> PlaneHistory:
    """Return what is stored of the same walls, seen over and over."""
    k, m = len(scans), len(scans[0])
    ends, corner = np.concatenate(scans), np.tile(corners, (k, 1))
    end_type = np.tile(np.array(kinds), (k, 1))
    seen = checked_planes(SimpleNamespace(ends=ends, end_type=end_type))
    when, plane = np.repeat(np.arange(k), m), np.tile(np.arange(m), k)
    rows = when, plane, seen.ends, seen.sd, seen.z_extent, corner
    return PlaneHistory(*rows, np.zeros((k, 3)), np.zeros(k, dtype=np.int64))


# Figure 4.


def cut_walls() -> PlaneHistory:
    """The first wall's right end moves, and the left one of the second."""
    scans = []
    for k in range(15):
        ends = WALLS.copy()
        ends[0, 0, 1] += 0.1 * k
        ends[1, 1, 0] += 0.15 * k
        scans.append(ends - [0.05 * k, 0.02 * k])
    return history_of(scans, [["view", "corner"], ["corner", "view"]], [[-1, 0], [1, -1]])


def test_corner_test_finds_the_static_pair_and_reports_all_four() -> None:
    (test,) = corner_tests(cut_walls())
    assert test.static == test.chosen == (1, 0)
    np.testing.assert_allclose(test.sizes, [4.0, 5.0])
    np.testing.assert_allclose(test.skew, np.pi / 2)
    np.testing.assert_allclose(test.deviation[1, 0], 0.0, atol=1e-12)
    # An end that goes 0.1 m a scan takes its midpoint along.
    spread = np.arange(15).std()
    np.testing.assert_allclose(test.deviation[0, 0], 0.1 * spread)
    np.testing.assert_allclose(test.deviation[1, 1], 0.15 * spread)
    np.testing.assert_allclose(test.deviation[0, 1], np.hypot(0.1, 0.15) * spread)


def test_rows_of_the_corner_test_hold_what_is_drawn() -> None:
    table = figure04.FIGURE.judge(corner_tests(cut_walls())).table
    rows = list(table.rows)
    assert len(rows) == 4 * 15
    assert all(len(row) == len(table.columns) for row in rows)
    chosen = np.array([row[3:5] for row in rows if row[-1] == 1], dtype=np.float64)
    # The first wall's normal looks along -x: the second midpoint is 2.5 m ahead, 2 m to the right.
    np.testing.assert_allclose(chosen, np.tile([2.5, -2.0], (15, 1)), atol=1e-12)


def test_parallel_walls_are_not_shown() -> None:
    with pytest.raises(RelmapError, match="no two walls are seen with one cut end each for 12"):
        figure04.FIGURE.judge([])


def test_corner_test_is_drawn_with_its_deviations() -> None:
    figure = figure04.FIGURE.draw(corner_tests(cut_walls()))
    legend = figure.axes[2].get_legend()
    said = [text.get_text() for text in legend.get_texts()]
    assert sum("static" in text for text in said) == 1
    assert any(f"{0.1 * np.arange(15).std():.3f} m" in text for text in said)


def test_verdict_on_the_corner_test_is_that_of_all_pairs() -> None:
    (right,) = corner_tests(cut_walls())
    wrong = replace(right, static=(0, 0))
    judge = figure04.FIGURE.judge
    found = judge([right] * 19 + [wrong])
    assert (found.verdict, found.value) == ("borne out", 0.95)
    assert judge([right, wrong]).verdict == "partly borne out"
    assert judge([right, wrong, wrong]).verdict == "not borne out"
    assert list(found.table.rows) == list(judge([right]).table.rows)


# Figure 5.


class Bench(NamedTuple):
    """Frames of a run at intervals, and the last scan with the map at the end."""

    frames: list[BenchFrame]
    last: BenchFrame


@pytest.fixture(scope="module")
def bench() -> Bench:
    """The bench after 40 scans of a building."""
    building = simulate_building(points=400, sigma=0.02, iterations=40, seed=3)
    mapper, segmenter, log = PlaneMapper(), PlaneSegmenter(), log_of(building)
    recorder = BenchRecorder(log, segmenter, truth_of(building), every=frame_step(40, 8))
    for scan in recorder.watch(mapper, log.scans()):
        segmenter.fit(scan.points_robot)
        mapper.update(segmenter.planes_, stamp_s=scan.stamp_s)
    mapper.finish()
    mapper.refine()
    return Bench(recorder.frames, recorder.frame(mapper))


def test_a_frame_is_kept_at_intervals(bench: Bench) -> None:
    assert [frame.iteration for frame in bench.frames] == [4, 9, 14, 19, 24, 29, 34, 39]
    assert frame_step(281) == 4
    assert frame_step(3) == 1


def test_mapped_walls_lie_on_true_ones_in_the_frame(bench: Bench) -> None:
    last = bench.last
    assert len(last.walls) >= 4
    first, across = last.true_walls[:, 0], last.true_walls[:, 1] - last.true_walls[:, 0]
    for end in last.walls.reshape(-1, 2):
        t = np.clip(((end - first) * across).sum(axis=1) / (across**2).sum(axis=1), 0, 1)
        assert np.linalg.norm(first + t[:, None] * across - end, axis=1).min() < 0.1
    at = last.points_robot @ last.T_world_robot[:2, :2].T + last.T_world_robot[:2, 3]
    t = ((at[:, None] - first) * across).sum(axis=2) / (across**2).sum(axis=1)
    off = np.linalg.norm(first + np.clip(t, 0, 1)[:, :, None] * across - at[:, None], axis=2)
    assert np.median(off.min(axis=1)) < 0.04  # noise of 0.02 m, and the pose's error


def test_links_tie_the_middles_of_walls(bench: Bench) -> None:
    last = bench.last
    middles = last.walls.mean(axis=1)
    assert len(last.links) >= 2
    apart = np.linalg.norm(last.links[:, 1][:, None] - middles, axis=2)
    assert apart.min(axis=1).max() < 1e-12


def test_rows_of_the_bench_hold_every_point_and_wall(bench: Bench) -> None:
    last = bench.last
    whats = [row[0] for row in last.rows()]
    assert whats.count("point (robot)") == len(last.points_robot) == 400
    assert whats.count("wall") == len(last.walls)
    assert whats.count("true wall") == len(last.true_walls)
    assert whats.count("pose") == len(last.path)


def test_bench_has_the_four_panels_of_the_paper(bench: Bench) -> None:
    titles = [axes.get_title() for axes in plot_bench(bench.last).axes]
    assert titles[0] == "mapped walls over the true ones"
    assert titles[1] == "what the robot sees: 400 points"
    assert titles[2] == f"segmented: {len(bench.last.ends_robot)} planes"
    assert titles[3] == "the map with group connectivity"


def test_bench_says_that_the_scan_is_not_in_the_map(bench: Bench) -> None:
    apart = replace(bench.last, T_world_robot=np.full((4, 4), np.nan))
    said = "mapped walls over the true ones; this scan is in another submap"
    assert plot_bench(apart).axes[0].get_title() == said


def test_bench_calls_itself_a_figure_of_the_paper_only_there(bench: Bench) -> None:
    assert plot_bench(bench.last).get_suptitle() == "the test bench, iteration 39"
    in_paper = plot_bench(bench.last, "Figure 5: the test bench").get_suptitle()
    assert in_paper == "Figure 5: the test bench, iteration 39"


def test_animation_holds_every_frame_and_the_last_for_long(bench: Bench, tmp_path: Path) -> None:
    seen = []

    def counted(frames: list[BenchFrame]) -> list[BenchFrame]:
        seen.extend(frames)
        return frames

    write_bench_gif(tmp_path / "a.gif", bench.frames[:2], counted)  # type: ignore[arg-type]
    assert len(seen) == 2
    with Image.open(tmp_path / "a.gif") as image:
        assert getattr(image, "n_frames", 1) >= 2
        image.seek(image.n_frames - 1)  # type: ignore[attr-defined]
        assert image.info["duration"] >= 1000 * HOLD / FPS
    with pytest.raises(RelmapError, match="at least one scan"):
        write_bench_gif(tmp_path / "b.gif", [])


@unrendered()
def test_map_draws_the_bench_and_animates_it_when_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("relmap.plots.bench.HOLD", 1)
    options = ["--points", "300", "--iterations", "5"]
    assert main(["simulate", "building", "-o", str(tmp_path / "w"), *options]) == 0
    mapping = ["map", str(tmp_path / "w"), "-o", str(tmp_path / "r"), "--variant", "planes"]
    assert main([*mapping, "--animate"]) == 0
    assert (tmp_path / "r" / "bench.png").is_file()
    with Image.open(tmp_path / "r" / "bench.gif") as image:
        assert getattr(image, "n_frames", 1) >= 5
    assert main(mapping) == 0
    assert (tmp_path / "r" / "bench.png").is_file()
    assert not (tmp_path / "r" / "bench.gif").exists()  # it would be of another run


def test_points_are_not_animated(refused: Check) -> None:
    told = refused("map", "log.csv", "-o", "out", "--animate")
    assert "--animate draws walls" in told


# Figure 6.


def test_links_by_parallel_walls_alone_are_weak() -> None:
    still = [WALLS] * 3
    assert history_of(still, [["view"] * 2] * 2, [[-1, -1]] * 2).weak_links.tolist() == []
    alone = [WALLS[:1]] * 3
    cut = history_of(alone, [["view", "view"]], [[-1, -1]])
    assert cut.weak_links.tolist() == [1, 2]
    with_corner = history_of(alone, [["view", "corner"]], [[-1, 7]])
    assert with_corner.weak_links.tolist() == []
    parallel = np.array([[[4.0, -2.0], [4.0, 2.0]], [[-4.0, 2.0], [-4.0, -2.0]]])
    both = history_of([parallel] * 2, [["view"] * 2] * 2, [[-1, -1]] * 2)
    assert both.weak_links.tolist() == [1]


def test_links_along_one_wall_keep_their_motions_in_the_refinement() -> None:
    """Weak ones loosely; those with walls that cross not at all."""
    alone, measured = [WALLS[:1]] * 3, np.ones(3, dtype=bool)
    cut = replace(history_of(alone, [["view", "view"]], [[-1, -1]]), measured=measured)
    np.testing.assert_array_equal(cut.factors(np.arange(3)).both, [[0, 1], [1, 2]])
    with_corner = replace(history_of(alone, [["view", "corner"]], [[-1, 7]]), measured=measured)
    factors = with_corner.factors(np.arange(3))
    np.testing.assert_array_equal(factors.both, [[0, 1], [1, 2]])
    assert (factors.sd < cut.factors(np.arange(3)).sd).all()
    crossing = np.array([WALLS[0], WALLS[0] + 0.5, WALLS[1], WALLS[1] + 0.5])
    room = history_of([crossing] * 3, [["view", "view"]] * 4, [[-1, -1]] * 4)
    assert len(replace(room, measured=measured).factors(np.arange(3))) == 0


def test_longest_run() -> None:
    assert longest(np.array([1, 0, 1, 1, 1, 0, 1, 1], dtype=bool)) == (2, 5)
    with pytest.raises(RelmapError, match="no link is weak"):
        longest(np.zeros(4, dtype=bool))


def test_one_pose_is_enough_to_place_a_path() -> None:
    pose, other = np.eye(4)[None].copy(), np.eye(4)[None].copy()
    pose[0, :2, 3] = 1.0, 2.0
    other[0, :2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    other[0, :2, 3] = 5.0, 6.0
    R, t = align_poses(pose, other, 2)
    np.testing.assert_allclose(R, [[0.0, -1.0], [1.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(pose[0, :2, 3] @ R.T + t, [5.0, 6.0], atol=1e-15)


@pytest.fixture(scope="module")
def exact() -> PartialWall:
    return run_partial_wall(points=250, beside=30)


def test_partial_wall_is_bridged_and_all_else_is_exact(exact: PartialWall) -> None:
    before_m, after_m = exact.errors_m
    assert max(before_m, after_m) < 1e-9
    assert 10.0 < exact.weak_m < 14.0
    assert abs(exact.shift[0]) < 0.02 * exact.weak_m  # the robot weaves: its speed along varies
    assert abs(exact.shift[1]) < 0.005


def test_noise_does_not_stop_the_robot_beside_the_wall() -> None:
    run = run_partial_wall(points=250, sigma=0.02, beside=30)
    assert abs(run.shift[0]) < 0.25 * run.weak_m
    assert abs(run.shift[1]) < 0.2


def test_picture_and_rows_mark_the_weak_links(exact: PartialWall) -> None:
    rows = list(figure06.FIGURE.judge(exact).table.rows)
    assert sum(int(str(row[-1])) for row in rows) == exact.weak.sum()
    path = np.array([row[1:5] for row in rows], dtype=np.float64)
    begin = exact.stretch[0]
    np.testing.assert_allclose(path[:begin, :2], path[:begin, 2:], atol=1e-9)
    titles = figure06.FIGURE.draw(exact).get_suptitle()
    assert titles.startswith(f"Figure 6: {exact.weak_m:.1f} m along one partial wall")


def test_verdict_on_the_partial_wall(exact: PartialWall) -> None:
    found = figure06.FIGURE.judge(exact)
    assert found.verdict == "partly borne out"  # exact but for what the motion model bridges
    assert found.value == abs(exact.shift[0])
    at_once = replace(exact, poses=exact.true_poses)
    assert figure06.FIGURE.judge(at_once).verdict == "borne out"
