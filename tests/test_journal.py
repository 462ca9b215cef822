"""The journal: its content, and runs that continue from it."""

from __future__ import annotations

import copy
import random
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap import MapperConfig, PlaneMapper, PointMapper, RelmapError
from relmap.io.journal import JournalReader, salvage, writing
from relmap.simulation import simulate_building
from tests.journals import changed
from tests.worlds import walk


def finished(mapper: PointMapper) -> tuple[bytes, ...]:
    """Return what the rest of a run makes of a mapper, to the last bit."""
    mapper.finish()
    before = mapper.map.positions.tobytes()
    mapper.refine()
    table = mapper.landmarks
    return before, mapper.map.positions.tobytes(), mapper.trajectory.tobytes(), table.sd.tobytes()


def scans_of(dimension: int, with_ids: bool) -> list[tuple[Any, Any]]:
    """Return scans, some of them empty, some with landmarks that nobody knows."""
    scans: list[tuple[Any, Any]] = []
    for k, (ids, points) in enumerate(walk(dimension, 7, 0.02).scans):
        known = np.where(np.arange(len(ids)) == k % 5, -1, ids) if with_ids else None
        scans.append((points, known))
    nothing = np.empty((0, dimension)), np.empty(0, dtype=np.int64) if with_ids else None
    scans[0] = scans[1] = scans[40] = nothing
    return scans


def run(mapper: PointMapper, scans: list[tuple[Any, Any]]) -> PointMapper:
    for points, ids in scans:
        mapper.update(points, ids)
    return mapper


def begun(path: Path, n: int = 60, close: bool = True) -> PointMapper:
    mapper = run(PointMapper(journal=path), scans_of(3, False)[:n])
    if close:
        mapper.close()
    return mapper


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
    kept.finish()  # after the last scan: whoever goes on has not asked for that yet
    kept.close()
    assert finished(run(PointMapper.resume(path), scans[80:])) == finished(run(plain, scans[80:]))


def test_settings_are_those_of_the_journal(tmp_path: Path) -> None:
    settings = MapperConfig(group_after=6, registration="nearest-previous")
    PointMapper(settings, journal=tmp_path / "run.journal").close()
    assert PointMapper.resume(tmp_path / "run.journal").config == settings


def test_walls_are_kept_as_they_were_segmented(tmp_path: Path) -> None:
    scans = [scan.seen for scan in simulate_building(seed=0, points=20).scans][:80]
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


def test_files_of_a_killed_run_are_not_used_by_the_next(
    tmp_path: Path,
) -> None:
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


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("PRAGMA user_version = 4", "is of version 4, and this relmap reads 3: a newer relmap"),
        ("PRAGMA user_version = 2", "is of version 2, and this relmap reads 3: map its log again"),
        ("PRAGMA application_id = 7", "not a journal of relmap"),
        ("DROP TABLE scans", "table scans has an unexpected definition"),
        ("DELETE FROM meta WHERE key = 'variant'", "lacks variant or configuration"),
        ("UPDATE meta SET value = '{' WHERE key = 'variant'", "header is damaged"),
        ("UPDATE calls SET call = 'x'", ""),
        (
            "CREATE TRIGGER more AFTER INSERT ON scans BEGIN DELETE FROM meta; END",
            "has a trigger",
        ),
        ("UPDATE scans SET checksum = 0 WHERE iteration = 30", "30 scans before can be recovered"),
        ("UPDATE observations SET x = x + 1e-9 WHERE iteration = 20", "at iteration 20"),
        ("UPDATE observations SET x = 'far' WHERE iteration = 20", "at iteration 20"),
        ("UPDATE scans SET rows = 4611686018427387904 WHERE iteration = 9", "at iteration 9"),
        ("UPDATE scans SET rows = 'many' WHERE iteration = 9", "at iteration 9"),
        ("DELETE FROM observations WHERE iteration = 33 AND row = 2", "at iteration 33"),
        ("DELETE FROM scans WHERE iteration = 12", "at iteration 12"),
        ("DELETE FROM scans WHERE iteration = 59", "observations without a scan"),
        ("UPDATE scans SET known = 1 WHERE iteration = 2", "at iteration 2: ids are missing"),
        ("UPDATE observations SET landmark = landmark + 0.5 WHERE iteration = 20", "float64 where"),
        ("UPDATE observations SET id = 7 WHERE iteration = 20", "at iteration 20: ids are"),
        (
            "UPDATE meta SET value = '{\"group_after\": 9}' WHERE key = 'configuration'",
            "at iteration 0",
        ),
        ("UPDATE meta SET value = 'null' WHERE key = 'versions'", "at iteration 0"),
        ("INSERT INTO meta VALUES ('more', '1')", "at iteration 0"),
        ("DELETE FROM meta WHERE key = 'end'", "at iteration 60: it should end"),
        ("INSERT INTO calls VALUES (30, 'finish')", "30 scans before can be recovered"),
        ("INSERT INTO calls VALUES (60, 'finish')", "60: it should end there"),
        ("INSERT INTO calls VALUES (90, 'finish')", "60: it should end there"),
    ],
)
def test_an_invalid_journal_is_refused(tmp_path: Path, statement: str, message: str) -> None:
    begun(tmp_path / "run.journal")
    changed(tmp_path / "run.journal", statement)
    if not message:
        assert PointMapper.resume(tmp_path / "run.journal").n_iterations == 60
        return
    with pytest.raises(RelmapError, match=message):
        PointMapper.resume(tmp_path / "run.journal")


