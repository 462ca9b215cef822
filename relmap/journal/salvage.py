"""Recovering what is whole of a damaged journal."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from relmap.core.errors import RelmapError
from relmap.journal.reading import JournalReader
from relmap.journal.writing import Journal, create_file


def salvage(path: Path) -> int:
    """Replace a damaged journal by one that holds the scans before the damage.

    The damaged file stays beside it, with ``.damaged`` behind its name.

    Parameters
    ----------
    path : Path

    Returns
    -------
    int
        Number of scans recovered.

    Raises
    ------
    RelmapError
        Where nothing can be recovered, or a file cannot be written.
    """
    damaged, whole = (path.with_name(f"{path.name}.{ending}") for ending in ("damaged", "whole"))
    if damaged.exists():
        raise RelmapError(f"{damaged} is there already: move it away first")
    with JournalReader(path) as reader:
        whole.unlink(missing_ok=True)
        create_file(whole, reader.layout, reader.meta)
        journal = Journal(whole, reader.layout)
        try:
            with suppress(RelmapError):
                for scan in reader.scans():
                    for call in reader.calls.get(journal.n_scans, []):
                        journal.call(call)
                    journal.append(scan.values, scan.ids, scan.labels)
        finally:
            journal.close()
    try:
        for ending in ("-wal", "-shm"):
            with suppress(FileNotFoundError):
                path.with_name(path.name + ending).replace(damaged.with_name(damaged.name + ending))
        path.replace(damaged)
        whole.replace(path)
    except OSError as error:
        raise RelmapError(f"cannot rename {path}: {error.strerror}") from error
    return journal.n_scans
