"""Unsupported or implausible motions break a run of walls into submaps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from relmap import PlaneMapper
from relmap.cli import main
from relmap.cli.outcome import each
from relmap.core.arrays import Floats
from relmap.io.files import read_tum
from relmap.planes.refinement.system import WallSystem
from relmap.planes.submaps.submap import disagreement, stitched
from relmap.planes.walls.equations import Walls
from relmap.planes.walls.files import read_planes
from relmap.simulation.visibility import seen_walls
from tests.commands import load, unrendered
from tests.test_planes import CORRIDOR, ROOM, seen_from
from tests.worlds import finished

NOTHING = SimpleNamespace(ends=np.empty((0, 2, 2)), end_type=np.empty((0, 2), dtype=str))
ELSEWHERE = np.array(
    [[[5.0, -1.0], [3.0, 4.0]], [[1.5, 3.5], [0.0, 3.8]], [[1.0, -2.5], [2.5, -2.0]]]
)
"""Another room, which no motion lays onto the first."""


def drive(mapper: PlaneMapper, scans: int, walls: Floats = ROOM) -> None:
    """Go a little ahead in a room."""
    for k in range(scans):
        mapper.update(seen_from(-1.5 + 0.05 * k, 0.0, 0.01 * k, walls, half_view=1.5))


def test_a_scan_that_nothing_supports_begins_a_submap() -> None:
    mapper = PlaneMapper()
    drive(mapper, 20)
    drive(mapper, 14, ELSEWHERE)
    mapper.finish()
    for _ in range(2):
        assert [submap.span for submap in mapper.submaps] == [(0, 20), (20, 34)]
        there = np.isfinite(mapper.trajectory[:, 0, 0])
        assert np.flatnonzero(there).tolist() == list(range(20))
        for submap in mapper.submaps:
            steps = np.linalg.norm(np.diff(submap.poses[:, :2, 3], axis=0), axis=1)
            np.testing.assert_allclose(steps, 0.05, atol=1e-6)
        mapper.refine()
    assert 20 not in mapper.weak_links
    assert len(mapper.submaps) == 2
    assert set(mapper.landmarks.submap.tolist()) >= {0, 1}


def test_the_longest_submap_is_the_first() -> None:
    mapper = PlaneMapper()
    drive(mapper, 14, ELSEWHERE)
    drive(mapper, 20)
    mapper.finish()
    assert [submap.span for submap in mapper.submaps] == [(14, 34), (0, 14)]


def test_a_long_bridge_ends_the_submap() -> None:
    """Few scans without walls are bridged; after many the motion is unknown."""
    mapper = PlaneMapper()
    drive(mapper, 20)
    for _ in range(30):
        mapper.update(NOTHING)
    drive(mapper, 15)
    mapper.finish()
    (first, second) = mapper.submaps
    assert first.span[0] == 0
    assert 20 <= first.span[1] <= 20 + mapper.config.max_missed
    assert second.span == (50, 65)


def test_an_implausible_jump_is_rejected() -> None:
    """Walls 2.5 m further look alike; a robot that goes 0.1 m a scan did not go there."""
    row = np.array([[[3.0, 0.2 + 2.5 * k], [3.0, 1.7 + 2.5 * k]] for k in range(-6, 7)])

    def seen(y: float) -> Any:
        return seen_walls(row - [0.0, y], 8.0, 0.9)

    mapper = finished(
        PlaneMapper(), (seen(0.1 * k if k < 20 else 0.1 * k + 1.2) for k in range(40))
    )
    for submap in mapper.submaps:
        steps = np.linalg.norm(np.diff(submap.poses[:, :2, 3], axis=0), axis=1)
        assert steps.max(initial=0.0) < 0.5


def test_stop_and_go_along_a_wall_is_not_bridged_for_long() -> None:
    """Where the speed varied before, it is not known along a single partial wall."""
    mapper, x = PlaneMapper(), -1.0
    for k in range(120):
        x += 0.1 if k % 2 else 0.35
        mapper.update(seen_from(x, 0.0, 0.0, CORRIDOR, np.pi / 2, 5.0))
    mapper.finish()
    assert len(mapper.submaps) > 1
    assert len(mapper.weak_links) > 0


def test_a_torn_path_disagrees_with_its_links() -> None:
    motions = np.tile([0.0, -0.2, 0.0], (30, 1))
    poses = stitched([np.full((30, 4, 4), np.nan)], motions)
    n_torn, off_m = disagreement(poses, motions)
    assert n_torn == 0
    assert off_m < 1e-12
    torn = poses.copy()
    torn[15:, 1, 3] += 40.0
    assert disagreement(torn, motions)[0] == 1


def test_a_map_that_refining_tears_stays_as_chained(monkeypatch: pytest.MonkeyPatch) -> None:
    from relmap.planes.refinement import refined_map
    from relmap.planes.refinement.solving import refined

    mapper = PlaneMapper()
    drive(mapper, 30)
    mapper.finish()
    chained = mapper.trajectory

    def torn(assembled: Any, rounds: Any, held: float) -> Any:
        best = refined(assembled, rounds, held)
        best.state.t[10:] += 800.0
        return best

    monkeypatch.setattr(refined_map, "refined", torn)
    mapper.refine()
    np.testing.assert_array_equal(mapper.trajectory, chained)
    assert [submap.refined for submap in mapper.submaps] == [False]


def test_a_map_that_lowering_the_noise_tears_stays_as_refined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from relmap.planes.refinement import refined_map

    def torn(assembled: Any, _: float) -> Any:
        state = replace(assembled.state, t=assembled.state.t.copy())
        state.t[10:] += 800.0
        return replace(assembled, state=state)

    monkeypatch.setattr(refined_map, "refined_to_the_noise", torn)
    mapper = PlaneMapper()
    drive(mapper, 30)
    mapper.finish()
    chained = mapper.trajectory
    mapper.refine()
    assert [submap.refined for submap in mapper.submaps] == [True]
    np.testing.assert_allclose(mapper.trajectory, chained, atol=0.01)


def test_steps_of_refinement_are_bounded() -> None:
    """A poorly connected part is not moved beyond the map."""
    from relmap.planes.walls.equations import WallEquations

    walls = np.array([[[4.0, -3.0], [4.0, 3.0]], [[4.0, 3.0], [-2.0, 3.0]]])
    n = 20
    # The second wall's direction is known from a speck of it, which is quite wrong.
    ends = np.tile(walls, (n, 1, 1))
    ends[1::2, 1] = ends[1::2, 0] + np.array([1e-7, 3e-3])
    none = np.empty(0, dtype=np.int64)
    iteration = np.repeat(np.arange(n), 2)
    given = WallEquations(
        iteration, np.tile([0, 1], n), ends, np.full(2 * n, 0.01), none, none, none, np.empty(0)
    )
    state = Walls(
        np.zeros(n),
        np.column_stack([np.linspace(0.0, 500.0, n), np.zeros(n)]),
        walls.mean(axis=1),
        np.array([np.pi, -np.pi / 2]),
        np.zeros(2),
        np.empty(0),
    )
    system = WallSystem(given)
    for _ in range(5):
        after = system.refine(state, 1, 1e4)
        assert np.abs(after.t - state.t).max() <= 2 * 505.0
        assert np.abs(after.yaw - state.yaw).max() <= np.pi / 2 + 1e-12
        state = after
    assert np.isfinite(state.t).all()


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log that shows one building and then, without a way between, another."""
    folder, logs = tmp_path_factory.mktemp("broken"), []
    for seed, begin in (("3", 0), ("11", 60)):
        options = ["--points", "400", "--sigma", "0.01", "--seed", seed, "--sampling", "laser"]
        sampled = [*options, "--iterations", str(begin + 30)]
        assert main(["simulate", "building", "-o", str(folder / seed), *sampled]) == 0
        log = dict(np.load(folder / seed / "scans.npz"))
        kept = log["iteration"] >= begin
        logs.append((log, log["points"][kept], log["iteration"][kept] - begin))
    (log, *first), (_, *second) = logs
    log["points"] = np.concatenate([first[0], second[0]])
    log["iteration"] = np.concatenate([first[1], second[1] + 30])
    log["stamps_s"] = np.arange(60.0)
    (folder / "log").mkdir()
    np.savez(folder / "log" / "scans.npz", **log)
    return folder / "log"


