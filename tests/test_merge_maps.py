"""Merging the maps of two runs: common landmarks align them; without any it is refused."""

from __future__ import annotations

import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from relmap import PointMapper
from relmap.cli import main
from relmap.core.geometry.alignment import fit_rigid
from relmap.datasets import ObservationLog, open_log
from relmap.io.files import read_tum
from relmap.io.results import read_result
from relmap.planes.walls.files import read_any, read_planes, write_planes
from relmap.planes.walls.table import PlaneTable
from tests.commands import load, run_relmap, table
from tests.logs import first_scans
from tests.tables import walls_of

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.fixture(scope="module")
def halves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of one building and two of one figure eight, mapped apart."""
    folder = tmp_path_factory.mktemp("halves")
    laser = ["--sampling", "laser", "--points", "181", "--sigma", "0.01"]
    run_relmap("simulate", "building", "-o", folder / "lab", *laser)
    run_relmap("simulate", "figure-eight", "-o", folder / "eight", "--iterations", "300")
    planes = ["--variant", "planes"]
    for name, scans in (("a", "0:170"), ("b", "120:282")):
        run_relmap("map", folder / "lab", "-o", folder / f"lab-{name}", *planes, "--scans", scans)
    for name, scans in (("a", "0:180"), ("b", "120:300")):
        run_relmap("map", folder / "eight", "-o", folder / f"eight-{name}", "--scans", scans)
    return folder


def test_a_building_in_two_halves_is_the_building(halves: Path) -> None:
    out = halves / "lab-both"
    run_relmap("merge", halves / "lab-a", halves / "lab-b", "-o", out)
    run_relmap("evaluate", out, "--truth", halves / "lab")
    whole = load(out / "evaluation.json")
    run_relmap("evaluate", halves / "lab-a", "--truth", halves / "lab")
    half = load(halves / "lab-a" / "evaluation.json")
    assert half["wall_recall"] < 0.75
    assert whole["wall_recall"] > 0.95
    assert (whole["wall_precision"], whole["doubled_length"]) == (1.0, 0.0)
    assert whole["corner_rmse_m"] < 1.2 * half["corner_rmse_m"]
    assert whole["counts"]["false_corners"] == 0
    planes, corners = read_planes(out), read_result(out).landmarks
    assert len(np.unique(planes.plane)) == len(planes.plane)
    assert len(np.unique(corners.landmark)) == len(corners.landmark)
    at = dict(zip(corners.landmark.tolist(), corners.position[:, :2].tolist(), strict=True))
    for ends, labels in zip(planes.ends.tolist(), planes.corner.tolist(), strict=True):
        for end, label in zip(ends, labels, strict=True):
            assert label < 0 or at[label] == end


def test_the_path_of_the_second_goes_on_where_the_first_was(halves: Path) -> None:
    run_relmap("merge", halves / "lab-a", halves / "lab-b", "-o", halves / "path")
    one, other = (read_tum(halves / "path" / f"trajectory{name}.tum") for name in ("", "-2"))
    common, mine, theirs = np.intersect1d(one[0], other[0], return_indices=True)
    assert len(common) == 50
    np.testing.assert_allclose(one[1][mine], other[1][theirs], atol=0.03)


def test_points_in_two_halves_are_all_points(halves: Path) -> None:
    out = halves / "eight-both"
    run_relmap("merge", halves / "eight-a", halves / "eight-b", "-o", out)
    merged = read_result(out).landmarks
    places = merged.position[np.isfinite(merged.position[:, 0])]
    # As many as the whole log has: a landmark that both saw stands there once.
    run_relmap("map", halves / "eight", "-o", halves / "eight-whole")
    whole = read_result(halves / "eight-whole")
    assert len(places) == whole.mapped.sum()
    target = whole.landmarks.position[whole.mapped]
    R, t = np.eye(3), np.zeros(3)
    for _ in range(5):
        off = np.linalg.norm((places @ R.T + t)[:, None] - target[None], axis=2)
        R, t = fit_rigid(places, target[off.argmin(axis=1)])
    assert np.sqrt((off.min(axis=1) ** 2).mean()) < 0.1
    assert len(np.unique(off.argmin(axis=1))) == len(places)
    seen = [read_result(halves / f"eight-{name}").landmarks.observations.sum() for name in "ab"]
    assert merged.observations.sum() == sum(seen)


@pytest.mark.parametrize("scale", [1.0, 1.005])
def test_maps_of_different_scales_are_mentioned(
    scale: float, halves: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = open_log(halves / "eight")
    assert isinstance(log, ObservationLog)
    rows = np.column_stack([log.iteration, scale * log.points_robot]).tolist()
    text = "\n".join(",".join(map(repr, row)) for row in rows)
    (tmp_path / "seen.csv").write_text(f"iteration,x,y,z\n{text}\n")
    run_relmap("map", tmp_path / "seen.csv", "-o", tmp_path / "b", "--scans", "120:300")
    run_relmap("merge", halves / "eight-a", tmp_path / "b", "-o", tmp_path / "both")
    said = "b has distances at least 0.5 % longer than the earlier one"
    assert (said in capsys.readouterr().out) == (scale > 1)


def test_a_map_merged_with_itself_is_that_map(halves: Path) -> None:
    for name in ("lab-a", "eight-a"):
        run_relmap("merge", halves / name, halves / name, "-o", halves / "self")
        before, after = read_any(halves / name), read_any(halves / "self")
        np.testing.assert_allclose(
            after.landmarks.position[after.mapped],
            before.landmarks.position[before.mapped],
            atol=1e-6,
        )
    assert not (halves / "self" / "planes.csv").exists()  # of walls, before


def test_a_merged_map_is_exported(halves: Path, tmp_path: Path) -> None:
    run_relmap("merge", halves / "lab-a", halves / "lab-b", "-o", tmp_path / "both")
    for to in ("dxf", "grid", "geojson"):
        run_relmap("export", tmp_path / "both", "--to", to, "-o", tmp_path)
    assert len([row for row in table(tmp_path / "both" / "planes.csv") if row["x0"]]) > 60


def test_a_merged_map_of_points_has_no_observations_to_export(
    halves: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = str(tmp_path / "both")
    run_relmap("merge", halves / "eight-a", halves / "eight-b", "-o", both)
    g2o = ["export", both, "--to", "g2o", "-o", str(tmp_path / "a.g2o")]
    capsys.readouterr()
    assert main([*g2o, "--log", str(halves / "eight")]) == 2
    assert "export without --log" in capsys.readouterr().err
    run_relmap(*g2o)


def test_a_merged_map_of_points_is_evaluated_by_place(
    halves: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_relmap("merge", halves / "eight-a", halves / "eight-b", "-o", tmp_path / "both")
    capsys.readouterr()
    run_relmap("evaluate", tmp_path / "both", "--truth", halves / "eight")
    printed = capsys.readouterr().out
    assert "the map was merged" in printed
    assert "--log" not in printed
    whole = load(tmp_path / "both" / "evaluation.json")
    run_relmap("evaluate", halves / "eight-a", "--truth", halves / "eight")
    half = load(halves / "eight-a" / "evaluation.json")
    assert whole["counts"]["matched_landmarks"] > 1.3 * half["counts"]["matched_landmarks"]
    assert 0 < whole["landmark_rmse_m"] < 2 * half["landmark_rmse_m"]
    apart = tmp_path / "apart"
    shutil.copytree(halves / "eight" / "truth", apart)
    (apart / "trajectory.tum").unlink()
    run_relmap("evaluate", tmp_path / "both", "--truth", apart)
    assert "too little is known" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("one", "other", "scans"),
    [
        ("lab-a", "lab-b", [0, 170 + 162]),
        ("lab-b", "lab-a", [120, 282 + 170]),
        ("eight-a", "eight-b", [0, 180 + 180]),
        ("eight-b", "eight-a", [120, 300 + 180]),
    ],
)
def test_the_iterations_of_the_second_follow_those_of_the_first(
    halves: Path, tmp_path: Path, one: str, other: str, scans: list[int]
) -> None:
    run_relmap("merge", halves / one, halves / other, "-o", tmp_path)
    merged = read_any(tmp_path)
    assert merged.summary["scans"] == scans
    assert merged.landmarks.last_iteration.max() == scans[1] - 1


@pytest.mark.parametrize(
    ("one", "other", "said"),
    [
        ("lab-a", "eight-a", "lab-a is a map of walls and "),
        ("eight-a", "twin", "no place of one is found in the other"),
        ("empty", "empty", "no place of one is found in the other"),
        ("lab-a", "corridor", "no unique alignment"),
        ("lab-a", "gone", "gone is not a result folder"),
    ],
)
def test_maps_without_an_alignment_are_refused(
    halves: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    one: str,
    other: str,
    said: str,
) -> None:
    if other == "twin":  # another world
        run_relmap("simulate", "figure-eight", "-o", tmp_path, "--iterations", "100", "--seed", "5")
        run_relmap("map", tmp_path, "-o", halves / other)
    if other == "empty":
        PointMapper().save_results(halves / other)
    if other == "corridor":
        laser = ["--sampling", "laser", "--points", "181", "--iterations", "60"]
        run_relmap("simulate", "building", "--world", "corridor", "-o", tmp_path, *laser)
        run_relmap("map", tmp_path, "-o", halves / other, "--variant", "planes")
    capsys.readouterr()
    out = tmp_path / "out"
    assert main(["merge", str(halves / one), str(halves / other), "-o", str(out)]) == 2
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.err.count("\n") == 1
    assert not out.exists()


def test_an_ambiguous_alignment_is_refused(
    halves: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A map that shows the same walls in two places: those of the other fit into both."""
    shutil.copytree(halves / "lab-a", tmp_path / "twice")
    once = read_planes(tmp_path / "twice")
    again = replace(once, plane=once.plane + 10_000, ends=once.ends + np.array([60.0, 0.0]))
    columns = [field.name for field in fields(PlaneTable)]
    twice = {k: np.concatenate([getattr(once, k), getattr(again, k)]) for k in columns}
    write_planes(tmp_path / "twice", PlaneTable(**twice))
    merge = ["merge", tmp_path / "twice", halves / "lab-b", "-o", tmp_path / "out"]
    assert main([str(word) for word in merge]) == 2
    assert "common places in one alignment, and in " in capsys.readouterr().err


