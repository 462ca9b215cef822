"""The header of a table, and the log file in a folder."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, TextIO

from relmap.core.errors import RelmapError
from relmap.datasets.textfile import invalid, open_text, require_utf8, shown, unreadable


def only_one(path: Path, found: Sequence[Path], what: str, names: str) -> Path:
    """Return a file itself, of a folder the only one found; RelmapError if there is not one."""
    if not os.path.isdir(path):
        return path
    if not found:
        raise invalid(path, f"holds no {what}, expected one {names}")
    if len(found) > 1:
        several = ", ".join(shown(file.name) for file in found)
        raise invalid(path, f"holds {len(found)} {what}s, expected one of {several}")
    return found[0]


def file_in(path: Path, name: str) -> Path:
    """Return the path itself unless it is a folder, else the file with a name in it."""
    return path / name if os.path.isdir(path) else path


def file_beside(path: Path | str, name: str) -> Path:
    """Return the file with a name in a folder, or beside a file."""
    path = Path(path)
    return (path if os.path.isdir(path) else path.parent) / name


def members_of(folder: Path, endings: tuple[str, ...]) -> list[Path]:
    """Return the sorted members of a folder with one of the extensions."""
    try:
        return [member for member in sorted(folder.iterdir()) if member.name.endswith(endings)]
    except OSError as error:
        raise unreadable(folder, error) from error


def numbers_in_name(file: Path, ending: re.Pattern[str]) -> list[int]:
    """Return the numbers in the name of a file, without its extension."""
    return [int(digits) for digits in re.findall(r"\d+", ending.sub("", file.name))]


def numbered_files(folder: Path, ending: re.Pattern[str]) -> list[Path]:
    """Return the files with an extension in a folder, sorted by the numbers in their names."""
    members = members_of(folder, ("",))
    found = [file for file in members if ending.search(file.name) and file.is_file()]
    return sorted(found, key=lambda file: numbers_in_name(file, ending))


SEPARATORS = ",;\t"
"""Possible separators of a table; the most frequent one in the header is used."""
_QUOTED = re.compile('"[^"]*"')


class Head(NamedTuple):
    """Content before the rows of a table: comments without ``#``, and the header's cells."""

    comments: tuple[str, ...]
    columns: tuple[str, ...]
    line: int
    separator: str


def cells_of(text: str, separator: str) -> list[str]:
    """Return the cells of a line, without white space and double quotes around them."""
    cells = map(str.strip, text.split(separator))
    return [cell[1:-1].strip() if _QUOTED.fullmatch(cell) else cell for cell in cells]


def read_head(path: Path, stream: TextIO) -> Head:
    """Read comments and header from a stream of `open_text`, up to the first row.

    RelmapError if the file is empty, has no header or is not text.
    """
    comments = []
    number = 0
    for number, line in enumerate(stream, 1):
        require_utf8(path, number, line)
        text = line.strip()
        if text.startswith("#"):
            comments.append(text.lstrip("#").strip())
        elif text:
            separator = max(SEPARATORS, key=text.count)
            return Head(tuple(comments), tuple(cells_of(text, separator)), number, separator)
    problem = "holds no header" if number else "is empty"
    raise invalid(path, f"{problem}, expected a table with a header line")


def columns_of(path: Path) -> frozenset[str]:
    """Return the header's cells of a table; none if the file cannot be read as one."""
    try:
        with open_text(path) as stream:
            return frozenset(read_head(path, stream).columns)
    except RelmapError:
        return frozenset()


TABLES = "*.csv or *.csv.gz"
"""The names of tables."""


def tables_with(path: Path, columns: frozenset[str]) -> list[Path]:
    """Return the files with all the columns: the path, or of a folder ``*.csv``, ``*.csv.gz``."""
    members = members_of(path, (".csv", ".csv.gz")) if os.path.isdir(path) else [path]
    return [member for member in members if columns <= columns_of(member)]
