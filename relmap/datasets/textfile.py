"""Text files that may be gzipped, damaged, too large or not text."""

from __future__ import annotations

import gzip
import io
import logging
import os
import stat
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, TextIO

from relmap.core.errors import RelmapError
from relmap.datasets.foreign import HEAD_BYTES, foreign_format

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

MAX_BYTES = 1 << 30
"""Limit of the size of a log, 1 GiB unpacked: some fifteen million observations."""

MAX_LINES = 10_000_000
"""Maximum number of lines: each needs much more memory than its size."""

MAX_LINE_BYTES = 1 << 16
"""Maximum length of a line of a table."""

_LOG = logging.getLogger("relmap.datasets")
_GZIP_MAGIC = b"\x1f\x8b"
_SHOWN_CHARACTERS = 60
_LISTED = 12


def shown(value: object) -> str:
    """Return a text or path for a one-line message: unchanged if printable, else quoted."""
    text = str(value)
    return text if text.isprintable() else repr(text)


def quoted(text: str) -> str:
    """Return text from a file for a one-line message, quoted, shortened and escaped."""
    text = text.strip()
    if len(text) > _SHOWN_CHARACTERS:
        text = text[: _SHOWN_CHARACTERS - 3] + "..."
    return ascii(text) if not text.isprintable() else repr(text)


def listed(texts: Sequence[str], comma: str = ", ") -> str:
    """Return texts as a list for a one-line message, shortened if there are many."""
    return comma.join([*texts[:_LISTED], *["..."] * (len(texts) > _LISTED)])


def invalid(path: Path | str, problem: str) -> RelmapError:
    """Return the error for a file or folder whose content cannot be used."""
    return RelmapError(f"{shown(path)}: {problem}")


def warn(path: Path | str, problem: str) -> None:
    """Log a warning about a file or folder that is read in spite of a problem."""
    _LOG.warning("%s: %s", shown(path), problem)


def require_path(path: Path) -> int:
    """Return the mode of a file or folder; RelmapError if the path is neither."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise invalid(path, "is a device or pipe, expected a file or folder")
    return mode


def unreadable(path: Path, error: Exception) -> RelmapError:
    """Return the error for a path that the operating system refuses to read."""
    if isinstance(error, FileNotFoundError):
        return invalid(path, "does not exist, expected a file or folder to read")
    reason = getattr(error, "strerror", None) or error
    return invalid(path, f"cannot be read: {shown(reason)}")


@contextmanager
def open_text(path: Path) -> Iterator[TextIO]:
    r"""Open a UTF-8 text file, gzipped (by its magic bytes) or not, to be read once.

    Lines end in ``\n`` however the file ends them, and a byte-order mark is dropped. Bytes that are
    not UTF-8 are returned as lone surrogates, for `require_utf8`.

    Raises `RelmapError` on opening if the file cannot be read; while reading if it is damaged,
    larger than `MAX_BYTES` or not text.
    """
    if stat.S_ISDIR(require_path(path)):
        raise invalid(path, "is a folder, expected a file")
    with ExitStack() as opened:
        try:
            file = opened.enter_context(path.open("rb"))
            packed = file.peek(2)[:2] == _GZIP_MAGIC
        except OSError as error:
            raise unreadable(path, error) from error
        guard = _GuardedBytes(path, gzip.GzipFile(fileobj=file) if packed else file)
        buffer = io.BufferedReader(guard, MAX_LINE_BYTES)
        with io.TextIOWrapper(buffer, "utf-8-sig", "surrogateescape") as stream:
            yield stream


class _GuardedBytes(io.RawIOBase):
    """The unpacked bytes of a file; raises RelmapError at content no text log can have."""

    def __init__(self, path: Path, source: io.BufferedReader | gzip.GzipFile) -> None:
        super().__init__()
        self._path = path
        self._source = source
        self._head = b""
        self._bytes = 0
        self._lines = 0
        self._open_line = 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        data = self._read(len(memoryview(buffer)))
        self._check(data)
        memoryview(buffer)[: len(data)] = data
        return len(data)

    def _read(self, size: int) -> bytes:
        try:
            return self._source.read1(size)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise self._fail(f"damaged gzip: {shown(error)}; expected a whole file") from error
        except OSError as error:
            raise unreadable(self._path, error) from error

    def _check(self, data: bytes) -> None:
        if self._bytes < HEAD_BYTES:
            self._head += data[: HEAD_BYTES - self._bytes]
        self._bytes += len(data)
        if self._bytes > MAX_BYTES:
            raise self._fail(f"more than {MAX_BYTES} bytes of text, expected a log of at most that")
        nul = data.find(b"\0")
        if nul >= 0:
            self._lines += data.count(b"\n", 0, nul)
            found = foreign_format(self._head) or "a binary file or UTF-16"
            raise self._fail(f"a NUL byte: {found}, expected UTF-8 text")
        self._lines += data.count(b"\n")
        if self._lines > MAX_LINES:
            raise self._fail(f"more than {MAX_LINES} lines, expected a log of at most that")
        end = max(data.rfind(b"\n"), data.rfind(b"\r"))
        self._open_line = len(data) - 1 - end if end >= 0 else self._open_line + len(data)
        if self._open_line > MAX_LINE_BYTES:
            raise self._fail(f"a line of more than {MAX_LINE_BYTES} bytes, expected a table")

    def _fail(self, problem: str) -> RelmapError:
        return invalid(self._path, f"line {self._lines + 1}: {problem}")


def require_utf8(path: Path, number: int, line: str) -> None:
    """Raise RelmapError if a line from `open_text` contains bytes that are not UTF-8."""
    if line.isascii():
        return
    try:
        line.encode()
    except UnicodeEncodeError as error:
        byte = ord(line[error.start]) & 0xFF
        problem = f"line {number}: byte 0x{byte:02x} is not UTF-8, expected UTF-8 text"
        raise invalid(path, problem) from error


def why_not_written(error: Exception) -> str:
    """Return the reason why the operating system refuses to write a path."""
    if isinstance(error, FileExistsError | NotADirectoryError):
        return "a file exists in place of a folder"
    return shown(getattr(error, "strerror", None) or error)


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces the path once it is complete and on disk.

    Raises `RelmapError` if it cannot be written; no part of it is left behind.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())  # some file systems report a full disk only here
        part.replace(path)
    except (OSError, ValueError) as error:
        raise RelmapError(f"cannot write {shown(path)}: {why_not_written(error)}") from error
    finally:
        with suppress(OSError, ValueError):
            part.unlink(missing_ok=True)


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text file and their numbers, from 1; see `open_text`, `require_utf8`."""
    with open_text(path) as stream:
        for number, line in enumerate(stream, 1):
            require_utf8(path, number, line)
            yield number, line
