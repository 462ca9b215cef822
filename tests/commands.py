"""The command line and what it writes, for tests."""

from __future__ import annotations

import csv
import gzip
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from relmap.cli import main

RESULT_FILES = [
    "landmarks.csv",
    "map.ply",
    "map.png",
    "mapper.npz",
    "report.html",
    "submaps.csv",
    "summary.json",
    "tracks.csv.gz",
    "trajectory.tum",
]
PATIENCE_S = 1800.0
"""Time limit: a process that takes longer, even on a busy machine, hangs."""
RELMAP = [sys.executable, "-m", "relmap"]
GOOD = "iteration,x,y,z\n" + "".join(
    f"{k},{x - 0.1 * k!r},{y!r},{z!r}\n"
    for k in range(12)
    for x, y, z in [(1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0), (4.0, 4.0, 4.0)]
)

Check = Callable[..., str]


def run_process(command: Sequence[str], **more: Any) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; return its exit code and what it printed."""
    return subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE_S, check=False, **more
    )


def run_changed(change: str, *arguments: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run `relmap` in another process, without progress, after code that changes it."""
    begin = "import os, resource, signal, sys\nfrom relmap.cli import console, main"
    code = f"{begin}\nconsole.EVERY_S = 1e6\n{change}\nsys.exit(main(sys.argv[1:]))"
    return run_process([sys.executable, "-c", code, *map(str, arguments)], **more)


def run_relmap(*arguments: object) -> None:
    """Run `relmap` in this process; it must succeed."""
    assert main([str(argument) for argument in arguments]) == 0


@contextmanager
def unrendered() -> Iterator[None]:
    """Draw pictures as always, but render none, which takes matplotlib half a second each.

    It is for tests that look at no picture: the pixels of the files are the titles.  Animations are
    as always.
    """
    from matplotlib.figure import Figure
    from PIL import Image

    render = Figure.savefig

    def write_titles(figure: Figure, file: BytesIO, **how: Any) -> None:
        if "format" in how:
            return render(figure, file, **how)
        titles = "".join(axes.get_title() for axes in figure.axes).encode() or b"-"
        Image.frombytes("L", (len(titles), 1), titles).save(file, "PNG")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", write_titles)
        patch.setattr(Figure, "draw_without_rendering", lambda _: None)
        yield


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def load(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text())
    assert isinstance(content, dict)
    return content


def table(path: Path) -> list[dict[str, str]]:
    packed = path.suffix == ".gz"
    with gzip.open(path, "rt") if packed else path.open() as stream:
        return list(csv.DictReader(stream))


def shown(value: object) -> str:
    """Return a parameter's name for the list of tests: raw bytes have none."""
    return value if isinstance(value, str) else type(value).__name__


def snapshot(folder: Path) -> dict[str, bytes | None]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }
