"""Files are written atomically, and numbers are read back exactly."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from relmap import PointMapper, RelmapError
from relmap.exports.formats import export
from relmap.io.files import WHOLE, atomic_write, read_text, read_tum, staged_folder, write_tum
from relmap.io.journal import salvage
from relmap.io.results import read_names, read_result
from tests.tables import poses_along


def full_disk(_: int) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def names(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_atomic_write_replaces_the_earlier_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    atomic_write(path, "old")
    atomic_write(path, b"new")
    assert path.read_bytes() == b"new"
    assert names(tmp_path) == ["a.txt"]


def test_new_files_have_the_usual_permissions(tmp_path: Path) -> None:
    plain, ours = tmp_path / "plain", tmp_path / "ours"
    plain.write_text("")
    atomic_write(ours, "")
    assert ours.stat().st_mode == plain.stat().st_mode


def test_atomic_write_leaves_the_earlier_file_where_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(RelmapError, match=r"cannot write .*a\.txt: No space left"):
        atomic_write(path, "new")
    assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("at", range(6))
def test_a_kill_between_two_files_leaves_no_mixture_that_counts_as_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    for name in ("landmarks.csv", "stale.csv", "summary.json", "trajectory.tum"):
        (tmp_path / name).write_text("old")
    steps = 0

    def counted(call: Callable[..., object]) -> Callable[..., object]:
        def step(*arguments: object, **more: object) -> object:
            nonlocal steps
            if steps == at:
                raise KeyboardInterrupt
            steps += 1
            return call(*arguments, **more)

        return step

    with suppress(KeyboardInterrupt), staged_folder(tmp_path, ["stale.csv"]) as staging:
        for name in ("landmarks.csv", "summary.json", "trajectory.tum"):
            (staging / name).write_text("new")
        monkeypatch.setattr(Path, "unlink", counted(Path.unlink))
        monkeypatch.setattr(Path, "replace", counted(Path.replace))
    monkeypatch.undo()
    texts = {path.name: path.read_text() for path in tmp_path.iterdir()}
    if "summary.json" in texts:
        assert set(texts.values()) == {"old" if at == 0 else "new"}
        assert ("stale.csv" in texts) == (at == 0)
    assert (at == 5) == (texts.get("summary.json") == "new")


def test_a_kill_between_two_moves_leaves_no_old_file_beside_a_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved: list[set[str]] = []
    replace = Path.replace

    def watched(self: Path, target: Path) -> Path:
        moved.append({path.read_text() for path in tmp_path.glob("*.*") if path.is_file()})
        return replace(self, target)

    def write(text: str, *written: str) -> None:
        with staged_folder(tmp_path) as staging:
            for name in written:
                (staging / name).write_text(text)

    write("old", "a.csv", "b.csv", "c.csv")
    monkeypatch.setattr(Path, "replace", watched)
    write("new", "a.csv", "b.csv", "c.csv")
    assert moved == [set(), {"new"}, {"new"}]
    write("alone", "a.csv")
    assert moved[3:] == [{"new"}]


def test_staged_files_arrive_together_with_their_folders(tmp_path: Path) -> None:
    target = tmp_path / "new" / "folder"
    with staged_folder(target) as staging:
        (staging / "a").write_text("1")
        (staging / "sub").mkdir()
        (staging / "sub" / "b").write_text("2")
        assert names(target) == [staging.name, f"{staging.name}/a"] + [
            f"{staging.name}/{name}" for name in ("sub", "sub/b")
        ]
    assert names(target) == ["a", "sub", "sub/b"]


def test_stale_files_go_only_when_the_new_ones_have_come(tmp_path: Path) -> None:
    (tmp_path / "figures").write_text("of the old")
    with pytest.raises(ValueError, match="x"), staged_folder(tmp_path, stale=["figures", "none"]):
        int("x")
    assert names(tmp_path) == ["figures"]
    with staged_folder(tmp_path, stale=["figures", "none"]) as staging:
        (staging / "a").write_text("1")
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, OSError(errno.ENOSPC, "full")])
def test_failure_leaves_nothing_behind(tmp_path: Path, error: type[BaseException]) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "a").write_text("old")

    def write(target: Path) -> None:
        with staged_folder(target) as staging:
            (staging / "a").write_text("new")
            raise error

    for target in (kept, tmp_path / "new" / "folder"):
        with pytest.raises((KeyboardInterrupt, ValueError, RelmapError)):
            write(target)
    assert names(tmp_path) == ["kept", "kept/a"]
    assert (kept / "a").read_text() == "old"


def test_messages_name_the_folder_and_not_where_files_wait(tmp_path: Path) -> None:
    pattern = f"^cannot write {tmp_path}/none/a: No"
    with pytest.raises(RelmapError, match=pattern), staged_folder(tmp_path) as staging:
        atomic_write(staging / "none" / "a", "")


@pytest.mark.parametrize("name", ["file", "file/below", "x" * 300])
def test_folder_that_cannot_be_is_found_before_the_work(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("old")
    with pytest.raises(RelmapError, match="cannot write into"), staged_folder(tmp_path / name):
        atomic_write(tmp_path / "written", "the body ran")
    assert names(tmp_path) == ["file"]


def test_folder_in_the_place_of_a_file_stops_all_files(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()

    def write() -> None:
        with staged_folder(tmp_path) as staging:
            (staging / "a").write_text("1")
            (staging / "b").write_text("2")

    with pytest.raises(RelmapError, match="a folder of that name"):
        write()
    assert names(tmp_path) == ["b"]


def test_folder_in_the_place_of_a_stale_file_leaves_the_earlier_result(tmp_path: Path) -> None:
    (tmp_path / "names.csv").mkdir()
    (tmp_path / WHOLE).write_text("old")

    def write() -> None:
        with staged_folder(tmp_path, ["names.csv"]) as staging:
            (staging / WHOLE).write_text("new")

    with pytest.raises(RelmapError, match=r"names.csv: a folder of that name"):
        write()
    assert (tmp_path / WHOLE).read_text() == "old"


numbers = st.floats(-1e9, 1e9)


@given(st.lists(st.tuples(numbers, numbers, numbers, numbers), max_size=4), st.integers(0, 99))
def test_tum_keeps_every_bit_of_stamps_and_positions(
    tmp_path_factory: pytest.TempPathFactory,
    rows: list[tuple[float, float, float, float]],
    seed: int,
) -> None:
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    poses = poses_along(*table[:, 1:].T)
    if len(table):
        poses[:, :3, :3] = Rotation.random(len(table), seed).as_matrix()
    path = tmp_path_factory.getbasetemp() / "path.tum"
    write_tum(path, table[:, 0], poses)
    stamps_s, again = read_tum(path)
    np.testing.assert_array_equal(stamps_s, table[:, 0])
    np.testing.assert_array_equal(again[:, :, 3], poses[:, :, 3])
    np.testing.assert_allclose(again, poses, rtol=0, atol=1e-15)


def test_tum_takes_comments_and_quaternions_of_other_lengths(tmp_path: Path) -> None:
    path = tmp_path / "path.tum"
    path.write_text("# t x y z qx qy qz qw\n\n1 2 3 4 0 0 2 0\r\n  # more\n")
    stamps_s, poses = read_tum(path)
    assert stamps_s.tolist() == [1.0]
    np.testing.assert_allclose(poses[0], [[-1, 0, 0, 2], [0, -1, 0, 3], [0, 0, 1, 4], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 2 3", r"line 2: .* expected 8 numbers"),
        ("1 2 3 4 0 0 0 1 5", r"line 2: .* expected 8 numbers"),
        ("1 2 x 4 0 0 0 1", r"line 2: '1 2 x 4 0 0 0 1', expected 8 numbers"),
        ("1 2 nan 4 0 0 0 1", r"line 2: .* expected 8 numbers"),
        ("inf 2 3 4 0 0 0 1", r"line 2: .* expected 8 numbers"),
        ("1 2 1e300 4 0 0 0 1", r"line 2: .* expected 8 numbers"),
        ("1 2 3 4 0 0 0 0", r"line 2: the quaternion"),
        ("1 2 3 4 0 0 0 1e200", r"line 2: .* expected 8 numbers"),
    ],
)
def test_bad_tum_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "path.tum"
    path.write_text(f"0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(RelmapError, match=message):
        read_tum(path)


def test_pose_that_is_not_finite_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(RelmapError, match="not finite"):
        write_tum(tmp_path / "path.tum", np.zeros(1), np.full((1, 4, 4), np.nan))
    assert names(tmp_path) == []


def test_text_must_be_utf8(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes("ä\nö\n".encode() + b"\xff\n")
    with pytest.raises(RelmapError, match="line 3: byte 0xff is not UTF-8"):
        read_text(path)


@pytest.mark.parametrize(
    "use",
    [
        lambda path: PointMapper(journal=path),
        PointMapper.resume,
        PointMapper.load,
        PointMapper().save,
        PointMapper().save_results,
        salvage,
        read_result,
    ],
)
def test_a_path_that_cannot_be_is_reported(tmp_path: Path, use: Callable[..., object]) -> None:
    """The file system does not say whether there is such a file."""
    with pytest.raises(RelmapError, match="a" * 300):
        use(tmp_path / ("a" * 300))
    assert names(tmp_path) == []


def test_an_export_to_a_path_that_cannot_be_is_reported(tmp_path: Path) -> None:
    PointMapper().save_results(tmp_path)
    with pytest.raises(RelmapError, match="File name too long"):
        export(tmp_path, "svg", tmp_path / ("a" * 300 + ".svg"))
    assert read_names(tmp_path / ("a" * 300)) is None