@pytest.fixture(scope="module")
def result(broken: Path) -> Path:
    """Its map."""
    out = broken.parent / "result"
    with unrendered():
        assert main(["map", str(broken), "-o", str(out), "--variant", "planes"]) == 0
    return out


def test_files_line_and_picture_report_submaps(
    broken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "result"
    capsys.readouterr()
    assert main(["map", str(broken), "-o", str(out), "--variant", "planes"]) == 0
    (said,) = capsys.readouterr().out.splitlines()
    summary = load(out / "summary.json")
    first, second = summary["submaps"]
    assert sorted([first["iterations"], second["iterations"]]) == [[0, 29], [30, 59]]
    assert first["scans"] == second["scans"] == 30
    assert 0.0 < second["metres"] < 15.0
    assert "broke into 2 submaps" in said
    steps = summary["steps"]
    assert 0.05 < steps["median_m"] < 0.5
    assert 0.0 <= steps["median_deg"] < 10.0
    assert f"here {steps['median_m']:.2f} m" in said
    assert f"here {steps['view_deg']:.0f} degrees" in said
    assert said.startswith(f"wrote {len(list(out.iterdir()))} files")
    stamps_s, poses = read_tum(out / "submap-1.tum")
    assert len(poses) == 30
    assert not set(stamps_s) & set(read_tum(out / "trajectory.tum")[0])
    with Image.open(out / "map.png") as image:
        two = image.size
    # Mapped again in part, the file of the other submap is out of date.
    again = ["map", str(broken), "-o", str(out), "--variant", "planes", "--scans", "0:25"]
    assert main(again) == 0
    assert not (out / "submap-1.tum").exists()
    with Image.open(out / "map.png") as image:
        assert image.size != two


@unrendered()
def test_no_advice_where_the_largest_submap_is_all_but_whole(
    broken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mapping = ["map", str(broken), "-o", str(tmp_path), "--variant", "planes", "--scans", "0:32"]
    capsys.readouterr()
    assert main(mapping) == 0
    said = capsys.readouterr().out
    assert "broke into 2 submaps" in said
    assert "More overlap" not in said


def test_corners_are_counted_alike_everywhere(result: Path) -> None:
    from relmap.plots.planes import plot_planes

    counts = load(result / "summary.json")["counts"]
    planes = read_planes(result)
    mapped = planes.status == "static"
    at_ends = int((planes.corner[mapped] >= 0).sum())
    assert counts["corners_static"] == at_ends > 0
    title = plot_planes(planes, read_tum(result / "trajectory.tum")[1]).axes[0].get_title()
    assert f"{mapped.sum()} walls, {at_ends} corners" in title


@unrendered()
def test_the_summary_lists_weak_links_of_the_largest_submap(
    broken: Path, result: Path, tmp_path: Path
) -> None:
    summary = load(result / "summary.json")
    weak, spans = summary["refinement"], [each["iterations"] for each in summary["submaps"]]
    assert all(each["refined"] for each in summary["submaps"])
    assert weak["segments"] >= 3
    assert 0.0 < weak["segment_residual_median"] < 3.0
    residuals = [each["residual"] for each in weak["weakest_segments"]]
    assert residuals == sorted(residuals, reverse=True)
    (begin, end), *_ = [span for span in spans if span[0] == weak["anchor_iteration"]]
    assert all(begin <= each["first_iteration"] <= end for each in weak["weakest_segments"])
    out = ["-o", str(tmp_path), "--variant", "planes"]
    assert main(["map", str(broken), *out, "--no-refine"]) == 0
    assert load(tmp_path / "summary.json")["refinement"] is None


def test_time_is_reported_in_whole_and_readable(result: Path) -> None:
    timing = load(result / "summary.json")["timing"]
    assert 0.0 < timing["segmentation_share"] < 1.0
    assert timing["scan_median_ms"] >= max(timing["median_ms"], timing["segmentation_median_ms"])
    assert each(102.3) == "median 102 ms each"
    assert each(5512.0) == "median 5.5 s each"
    assert each(0.256) == "median 0.26 ms each"


@unrendered()
def test_resuming_a_finished_run_writes_what_the_run_wrote(
    broken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, journal = tmp_path / "result", tmp_path / "run.journal"
    mapping = ["map", str(broken), "-o", str(out), "--variant", "planes"]
    assert main([*mapping, "--journal", str(journal)]) == 0
    whole = {path.name: path.read_bytes() for path in out.iterdir()}
    (out / "bench.png").write_bytes(b"stale")
    capsys.readouterr()
    assert main(["resume", str(journal)]) == 0
    said = capsys.readouterr().out
    written = {path.name: path.read_bytes() for path in out.iterdir()}
    assert written.keys() == whole.keys()
    assert f"wrote {len(written)} files" in said
    for name in written.keys() - {"summary.json"}:
        assert written[name] == whole[name], name


@pytest.mark.parametrize(("lost", "torn"), [(1, 1), (2, 1), (3, 0)])
def test_a_path_follows_its_links_across_a_few_lost_scans(lost: int, torn: int) -> None:
    """A part behind a lost scan slid 31 m along a corridor when the map was refined."""
    motions = np.tile([0.1, -0.5, 0.02], (12, 1))
    poses = stitched([], motions)
    poses[5 : 5 + lost] = np.nan
    assert disagreement(poses, motions) == pytest.approx((0, 0.0), abs=1e-12)
    poses[5 + lost :, 0, 3] += 3.0
    assert disagreement(poses, motions)[0] == torn
