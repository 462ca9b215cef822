"""Journals and saved states of planes in space: what continues from them is the same to the bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap import Plane3dMapper, PlaneMapper, PointMapper, RelmapError, map_log
from relmap.cli import main
from relmap.core.arrays import Floats
from relmap.datasets import open_scans
from relmap.segmentation.space import PatchSegmenter
from relmap.simulation.storey import simulate_storey
from tests.commands import load, names, run_relmap, unrendered
from tests.journals import changed, end_after, kill_after
from tests.savedmaps import state

N = 10


@pytest.fixture(scope="module")
def scans() -> list[Floats]:
    """Clouds of two storeys, some empty; the second one begins another submap."""
    world = simulate_storey("depth", 0.01, N)
    there = [scan[:, [2, 0, 1]] * 1.3 for scan in simulate_storey("lidar", 0.01, 6).scans[:4]]
    none = np.empty((0, 3))
    return [none, *world.scans[:6], none, *world.scans[6:], *there]


def ended(mapper: Plane3dMapper, folder: Path) -> tuple[bytes, ...]:
    """Return everything that a mapper holds before and after the end of a run."""
    before = state(mapper, folder)
    mapper.finish()
    finished = state(mapper, folder)
    mapper.refine()
    table = mapper.planes
    values = mapper.trajectory.tobytes(), table.offset.tobytes(), table.status.tobytes()
    return before, finished, state(mapper, folder), *values


def run(mapper: Plane3dMapper, scans: list[Floats]) -> Plane3dMapper:
    for k, scan in enumerate(scans, mapper.n_iterations):
        mapper.update(scan, stamp_s=0.5 * k)
    return mapper


@pytest.fixture(scope="module")
def whole(scans: list[Floats], tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, ...]:
    mapper = run(Plane3dMapper(), scans)
    assert len(mapper.submaps) > 1
    return ended(mapper, tmp_path_factory.mktemp("whole"))


def test_a_resumed_run_is_the_same_to_the_last_bit(
    scans: list[Floats], whole: tuple[bytes, ...], tmp_path: Path
) -> None:
    path = tmp_path / "run.journal"
    for begin in (0, 9):
        path.unlink(missing_ok=True)
        run(Plane3dMapper(journal=path), scans[:begin]).close()
        resumed = Plane3dMapper.resume(path)
        assert resumed.n_iterations == begin
        assert ended(run(resumed, scans[begin:]), tmp_path) == whole
    assert ended(Plane3dMapper.resume(path), tmp_path) == whole


def test_a_loaded_run_continues_identically(
    scans: list[Floats], whole: tuple[bytes, ...], tmp_path: Path
) -> None:
    mapper = Plane3dMapper()
    for k, scan in enumerate(scans):
        if k in (0, 1, 4, 8, 9, 14):
            mapper.save(tmp_path / "mapper.npz")
            mapper = Plane3dMapper.load(tmp_path / "mapper.npz")
        run(mapper, [scan])
    assert ended(mapper, tmp_path) == whole


def test_runs_go_on_after_finish_and_refine(scans: list[Floats], tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    plain, kept, saved = Plane3dMapper(), Plane3dMapper(journal=path), Plane3dMapper()
    for begin, end in ((0, 6), (6, 12)):
        for mapper in (plain, kept, saved):
            run(mapper, scans[begin:end]).finish()
            mapper.refine()
        saved.save(tmp_path / "mapper.npz")
        saved = Plane3dMapper.load(tmp_path / "mapper.npz")
        kept.update(scans[end])
        kept.close()
        kept = Plane3dMapper.resume(path)
        for mapper in (plain, saved):
            mapper.update(scans[end])
    expected = ended(plain, tmp_path)
    assert ended(saved, tmp_path) == expected
    assert ended(kept, tmp_path) == expected


def same(result: Path, other: Path) -> bool:
    """Return whether two result folders agree but for times and pictures."""
    files = {name for name in names(other) if not name.endswith((".json", ".html", ".png"))}
    assert {"mapper.npz", "planes.csv", "map.ply", "trajectory.tum"} <= files
    return all((result / name).read_bytes() == (other / name).read_bytes() for name in files)


@pytest.fixture(scope="module")
def storey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated log, and its map from a run that was not stopped."""
    folder = tmp_path_factory.mktemp("storey")
    run_relmap("simulate", "storey", "-o", folder / "log", "--iterations", "10")
    with unrendered():
        run_relmap("map", folder / "log", "-o", folder / "whole", "--variant", "planes3d")
    return folder


