"""Small logs and how they are read or refused, for tests."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import pytest

from relmap.core.errors import RelmapError
from relmap.datasets import open_log

PLAIN = "iteration,x,y,z,id\n0,1.5,-2,0.25,7\n0,3,4,5,8\n2,1,2,3,7\n"
TREES = (
    "scan,t_ms,range_m,bearing_rad,diameter_m\n"
    "1,300,10,1.5707963267948966,0.3\n1,300,5,0,0.2\n3,700,5,3.141592653589793,0.2\n"
)


def put(folder: Path, content: str | bytes, name: str = "observations.csv") -> Path:
    """Write a file and return its path."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def failure(path: Path | str, format: str | None = None) -> str:
    """Return the one-line error of reading a log."""
    return one_line_error(open_log, path, format)


def one_line_error(read: Callable[..., object], *arguments: object) -> str:
    with pytest.raises(RelmapError) as caught:
        read(*arguments)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert message.isprintable()
    return message


def first_scans(log: Path, count: int, folder: Path) -> Path:
    """Write the first scans of a packed CARMEN log; return the path of the new one."""
    lines = []
    with gzip.open(log, "rt") as stream:
        for line in stream:
            count -= line.startswith("FLASER ")
            if count < 0:
                break
            lines.append(line)
    return put(folder, "".join(lines), "first.log")
