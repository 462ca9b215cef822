"""Recovering the intact part of a damaged journal."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

from relmap.core.errors import RelmapError
from relmap.io.journal.file import BESIDE, remove, stated_size
from relmap.io.journal.reading import JournalReader
from relmap.io.journal.writing import Journal

MOST_MISSING = 1 << 40
"""File size above which the stated size is damaged."""


def salvage(path: Path) -> int:
    """Replace a damaged journal by one with the scans before the damage.

    The damaged file is kept, with ``.damaged`` appended to its name. Returns the number of scans
    recovered. Raises `RelmapError` if nothing can be recovered, or a file cannot be written.
    """
    damaged, whole, rest = (_beside(path, name) for name in (".damaged", ".whole", ".rest"))
    there = [os.path.exists(file) for file in (damaged, whole, path)]
    if there == [True, True, False]:  # killed before the last step
        whole.replace(path)
        with JournalReader(path) as reader:
            return sum(1 for _ in reader.scans())
    if there[0]:
        raise RelmapError(
            f"{damaged} already exists: {path} was recovered before: resume it without --salvage, "
            f"or move {damaged} away first"
        )
    if not os.path.isfile(path):
        raise RelmapError(f"there is no journal {path}")
    try:
        _copy(path, rest)
        n_scans = _recover(rest, whole)
        for ending in (*BESIDE, ""):
            with suppress(FileNotFoundError):
                _beside(path, ending).replace(_beside(damaged, ending))
        whole.replace(path)
    except RelmapError as error:
        raise RelmapError(str(error).replace(str(rest), str(path))) from error
    except OSError as error:
        raise RelmapError(f"cannot recover {path}: {error.strerror}: {error.filename}") from error
    finally:
        for file in (rest, whole):
            remove(file)
    return n_scans


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(path.name + ending)


def _copy(path: Path, copy: Path) -> None:
    """Copy a journal, padded to its stated size if truncated, as SQLite requires."""
    shutil.copyfile(path, copy)
    with suppress(FileNotFoundError):
        shutil.copyfile(_beside(path, "-wal"), _beside(copy, "-wal"))
    missing = stated_size(copy) - copy.stat().st_size
    if 0 < missing <= MOST_MISSING:
        with copy.open("ab") as stream:
            stream.truncate(copy.stat().st_size + missing)


def _recover(damaged: Path, whole: Path) -> int:
    """Write the scans before the damage to a journal; return their number."""
    with JournalReader(damaged) as reader:
        remove(whole)
        journal = Journal.create(whole, reader.layout, reader.meta)
        try:
            for scan in reader.scans():
                for call in reader.calls.get(journal.n_scans, []):
                    journal.call(call)
                journal.append(scan)
        except RelmapError:
            if not reader.read.scans:
                raise
        finally:
            journal.close()
    return journal.n_scans
