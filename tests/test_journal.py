"""The journal: its content, and runs that continue from it."""

from __future__ import annotations

import copy
import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap import MapperConfig, PlaneMapper, PointMapper, RelmapError
from relmap.io.journal import JournalReader, writing
from relmap.simulation import simulate_building
from tests.journals import begun, finished, run, scans_of


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("with_ids", [False, True])
def test_a_resumed_run_is_the_same_to_the_last_bit(
    tmp_path: Path, dimension: int, with_ids: bool
) -> None:
    scans = scans_of(dimension, with_ids)
    whole = finished(run(PointMapper(), scans))
    path = tmp_path / "run.journal"
    assert finished(run(PointMapper(journal=path), scans)) == whole
    for begin in (2, 55):
        path = tmp_path / f"{begin}.journal"
        run(PointMapper(journal=path), scans[:begin]).close()
        resumed = PointMapper.resume(path)
        assert resumed.n_iterations == begin
        assert finished(run(resumed, scans[begin:])) == whole
    assert finished(PointMapper.resume(path)) == whole


def test_calls_are_repeated_on_resume(tmp_path: Path) -> None:
    scans, path = scans_of(3, False), tmp_path / "run.journal"
    plain, kept = PointMapper(), PointMapper(journal=path)
    for mapper in (plain, kept):
        run(mapper, scans[:50]).refine()
        run(mapper, scans[50:70]).finish()
        run(mapper, scans[70:80])
    kept.finish()  # after the last scan: a resumed run has not called it yet
    kept.close()
    PointMapper.resume(path).close()
    assert finished(run(PointMapper.resume(path), scans[80:])) == finished(run(plain, scans[80:]))


def test_settings_are_those_of_the_journal(tmp_path: Path) -> None:
    settings = MapperConfig(group_after=6, registration="nearest-previous")
    PointMapper(settings, journal=tmp_path / "run.journal").close()
    assert PointMapper.resume(tmp_path / "run.journal").config == settings


def test_walls_are_kept_as_they_were_segmented(tmp_path: Path) -> None:
    scans = [scan.seen for scan in simulate_building(seed=0, points=20, iterations=80).scans]
    plain, kept = PlaneMapper(), PlaneMapper(journal=tmp_path / "run.journal")
    for scan in scans[:50]:
        np.testing.assert_array_equal(kept.update(scan), plain.update(scan))
    kept.close()
    resumed = PlaneMapper.resume(tmp_path / "run.journal")
    for scan in scans[50:]:
        np.testing.assert_array_equal(resumed.update(scan), plain.update(scan))
    for mapper in (plain, resumed):
        mapper.finish()
        mapper.refine()
    assert resumed.map.positions.tobytes() == plain.map.positions.tobytes()
    assert resumed.trajectory.tobytes() == plain.trajectory.tobytes()


def test_any_tool_reads_it(tmp_path: Path) -> None:
    scans, path = scans_of(3, True), tmp_path / "run.journal"
    mapper = PointMapper(journal=path)
    labels = [mapper.update(points, ids) for points, ids in scans]
    mapper.flush()
    with sqlite3.connect(path) as other:  # while the run goes on
        rows = other.execute(
            "SELECT iteration, row, x, y, z, id, landmark FROM observations ORDER BY 1, 2"
        ).fetchall()
        assert other.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    other.close()
    expected = [
        (k, i, *point, int(known), int(label))
        for k, ((points, ids), of) in enumerate(zip(scans, labels, strict=True))
        for i, (point, known, label) in enumerate(zip(points.tolist(), ids, of, strict=True))
    ]
    assert rows == expected
    mapper.close()


def test_flushed_scans_are_on_disk_and_others_within_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def held(path: Path) -> int:
        with JournalReader(path) as reader:
            return len(list(reader.scans()))

    clock = [0.0]
    monkeypatch.setattr(writing, "monotonic", lambda: clock[0])
    scans, path = scans_of(3, False), tmp_path / "run.journal"
    mapper = PointMapper(journal=path)
    run(mapper, scans[:10])
    assert held(path) == 0
    mapper.flush()
    assert held(path) == 10
    run(mapper, scans[10:15])
    assert held(path) == 10
    clock[0] += 1.01
    run(mapper, scans[15:16])
    assert held(path) == 16
    mapper.close()