def test_scans_that_are_left_out_at_the_end_are_missed(tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    begun(path)
    for name in ("scans", "observations"):
        changed(path, f"DELETE FROM {name} WHERE iteration >= 50")
    with pytest.raises(RelmapError, match="at iteration 50: it should end there, after 60 scans"):
        PointMapper.resume(path)
    assert salvage(path) == 50


def kept_with_covariances(path: Path) -> PointMapper:
    mapper = PointMapper(journal=path)
    for points, _ in scans_of(2, False)[:12]:
        noise = np.broadcast_to(np.diag([1e-4, 2e-4]), (len(points), 2, 2))
        mapper.update(points, covariances=noise)
    mapper.refine()
    return mapper


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE covariances SET xx = xx * 2 WHERE iteration = 7 AND row = 1", "at iteration 7"),
        ("UPDATE covariances SET zz = 1.0 WHERE iteration = 7 AND row = 1", "at iteration 7"),
        ("UPDATE observations SET z = 1.0 WHERE iteration = 7 AND row = 1", "at iteration 7"),
        ("INSERT INTO covariances VALUES (99, 0, 1, 0, 0, 1, 0, 1)", "without a scan"),
        ("DELETE FROM calls", "at iteration 12: it should end there"),
        ("UPDATE calls SET call = 'finish'", "at iteration 12: it should end there"),
    ],
)
def test_other_tables_are_checked_too(tmp_path: Path, statement: str, message: str) -> None:
    path = tmp_path / "run.journal"
    kept_with_covariances(path).close()
    assert PointMapper.resume(path).n_iterations == 12
    kept_with_covariances(tmp_path / "again").close()
    changed(tmp_path / "again", statement)
    with pytest.raises(RelmapError, match=message):
        PointMapper.resume(tmp_path / "again")


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
        other.append(scan.values, scan.ids, scan.labels + (k == 31))
    other.close()
    with pytest.raises(
        RelmapError, match=r"iteration 31 mapped again gives landmarks other.*numpy"
    ):
        PointMapper.resume(path)


def test_salvage_recovers_the_scans_before_the_damage(tmp_path: Path) -> None:
    scans, path = scans_of(3, False), tmp_path / "run.journal"
    whole = finished(run(PointMapper(), scans))
    begun(path, 120)
    data = bytearray(path.read_bytes())
    middle = len(data) * 2 // 3
    data[middle : middle + 3000] = random.Random(0).randbytes(3000)
    path.write_bytes(data)
    with pytest.raises(RelmapError, match="scans before can be recovered: relmap resume --salvage"):
        PointMapper.resume(path)
    n = salvage(path)
    assert 30 < n < 120
    assert path.with_name("run.journal.damaged").read_bytes() == data
    resumed = PointMapper.resume(path)
    assert resumed.n_iterations == n
    assert finished(run(resumed, scans[n:])) == whole
    with pytest.raises(RelmapError, match=r"damaged already exists"):
        salvage(path)


def test_salvage_that_was_killed_before_its_last_step_is_ended(tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    begun(path)
    changed(path, "UPDATE scans SET checksum = 0 WHERE iteration = 30")
    assert salvage(path) == 30
    path.rename(tmp_path / "run.journal.whole")
    assert salvage(path) == 30
    assert PointMapper.resume(path).n_iterations == 30


def test_of_a_journal_with_another_configuration_nothing_is_salvaged(tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    begun(path)
    changed(path, "UPDATE meta SET value = '{\"group_after\": 9}' WHERE key = 'configuration'")
    before = path.read_bytes()
    with pytest.raises(RelmapError, match="nothing of it can be recovered: map its log again"):
        salvage(path)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["run.journal"]


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_truncated_journal_is_recovered_or_refused(tmp_path: Path, share: float) -> None:
    path = tmp_path / "run.journal"
    begun(path, 120)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(RelmapError, match="recovered"):
        PointMapper.resume(path)
    if share > 0.1:
        n = salvage(path)
        assert 0 < n < 120
        assert PointMapper.resume(path).n_iterations == n


def test_any_overwritten_byte_is_detected_or_harmless(tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    begun(path, 60)
    data, rng = path.read_bytes(), np.random.default_rng(0)
    with JournalReader(path) as reader:
        whole = [scan.values.tobytes() for scan in reader.scans()]
    for _ in range(150):
        broken = bytearray(data)
        at, n = int(rng.integers(len(data))), int(rng.integers(1, 300))
        broken[at : at + n] = rng.bytes(len(broken[at : at + n]))
        path.write_bytes(broken)
        found: list[bytes] = []
        try:
            with JournalReader(path) as reader:
                found.extend(scan.values.tobytes() for scan in reader.scans())
            said = ""
        except RelmapError as error:
            said = str(error)
        assert said or found == whole
        assert not said or any(part in said for part in ("recovered", "newer relmap", "SQLite"))
        assert found == whole[: len(found)]
        for ending in ("-wal", "-shm"):
            path.with_name(path.name + ending).unlink(missing_ok=True)
