"""What the command writes and says of a run of walls that broke into submaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from relmap.cli import main
from relmap.cli.outcome import each
from relmap.io.files import read_tum
from relmap.planes.walls.files import read_planes
from tests.commands import load, table, unrendered


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
    assert not list(out.glob("submap-*"))
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


@unrendered()
def test_a_scan_that_fits_nowhere_is_not_a_break(
    broken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = dict(np.load(broken / "scans.npz"))
    number, points = log["iteration"], log["points"]
    foreign = number == 55  # a scan of the other building takes the place of the 16th
    log["points"] = np.concatenate([points[number < 15], points[foreign], points[number > 15]])
    at = np.full(np.count_nonzero(foreign), 15)
    log["iteration"] = np.concatenate([number[number < 15], at, number[number > 15]])
    np.savez(tmp_path / "scans.npz", **log)
    mapping = ["map", str(tmp_path / "scans.npz"), "-o", str(tmp_path / "map")]
    capsys.readouterr()
    assert main([*mapping, "--variant", "planes", "--scans", "0:30"]) == 0
    said = capsys.readouterr().out
    assert "scans that fit nowhere, and are not in the map: 1 (iterations 15)" in said
    assert "broke" not in said
    parts = load(tmp_path / "map" / "summary.json")["submaps"]
    assert [part["scans"] for part in parts] == [29, 1]


def test_the_walls_of_each_submap_are_written(result: Path) -> None:
    first, second = (table(result / name) for name in ("planes.csv", "submap-1.csv"))
    assert list(first[0]) == list(second[0])
    mapped = [[row for row in each if row["status"] == "static"] for each in (first, second)]
    assert min(map(len, mapped)) >= 5
    assert not {row["plane"] for row in mapped[0]} & {row["plane"] for row in mapped[1]}
    begin, end = load(result / "summary.json")["submaps"][1]["iterations"]
    assert all(begin <= int(row["first_iteration"]) <= end for row in mapped[1])


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
    stages = ("reading_s", "segmentation_s", "mapping_s", "finish_s")
    assert sum(timing[stage] for stage in stages) + timing["refine_ms"] / 1e3 < timing["total_s"]
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
