"""Hostile files for every reader: valid ones, damaged at random, and what was made to do harm.

    python -m tests.fuzz [--inputs N] [--seconds S] [--seed SEED] [READER ...]

Each reader is given N inputs, or as many as S seconds of one core allow.  Only a RelmapError of one
line may come back.  The program ends with 1 where anything else did, where an input took more than
its share of time, or where memory ran out.
"""

from __future__ import annotations

import argparse
import logging
import resource
import signal
import sys
import tempfile
import warnings
from importlib.util import find_spec
from pathlib import Path
from time import process_time
from types import FrameType

import numpy as np

from relmap.core.errors import RelmapError
from tests.bagfiles import compile_once
from tests.damage import mutated
from tests.hostile import Files, Reader, readers

MEMORY = 2 << 30
SECONDS = 20.0
"""Processor time after which an input counts as hanging; the machine may be busy."""
MESSAGE = 2000
"""No message is longer."""


class Hang(BaseException):
    """An input took too long; no reader may catch it."""


def _hang(signal_number: int, frame: FrameType | None) -> None:
    raise Hang


def put(folder: Path, files: Files) -> None:
    """Write files into an empty folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)


def problem_with(reader: Reader, folder: Path) -> str | None:
    """Read the files in the folder; return the problem, if any."""
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        reader.read(folder)
    except RelmapError as error:
        text = str(error)
        if len(text.splitlines()) != 1 or len(text) > MESSAGE:
            return f"message of {len(text.splitlines())} lines and {len(text)} characters"
    except Hang:
        return f"more than {SECONDS:g} s"
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not get out
        return f"{type(error).__name__}: {error}"[:300]
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return None


def fuzz(
    reader: Reader, folder: Path, inputs: int, seconds: float, seed: int
) -> tuple[int, dict[str, bytes]]:
    """Read damaged files; return how many, and of each different problem the first input."""
    put(folder, reader.files)
    rng = np.random.default_rng(seed)
    problems: dict[str, bytes] = {}
    end, n = process_time() + seconds, 0
    while n < inputs and process_time() < end:
        data = mutated(reader.files[reader.damaged], rng)
        (folder / reader.damaged).write_bytes(data)
        found = problem_with(reader, folder)
        if found is not None:
            problems.setdefault(found, data)
        n += 1
    return n, problems


def main() -> int:
    parser = argparse.ArgumentParser(description="Give every reader hostile files.")
    parser.add_argument("--inputs", type=int, default=200_000)
    parser.add_argument("--seconds", type=float, default=3600.0, help="of one core, per reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("readers", nargs="*", metavar="READER")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable()
    if find_spec("rosbags"):
        compile_once()
    known, bad = readers(), 0
    signal.signal(signal.SIGVTALRM, _hang)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, now + MEMORY))
    for name in arguments.readers or known:
        with tempfile.TemporaryDirectory(prefix="relmap-fuzz-") as folder:
            limits = arguments.inputs, arguments.seconds, arguments.seed
            n, problems = fuzz(known[name], Path(folder), *limits)
        print(f"{name}: {n} inputs, {len(problems)} problems")
        for problem, data in problems.items():
            print(f"  {problem}: {data[:200]!r}", flush=True)
        bad += len(problems)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