def connected(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[PointMapper, sqlite3.Connection]:
    """Return a mapper with a journal, and the connection that it keeps open."""
    opened: list[sqlite3.Connection] = []
    connect: Any = sqlite3.connect

    def noted(*args: Any, **settings: Any) -> sqlite3.Connection:
        opened.append(connect(*args, **settings))
        return opened[-1]

    with monkeypatch.context() as patch:
        patch.setattr(sqlite3, "connect", noted)
        return PointMapper(journal=path), opened[-1]


def test_a_full_disk_is_reported_before_a_scan_is_processed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans, path = scans_of(3, False), tmp_path / "run.journal"
    mapper, connection = connected(path, monkeypatch)
    run(mapper, scans[:20])
    mapper.flush()
    connection.execute("PRAGMA max_page_count = 8")
    with pytest.raises(RelmapError, match=r"cannot be written: database or disk is full; the 20 "):
        run(mapper, scans[20:]).flush()
    taken = mapper.n_iterations
    with pytest.raises(RelmapError, match="disk is full"):
        mapper.update(scans[taken][0])
    assert mapper.n_iterations == taken
    with JournalReader(path) as reader:
        assert len(list(reader.scans())) == 20
    connection.execute("PRAGMA max_page_count = 100000")
    whole = finished(run(PointMapper(), scans))
    run(mapper, scans[taken:]).close()
    assert finished(PointMapper.resume(path)) == whole


def test_a_copy_keeps_no_journal(tmp_path: Path) -> None:
    mapper = begun(tmp_path / "run.journal", close=False)
    scans = scans_of(3, False)
    twin = copy.deepcopy(mapper)
    assert finished(run(twin, scans[60:])) == finished(run(mapper, scans[60:]))
    mapper.close()
    assert PointMapper.resume(tmp_path / "run.journal").n_iterations == 120


def test_a_journal_is_never_written_over(tmp_path: Path) -> None:
    begun(tmp_path / "run.journal")
    before = (tmp_path / "run.journal").read_bytes()
    with pytest.raises(RelmapError, match="already exists"):
        PointMapper(journal=tmp_path / "run.journal")
    assert (tmp_path / "run.journal").read_bytes() == before
    with pytest.raises(RelmapError, match="cannot be written: unable to open"):
        PointMapper(journal=tmp_path / "missing" / "run.journal")


def test_files_of_a_killed_run_are_not_used_by_the_next(tmp_path: Path) -> None:
    path, wal = tmp_path / "run.journal", tmp_path / "run.journal-wal"
    mapper = begun(path, 30, close=False)
    mapper.flush()
    left = wal.read_bytes()
    mapper.close()
    path.unlink()
    wal.write_bytes(left)
    begun(path, 10)
    assert PointMapper.resume(path).n_iterations == 10


def test_two_runs_that_continue_one_journal_do_not_mix(tmp_path: Path) -> None:
    path, scans = tmp_path / "run.journal", scans_of(3, False)
    begun(path)
    one, other = PointMapper.resume(path), PointMapper.resume(path)
    run(one, scans[60:65]).flush()
    with pytest.raises(RelmapError, match="another program has continued it; the 60 "):
        run(other, scans[60:65]).flush()
    one.close()
    assert PointMapper.resume(path).n_iterations == 65


def test_calls_that_cannot_be_recorded_are_not_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans, path = scans_of(3, False), tmp_path / "run.journal"
    mapper, connection = connected(path, monkeypatch)
    run(mapper, scans[:60])
    connection.execute("PRAGMA query_only = 1")
    for ask in (mapper.finish, mapper.refine):
        with pytest.raises(RelmapError, match="cannot be written"):
            ask()
    connection.execute("PRAGMA query_only = 0")
    run(mapper, scans[60:]).close()
    assert finished(PointMapper.resume(path)) == finished(run(PointMapper(), scans))


def test_other_files_and_other_variants(tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    with pytest.raises(RelmapError, match="there is no journal"):
        PointMapper.resume(path)
    path.write_text("iteration,x,y\n" * 100)
    with pytest.raises(RelmapError, match="is not a journal"):
        PointMapper.resume(path)
    path.unlink()
    begun(path)
    with pytest.raises(RelmapError, match="is of points, and PlaneMapper maps planes"):
        PlaneMapper.resume(path)


def test_mapping_again_must_give_the_recorded_landmarks(tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    begun(path)
    # As if another version had found other landmarks: all checksums are right.
    with JournalReader(path) as reader:
        scans, layout, meta = list(reader.scans()), reader.layout, reader.meta
    path.unlink()
    other = writing.Journal.create(path, layout, meta)
    for k, scan in enumerate(scans):
        other.append(replace(scan, labels=scan.labels + (k == 31)))
    other.close()
    with pytest.raises(
        RelmapError, match=r"iteration 31 mapped again gives landmarks other.*numpy"
    ):
        PointMapper.resume(path)
