"""Changed and damaged journals: their errors, and what is recovered."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from relmap import PointMapper, RelmapError
from relmap.io.journal import JournalReader, salvage
from tests.journals import begun, changed, finished, run, scans_of


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
        ("CREATE TRIGGER more AFTER INSERT ON scans BEGIN DELETE FROM meta; END", "has a trigger"),
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
    with pytest.raises(RelmapError, match="was recovered before: resume it without --salvage"):
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
    if share == 0.1:
        with pytest.raises(RelmapError, match=r"truncated.* if its header is undamaged"):
            PointMapper.resume(path)
        with pytest.raises(RelmapError, match="header is damaged"):
            salvage(path)
    else:
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