@unrendered()
def test_relmap_resume_after_a_kill(
    storey: Path, tmp_path: Path, child_env: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    journal = tmp_path / "run.journal"
    out = tmp_path / "out"
    command = f"map log -o {out} --variant planes3d"
    kill_after(6, journal, command, env=child_env, cwd=storey)
    assert not (out / "summary.json").exists()
    run_relmap("resume", journal)
    assert same(tmp_path / "out", storey / "whole")
    run_relmap("resume", journal, "-o", tmp_path / "again")
    assert "none of them new" in capsys.readouterr().out
    assert same(tmp_path / "again", storey / "whole")


@unrendered()
def test_a_truncated_journal_is_recovered_and_resumed(storey: Path, tmp_path: Path) -> None:
    journal, out = tmp_path / "run.journal", tmp_path / "out"
    asked = ["-o", out, "--variant", "planes3d", "--voxel", "0.3", "--scans", "1:9"]
    run_relmap("map", storey / "log", *asked, "--journal", journal)
    whole = tmp_path / "whole"
    out.rename(whole)
    end_after(journal, 5)
    data = journal.read_bytes()
    journal.write_bytes(data[: len(data) * 3 // 4])
    with pytest.raises(RelmapError, match="relmap resume --salvage"):
        Plane3dMapper.resume(journal)
    run_relmap("resume", journal, "--salvage")
    assert same(out, whole)
    assert load(out / "summary.json")["configuration"]["voxel_m"] == 0.3
    assert "--voxel 0.3" in (out / "report.html").read_text()


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE observations SET spread_n = 0 WHERE iteration = 2 AND row = 1", "at iteration 2"),
        ("UPDATE scans SET cells = zeroblob(30) WHERE iteration = 1", "at iteration 1"),
        ("UPDATE scans SET cells = 'none' WHERE iteration = 1", "its cells are not bytes"),
        ("UPDATE meta SET value = '{}' WHERE key = 'configuration'", "its configuration: {}"),
    ],
)
def test_a_changed_journal_is_refused(
    scans: list[Floats], tmp_path: Path, statement: str, message: str
) -> None:
    run(Plane3dMapper(journal=tmp_path / "run.journal"), scans[:4]).close()
    changed(tmp_path / "run.journal", statement)
    with pytest.raises(RelmapError, match=message):
        Plane3dMapper.resume(tmp_path / "run.journal")


def test_maps_and_journals_of_another_kind_are_refused(
    storey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    planes, points = storey / "whole" / "mapper.npz", tmp_path / "points.npz"
    PointMapper().save(points)
    for kind, path in ((PointMapper, planes), (PlaneMapper, planes), (Plane3dMapper, points)):
        with pytest.raises(RelmapError, match=r"holds a map of .*, not a map of "):
            kind.load(path)
    Plane3dMapper(journal=tmp_path / "run.journal").close()
    with pytest.raises(RelmapError, match="is of planes3d, and PlaneMapper maps planes"):
        PlaneMapper.resume(tmp_path / "run.journal")
    asked = ["localise", str(storey / "log"), "--map", str(storey / "whole")]
    assert main([*asked, "-o", str(tmp_path / "no")]) == 2
    assert "a map of planes in space, not a map of points or walls" in capsys.readouterr().err


def test_layout_and_sign_of_zero_do_not_matter() -> None:
    cloud = simulate_storey("lidar", 0.01, 2).scans
    plain, other = Plane3dMapper(), Plane3dMapper()
    for points in cloud:
        seen = PatchSegmenter().fit(points).patches_
        centre = np.asfortranarray(np.where(seen.centre == 0, -0.0, seen.centre))
        plain.update(seen)
        other.update(replace(seen, centre=centre, loose=np.asfortranarray(seen.loose)))
    assert plain.trajectory.tobytes() == other.trajectory.tobytes()
    with pytest.raises(RelmapError, match="spread of the patches has a number that is not finite"):
        plain.update(replace(seen, spread=seen.spread * np.nan))
    assert plain.n_iterations == 2


@pytest.mark.parametrize(
    ("changed", "wrong"),
    [
        ({"centre": np.zeros((1, 3))}, "centre of the patches has the shape"),
        ({"loose": np.zeros((4, 2))}, "loose of the patches has the shape"),
        ({"cells": np.zeros((5, 3))}, "cells of the patches has the shape"),
        ({"cell_patch": 1}, "must ascend"),
        ({"cell_patch": -1}, "must ascend"),
        ({"reach_m": 0.0}, "must be above 0"),
        ({"cell_m": np.nan}, "must be above 0"),
    ],
)
def test_patches_that_do_not_fit_together_leave_the_mapper_as_it_was(
    changed: dict[str, Any], wrong: str
) -> None:
    mapper, scans = Plane3dMapper(), simulate_storey("lidar", 0.01, 2).scans
    mapper.update(scans[0])
    seen = PatchSegmenter().fit(scans[1]).patches_
    if isinstance(changed.get("cell_patch"), int):
        changed = {"cell_patch": seen.cell_patch + changed["cell_patch"]}
    with pytest.raises(RelmapError, match=wrong):
        mapper.update(replace(seen, **changed))
    assert len(mapper.update(seen)) == len(seen)


def test_patches_of_other_types_of_numbers_are_kept(tmp_path: Path) -> None:
    seen = PatchSegmenter().fit(simulate_storey("lidar", 0.01, 1).scans[0]).patches_
    narrow = replace(
        seen,
        loose=seen.loose.astype(np.float32),
        n_points=seen.n_points.astype(np.int32),
        cell_patch=seen.cell_patch.astype(np.int32),
    )
    mapper = Plane3dMapper()
    mapper.update(narrow)
    mapper.save(tmp_path / "map.npz")
    assert len(Plane3dMapper.load(tmp_path / "map.npz").submaps[0]) == len(seen)


def test_memory_of_a_saved_state_is_that_of_the_map(tmp_path: Path) -> None:
    """Where the sensor stands still, a scan adds its patches, and hardly any points."""
    seen = PatchSegmenter().fit(simulate_storey("lidar", 0.01, 1).scans[0]).patches_
    mapper, sizes = Plane3dMapper(), []
    for k in range(30):
        mapper.update(seen)
        if k in (9, 19, 29):
            sizes.append(len(state(mapper, tmp_path)))
    assert sizes[2] - sizes[1] <= 10 * 200 * len(seen)
    with np.load(tmp_path / "state.npz") as content:
        members = set(content)
    assert {"submaps/0/seen/centre", "submaps/0/match", "submaps/0/scatter"} <= members
    assert len(members) < 60


@unrendered()
def test_results_of_a_mapper_without_its_log(storey: Path, tmp_path: Path) -> None:
    whole = storey / "whole"
    mapper = Plane3dMapper.load(whole / "mapper.npz")
    mapper.save_results(tmp_path / "out")
    assert names(tmp_path / "out") == names(whole)
    for name in ("planes.csv", "landmarks.csv", "map.ply", "trajectory.tum", "mapper.npz"):
        assert (tmp_path / "out" / name).read_bytes() == (whole / name).read_bytes()
    run_relmap("evaluate", tmp_path / "out", "--truth", storey / "log")
    assert load(tmp_path / "out" / "evaluation.json")["ate_m"] < 0.003
    assert len(mapper.plot().axes) == 2
    Plane3dMapper().save_results(tmp_path / "nothing")
    assert load(tmp_path / "nothing" / "summary.json")["submaps"] == []


def test_map_log_takes_the_mapper(storey: Path) -> None:
    mapper = Plane3dMapper()
    run_of = map_log(open_scans(storey / "log"), mapper)
    assert mapper.stamps_s.tolist() == list(range(10))
    assert run_of.result.summary["refined"]
    assert mapper.is_refined
    assert len(run_of.result.poses) == 10
    with pytest.raises(RelmapError, match="maps one log; this one has mapped another"):
        map_log(open_scans(storey / "log"), mapper)
    with pytest.raises(RelmapError, match="has no known association"):
        map_log(open_scans(storey / "log"), Plane3dMapper(), association="known")
    mapper.update(np.empty((0, 3)))
    assert not mapper.is_refined
