"""Journals and saved states of planes in space: what continues from them is the same to the bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.simulation.storey import simulate_storey
from tests.savedmaps import state

N = 14


@pytest.fixture(scope="module")
def scans() -> list[Floats]:
    """Clouds of two storeys, some empty; the second one begins another submap."""
    world = simulate_storey("depth", 0.01, N)
    there = [scan[:, [2, 0, 1]] * 1.3 for scan in simulate_storey("lidar", 0.01, 6).scans]
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
    for begin in (0, 9, 18):
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
        if k in (0, 1, 4, 8, 9, 18):
            mapper.save(tmp_path / "mapper.npz")
            mapper = Plane3dMapper.load(tmp_path / "mapper.npz")
        run(mapper, [scan])
    assert ended(mapper, tmp_path) == whole


def test_runs_go_on_after_finish_and_refine(scans: list[Floats], tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    plain, kept, saved = Plane3dMapper(), Plane3dMapper(journal=path), Plane3dMapper()
    for begin, end in ((0, 6), (6, 16)):
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