def test_long_walls_that_end_elsewhere_do_not_align_maps(
    halves: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three sides of two halls: 45 m coincide, and no other alignment has as much."""
    for name, low, high in (("one", 14.0, 14.0), ("other", 11.0, 17.0)):
        shutil.copytree(halves / "lab-a", tmp_path / name)
        hall = [[[0, 20], [0, 0]], [[0, 0], [low, 0]], [[high, 20], [0, 20]]]
        write_planes(tmp_path / name, walls_of(np.array(hall, dtype=float), [[-1, -1]] * 3))
    merge = ["merge", tmp_path / "one", tmp_path / "other", "-o", tmp_path / "out"]
    assert main([str(word) for word in merge]) == 2
    assert "3 walls coincide, but ends only in 2 places" in capsys.readouterr().err


def test_a_map_in_other_units_is_refused(
    halves: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before a search, which would be over as many cells as the map is larger."""
    shutil.copytree(halves / "lab-a", tmp_path / "mm")
    planes = read_planes(tmp_path / "mm")
    write_planes(tmp_path / "mm", replace(planes, ends=1000 * planes.ends))
    for pair in (["mm", "lab-b"], ["lab-b", "mm"]):
        folders = [str((tmp_path if name == "mm" else halves) / name) for name in pair]
        assert main(["merge", *folders, "-o", str(tmp_path / "out")]) == 2
        assert "both maps must be in metres" in capsys.readouterr().err


def test_freiburg_079_in_two_parts(shared_data: Path, tmp_path: Path) -> None:
    packed = shared_data / "carmen-laser2d" / "freiburg-079-corrected.log.gz"
    log = first_scans(packed, 350, tmp_path)
    for name, scans in (("a", "0:250"), ("b", "100:350")):
        run_relmap("map", log, "-o", tmp_path / name, "--variant", "planes", "--scans", scans)
    run_relmap("merge", tmp_path / "a", tmp_path / "b", "-o", tmp_path / "both")
    one, other = (read_tum(tmp_path / "both" / f"trajectory{name}.tum") for name in ("", "-2"))
    _, mine, theirs = np.intersect1d(one[0], other[0], return_indices=True)
    assert len(mine) > 125
    off = (one[1][mine] - other[1][theirs])[:, :2, 3]
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.1
