"""Atomic reading and writing of files, in full precision, with errors that name file and line."""

from __future__ import annotations

import os
import secrets
import shutil
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError, reason
from relmap.datasets.number_rows import read_rows
from relmap.datasets.scans import poses_of
from relmap.datasets.textfile import (
    invalid,
    open_text,
    replacing,
    require_utf8,
    shown,
    why_not_written,
)
from relmap.io.tables import MAX_RESULT_M

T = TypeVar("T")

WHOLE = "summary.json"
"""A folder without this file is not read as a result: it is deleted first and moved last, so that a
kill between two files leaves no result of old and new files. Where there is none, all old files are
deleted first."""
POSE_LIMITS = (sys.float_info.max, *[MAX_RESULT_M] * 3, *[10.0] * 4)
"""Largest time and coordinates, and of the quaternion, which need not be of unit length."""
MAX_TEXT = 1 << 26
"""Maximum number of characters of a text; JSON needs twenty times as much memory."""


def atomic_write(path: Path, content: str | bytes | memoryview) -> None:
    """Write a whole file or nothing: an earlier file of that name is kept until then.

    `path`: the file; its folder exists. `content`: text is written as UTF-8, and what UTF-8 cannot
    hold, such as bytes of file names, with a backslash. Raises `RelmapError` if the file cannot be
    written; no part of it is left behind.
    """
    if isinstance(content, str):
        content = content.encode(errors="backslashreplace")
    with replacing(path) as file:
        file.write(content)


@contextmanager
def staged_folder(folder: Path, stale: Sequence[str] = ()) -> Iterator[Path]:
    """Provide an empty folder to write into; its files move to ``folder`` on success.

    Enter it before long work, so that an unwritable folder is reported at once. If the body fails,
    ``folder`` and its files are unchanged.

    `folder`: destination; created if missing, with its parents. `stale`: names of files in
    ``folder`` that become obsolete; deleted at the end unless rewritten. Yields the folder to write
    into; it may get subfolders. Raises `RelmapError` if ``folder`` or a file in it cannot be
    written.
    """
    staging: Path | None = None
    made: list[Path] = []
    try:
        made = [level for level in (folder, *folder.parents) if not level.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        # The name first: an interrupt may come between a folder and the assignment of its name.
        staging = folder / f".relmap-{secrets.token_hex(4)}"
        staging.mkdir(mode=0o700)
        yield staging
        _move_files(staging, folder, stale)
    except OSError as error:
        raise RelmapError(f"cannot write into {shown(folder)}: {why_not_written(error)}") from error
    except RelmapError as error:
        raise RelmapError(str(error).replace(str(staging), str(folder))) from error
    finally:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        for level in made:
            with suppress(OSError):
                level.rmdir()


def _move_files(staging: Path, folder: Path, stale: Sequence[str]) -> None:
    names = sorted(path.relative_to(staging) for path in staging.rglob("*") if path.is_file())
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with (staging / name).open("rb") as stream:
            os.fsync(stream.fileno())
    written = {path.name for path in staging.iterdir()}
    old = names if len(names) > 1 else []
    first = [Path(WHOLE)] if WHOLE in written else old
    gone = [*first, *map(Path, set(stale).difference(written))]
    for name in (*names, *gone):
        if (folder / name).is_dir():
            raise RelmapError(f"cannot write {shown(folder / name)}: a folder of that name exists")
    names.sort(key=lambda name: name == Path(WHOLE))
    for name in gone:
        (folder / name).unlink(missing_ok=True)
    for name in names:
        (staging / name).replace(folder / name)


def read_text(path: Path) -> str:
    """Read a UTF-8 text file of moderate size, plain or gzipped.

    Raises `RelmapError` if it cannot be read, is damaged, is not text or has more than `MAX_TEXT`
    characters.
    """
    with open_text(path) as stream:
        text = stream.read(MAX_TEXT + 1)
    if len(text) > MAX_TEXT:
        raise invalid(path, f"more than {MAX_TEXT} characters, expected at most that")
    if not text.isascii():
        for number, line in enumerate(text.split("\n"), 1):
            require_utf8(path, number, line)
    return text


def read_toml(path: Path, parse: Callable[[dict[str, Any]], T]) -> T:
    """Parse the content of a small TOML file; a RelmapError of any kind names the file."""
    try:
        content = tomllib.loads(read_text(path))
    except (ValueError, RecursionError) as error:  # huge numbers, deep nesting
        raise invalid(path, f"not TOML: {reason(error)}") from error
    try:
        return parse(content)
    except RelmapError as error:
        raise invalid(path, str(error)) from error


def write_tum(path: Path, stamps_s: Floats, poses: Floats) -> None:
    """Write a trajectory as a TUM file: ``t x y z qx qy qz qw``, in full precision.

    `path`: the file; `stamps_s` (k,): seconds, or iteration numbers without a clock; `poses`
    (k, 4, 4): T_map_robot, finite. Raises `RelmapError` if a stamp or pose is not finite, a pose
    exceeds the limits of `read_tum`, or the file cannot be written.
    """
    if not (np.isfinite(stamps_s).all() and (np.abs(poses) <= MAX_RESULT_M).all()):
        raise RelmapError(
            f"cannot write {shown(path)}: a stamp or pose of the trajectory is not finite"
        )
    quaternions = np.empty((0, 4))
    if len(poses):
        quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    rows = np.column_stack([np.asarray(stamps_s, float), poses[:, :3, 3], quaternions])
    lines = ["# t x y z qx qy qz qw", *(" ".join(map(repr, row)) for row in rows.tolist())]
    atomic_write(path, "\n".join(lines) + "\n")


def read_tum(path: Path) -> tuple[Floats, Floats]:
    """Read a TUM file.

    `path`: lines of ``t x y z qx qy qz qw``; ``#`` begins a comment. Returns `stamps_s` (k,) and
    `poses` (k, 4, 4): T_map_robot. Raises `RelmapError` if the file cannot be read or a line is not
    a pose.
    """
    rows = read_rows(path, POSE_LIMITS, "pose", "8 numbers: t x y z qx qy qz qw", empty=True)
    table = rows.values
    if not len(table):
        return table[:, 0], np.empty((0, 4, 4))
    wrong = np.abs(table[:, 4:]).max(axis=1) < 0.1
    if wrong.any():
        line = rows.lines[np.argmax(wrong)]
        raise invalid(path, f"line {line}: the quaternion qx qy qz qw is not of unit length")
    return table[:, 0], poses_of(Rotation.from_quat(table[:, 4:]), table[:, 1:4])
