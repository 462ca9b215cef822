"""What several verbs take: an interval of a log, a file of settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.core.config import MapperConfig

_LONGEST = 300
"""Characters that a message takes from a file of settings."""


def parse_scans(text: str | None) -> tuple[int, int] | None:
    """Return the interval that ``A:B`` names.

    Raises
    ------
    RelmapError
        Where it is not two whole numbers with 0 <= A < B.
    """
    if text is None:
        return None
    begin, colon, end = text.partition(":")
    if colon and begin.isascii() and begin.isdigit() and end.isascii() and end.isdigit():
        interval = int(begin), int(end)
        if interval[0] < interval[1]:
            return interval
    raise RelmapError(f"--scans is {text!r}: it must be A:B, whole numbers with 0 <= A < B")


def read_config(
    path: Path | None,
    registration: str | None = None,
    unused: Mapping[str, str] | None = None,
) -> MapperConfig:
    """Read a mapper's configuration from a TOML file; the default one where there is none.

    Parameters
    ----------
    path : Path or None
    registration : str, optional
        Goes before that of the file.
    unused : mapping, optional
        Settings that would be ignored, and why.

    Raises
    ------
    RelmapError
        Where the file cannot be read, is not TOML or holds what a configuration does not know, or
        what would be ignored.
    """
    import tomllib

    from relmap.core.config import MapperConfig, refuse
    from relmap.io.files import read_text

    given = {} if registration is None else {"registration": registration}
    if path is None:
        return MapperConfig.from_mapping(given)
    try:
        settings = tomllib.loads(read_text(path))
        refuse(settings, unused or {})
        return MapperConfig.from_mapping(settings | given)
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, nested deep
        raise RelmapError(f"{path}: not TOML: {str(error)[:_LONGEST]}") from error
    except RelmapError as error:
        problem = str(error)
        if str(path) not in problem:
            problem = f"{path}: {problem[:_LONGEST]}"
        raise RelmapError(problem) from error
