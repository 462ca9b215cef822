"""Cost of a journal, and of saving and loading.

    python benchmarks/journal.py [--iterations N]

The road of `endurance.py`, with about 100 of its landmarks visible, is mapped without and with a
journal in the folder for temporary files.  Times are processor time of whole updates, one thread in
each library: a journal also waits for the disk, but wall time would depend on other
processes.
"""

from __future__ import annotations

import argparse
import tempfile
from itertools import islice
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from endurance import road
from speed import on_one_core

from relmap import PointMapper
from relmap.core.arrays import Floats

WARM_UP = 300
BAR = 0.30


def cost_s(mapper: PointMapper, scans: list[Floats]) -> tuple[float, float]:
    """Return processor and wall time of an update, means over all but the first, seconds."""
    for points in scans[:WARM_UP]:
        mapper.update(points)
    began = process_time(), perf_counter()
    for points in scans[WARM_UP:]:
        mapper.update(points)
    n = len(scans) - WARM_UP
    return (process_time() - began[0]) / n, (perf_counter() - began[1]) / n


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--iterations", type=int, default=2000)
    n = parser.parse_args().iterations
    scans = [points for points, _ in islice(road(seed=0), n + WARM_UP)]
    cost_s(PointMapper(), scans[: WARM_UP + 50])
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(3):
            plain = cost_s(PointMapper(), scans)
            kept = PointMapper(journal=Path(folder, f"{k}.journal"))
            rows.append((plain, cost_s(kept, scans)))
            kept.close()
        size = Path(folder, "0.journal").stat().st_size
        began = perf_counter()
        kept.save(Path(folder, "mapper.npz"))
        saved = perf_counter()
        PointMapper.load(Path(folder, "mapper.npz"))
        loaded = perf_counter()
        state = Path(folder, "mapper.npz").stat().st_size
    (plain, plain_wall), (journal, journal_wall) = np.median(rows, axis=0)
    seen = sum(map(len, scans))
    print(f"visible landmarks {seen / len(scans):.0f}, iterations {n}, median of 3 runs")
    print(f"update without a journal {1e6 * plain:.0f} us, wall {1e6 * plain_wall:.0f} us")
    print(f"update with a journal {1e6 * journal:.0f} us, wall {1e6 * journal_wall:.0f} us")
    more = journal / plain - 1
    print(f"overhead {more:.1%}, bar {BAR:.0%}: {'held' if more <= BAR else 'MISSED'}")
    print(f"journal {size / seen:.0f} bytes per observation")
    print(f"saved state {state / seen:.1f} bytes per observation, ", end="")
    print(f"{saved - began:.2f} s to save, {loaded - saved:.2f} s to load")


if __name__ == "__main__":
    on_one_core()
    main()
