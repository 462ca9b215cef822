"""A program that kills runs at random moments and goes on with them; see test_journal_killed.py.

It forks, so that each run begins with everything imported and compiled.
"""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import sys
from pathlib import Path

from relmap import PointMapper
from relmap.core.arrays import Floats
from relmap.io.journal import writing
from tests.worlds import walk

writing.INTERVAL_S = 0.005
FLUSH_EVERY = 7


def mapped(mapper: PointMapper, scans: list[Floats], acknowledged: Path) -> str:
    """Map the remaining scans, note which were flushed, and return the map."""
    for points in scans[mapper.n_iterations :]:
        mapper.update(points)
        if mapper.n_iterations % FLUSH_EVERY == 0:
            mapper.flush()
            acknowledged.write_text(f"{mapper.n_iterations:04d}")
    mapper.finish()
    mapper.refine()
    return (mapper.map.positions.tobytes() + mapper.trajectory.tobytes()).hex()


def killed_after(seconds: float, journal: Path, scans: list[Floats]) -> bool:
    """Begin or continue a run in a separate process; return whether it was killed in time.

    The time is that of the processor, so that it is the same moment on a busy machine; 0: never.
    """
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGPROF, signal.SIG_DFL)  # which kills
        signal.setitimer(signal.ITIMER_PROF, seconds)
        begun = journal.exists()
        mapper = PointMapper.resume(journal) if begun else PointMapper(journal=journal)
        mapped(mapper, scans, journal.with_suffix(".flushed"))
        os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def main(folder: Path, moments: int) -> None:
    """Print the outcome of each run, as JSON."""
    scans = [points for _, points in walk(3, 5, 0.02, iterations=500).scans]
    whole = mapped(PointMapper(), scans, folder / "warm")
    killed_after(0, folder / "whole.journal", scans)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    took = used.ru_utime + used.ru_stime
    rng, told = random.Random(1), []
    for k in range(moments):
        journal = folder / f"{k}.journal"
        # More often early: a journal grows while scans are mapped, before `finish` and `refine`.
        killed = killed_after(took * rng.random() ** 2, journal, scans)
        if k % 3 == 0:  # and once more while it goes on
            killed_after(took * rng.random() ** 2, journal, scans)
        flushed = journal.with_suffix(".flushed")
        safe = int(flushed.read_text() or 0) if flushed.exists() else 0
        mapper = PointMapper.resume(journal) if journal.exists() else PointMapper()
        held = mapper.n_iterations
        if held == len(scans):
            took *= 0.8  # timers of a busy machine may be late, or the run timed was slow
        same = mapped(mapper, scans, folder / "end") == whole
        told.append({"killed": killed, "flushed": safe, "held": held, "same": same})
    print(json.dumps(told))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
