"""Hostile files for every reader: valid ones, damaged at random, and what was made to do harm.

    python -m tests.fuzz [--inputs N] [--seconds S] [--seed SEED] [READER ...]

Each reader is given N inputs, or as many as S seconds of one core allow.  An input is refused by a
RelmapError of one line, or accepted: then what was read is finite and of consistent lengths.  The
program ends with 1 where anything else happened, where an input took more than its share of time or
memory ran out, where a reader refused none of its inputs, or where none at all was accepted.
"""

from __future__ import annotations

import argparse
import logging
import resource
import signal
import sys
import tempfile
import warnings
from collections import Counter
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from time import process_time
from types import FrameType

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets import ObservationLog, Relations, ScanLog
from relmap.evaluation.evaluate import Evaluation
from relmap.evaluation.truth import Truth
from relmap.mapper import Mapper
from tests.bagfiles import compile_once
from tests.damage import mutated
from tests.hostile import Files, Reader, readers

MEMORY = 2 << 30
SECONDS = 20.0
"""Processor time after which an input counts as hanging; the machine may be busy."""
MESSAGE = 2000
"""No message is longer."""
REFUSED, ACCEPTED = "refused", "accepted"


class Hang(BaseException):
    """An input took too long; no reader may catch it."""


def _hang(signal_number: int, frame: FrameType | None) -> None:
    raise Hang


def put(folder: Path, files: Files) -> None:
    """Write files into an empty folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)


def require_sound(found: object) -> None:
    """Raise AssertionError unless what a reader returned is finite and of consistent lengths."""
    if isinstance(found, ScanLog):
        _require_sound_clock(found)
        for scan in islice(found.scans(), 20):
            assert scan.points_robot.shape[1:] == (found.dimension,)
            assert np.isfinite(scan.points_robot).all()
    elif isinstance(found, ObservationLog):
        _require_sound_rows(found)
    elif isinstance(found, Truth):
        assert np.isfinite(found.stamps_s).all()
        assert len(found.poses) == len(found.stamps_s)
        assert len(found.landmarks_map) == len(found.landmark_ids)
        _require_whole_or_unknown(found.poses)
        _require_whole_or_unknown(found.landmarks_map)
        assert np.isfinite(found.ends).all()
    elif isinstance(found, Relations):
        assert len(found.begin_s) == len(found.end_s) == len(found.T_begin_end)
        assert np.isfinite(found.T_begin_end).all()
    elif isinstance(found, Evaluation):
        figures = [value for value in found.as_dict().values() if isinstance(value, float)]
        assert np.isfinite(figures).all()
    elif isinstance(found, Mapper):
        assert np.isfinite(found.map.positions).all()
        assert len(found.trajectory) == found.n_iterations
    else:
        assert found


def _require_sound_rows(log: ObservationLog) -> None:
    """Raise AssertionError unless the observations of a log are sound."""
    _require_sound_clock(log)
    n, d = log.points_robot.shape
    assert np.isfinite(log.points_robot).all()
    assert d in (2, 3)
    assert len(log.iteration) == len(log.rows) == n
    assert (np.diff(log.iteration) >= 0).all()
    assert log.first_iteration <= log.iteration[0] <= log.iteration[-1] < log.end_iteration
    assert log.ids is None or len(log.ids) == n
    assert log.names is None or log.ids.max() < len(log.names)


def _require_sound_clock(log: ScanLog | ObservationLog) -> None:
    """Raise AssertionError unless stamps, odometry and poses of a log are sound."""
    poses = log.poses if isinstance(log, ScanLog) else None
    if log.stamps_s is not None:
        assert np.isfinite(log.stamps_s).all()
        assert (np.diff(log.stamps_s) >= 0).all()
    for column in (log.stamps_s, log.odometry, log.numbers, poses):
        assert column is None or len(column) == len(log)
    for motions in (log.odometry, poses):
        if motions is not None:
            _require_whole_or_unknown(motions)


def _require_whole_or_unknown(rows: Floats) -> None:
    """Raise AssertionError if a row is neither finite nor NaN."""
    axes = tuple(range(1, rows.ndim))
    assert (np.isfinite(rows).all(axis=axes) | np.isnan(rows).any(axis=axes)).all()


def outcome(reader: Reader, folder: Path) -> str:
    """Read the files in the folder; return `REFUSED`, `ACCEPTED` or the problem."""
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        require_sound(reader.read(folder))
    except RelmapError as error:
        text = str(error)
        if len(text.splitlines()) != 1 or len(text) > MESSAGE:
            return f"message of {len(text.splitlines())} lines and {len(text)} characters"
        return REFUSED
    except Hang:
        return f"more than {SECONDS:g} s"
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not get out
        return f"{type(error).__name__}: {error}"[:300]
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return ACCEPTED


def fuzz(
    reader: Reader, folder: Path, inputs: int, seconds: float, seed: int
) -> tuple[Counter[str], dict[str, bytes]]:
    """Read damaged files; count the outcomes, and return the first input of each problem."""
    put(folder, reader.files)
    rng = np.random.default_rng(seed)
    counts, problems = Counter[str](), dict[str, bytes]()
    end = process_time() + seconds
    while counts.total() < inputs and process_time() < end:
        data = mutated(reader.files[reader.damaged], rng)
        (folder / reader.damaged).write_bytes(data)
        found = outcome(reader, folder)
        counts[found] += 1
        if found not in (REFUSED, ACCEPTED):
            problems.setdefault(found, data)
    return counts, problems


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
    known, bad, n_accepted = readers(), 0, 0
    signal.signal(signal.SIGVTALRM, _hang)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, now + MEMORY))
    for name in arguments.readers or known:
        with tempfile.TemporaryDirectory(prefix="relmap-fuzz-") as folder:
            limits = arguments.inputs, arguments.seconds, arguments.seed
            counts, problems = fuzz(known[name], Path(folder), *limits)
        n, n_refused = counts.total(), counts[REFUSED]
        print(f"{name}: {n} inputs, {n_refused} refused, {len(problems)} problems")
        for problem, data in problems.items():
            print(f"  {problem}: {data[:200]!r}", flush=True)
        bad += len(problems) + (not n_refused)
        n_accepted += counts[ACCEPTED]
    return int(bad > 0 or not n_accepted)


if __name__ == "__main__":
    sys.exit(main())
