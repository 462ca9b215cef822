"""Time and memory over a long road: neither may grow with the map.

    python benchmarks/endurance.py [--quick | --iterations N]

One weaving road with 5.25 new landmarks per iteration and about 100 of them visible: 105 000 in the
20 000 iterations of a full run, 26 000 in the 5000 of --quick.  The road is generated ahead of the
robot and forgotten behind it, so that growing memory is the mapper's.  Each association runs in its
own process: memory freed by one run would hide the needs of the next.

Times are processor time with one thread in each library.  Memory is VmRSS, minus that
of the process after compiling, before mapping.  The map itself is the table of landmarks and the
groups with their relative maps at the end, in proportion to the landmarks seen; the rest must not
grow.  Linux only.
"""

from __future__ import annotations

import argparse
import gc
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from itertools import count, islice
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import Any, TypeAlias

import numpy as np
from shared.tables import table
from speed import on_one_core

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.simulation.figure_eight import HALF_VIEW_RAD, RANGE_M

SIGMA_M = 0.05
STEP_M = 3.5
"""Way of the robot along the road in an iteration."""
PER_M = 1.5
"""Landmarks per metre of road."""
HALF_WIDTH_M, HALF_HEIGHT_M = 30.0, 20.0
"""Largest distance of landmarks to each side of the road, and above and below it."""
WEAVE_M, WAVE_M = 20.0, 800.0
"""Amplitude and wavelength of the weaving road."""
CHUNK_M = 50.0
PER_CHUNK = round(PER_M * CHUNK_M)
"""Length of road generated at a time, and its landmarks."""
WINDOW = 1000
"""Iterations in the windows that are compared: the second of the run and the last."""
CHECKPOINTS = 10
WARM_UP = 100
"""Iterations of another road in which everything is compiled."""
BARS = {"last / early": 1.2, "slowest / median": 20.0}


Scans: TypeAlias = Iterator[tuple[Floats, Ints]]


def road(seed: int, sigma_m: float = SIGMA_M) -> Scans:
    """Yield, without end, the points (n, 3) of a scan, robot frame, metres, and their ids.

    The road is made ahead of the robot and forgotten behind it.
    """
    rng, ahead = np.random.default_rng(seed), stretches(seed)
    near: deque[Floats] = deque()
    first, end, at_m, reach_m = 0, 0, 0.0, RANGE_M + HALF_WIDTH_M
    while True:
        while end * CHUNK_M < at_m + reach_m:
            near.append(next(ahead))
            end += 1
        while (first + 1) * CHUNK_M < at_m - reach_m:
            near.popleft()
            first += 1
        in_robot = _in_robot(np.concatenate(near), at_m)
        distance = np.linalg.norm(in_robot, axis=1)
        in_view = in_robot[:, 0] >= distance * np.cos(HALF_VIEW_RAD)
        seen = np.flatnonzero(in_view & (distance <= RANGE_M))
        noise = rng.normal(0.0, sigma_m, (len(seen), 3))
        yield in_robot[seen] + noise, seen + first * PER_CHUNK
        at_m += STEP_M


def stretches(seed: int) -> Iterator[Floats]:
    """Yield, without end, the landmarks (PER_CHUNK, 3) along one stretch after another."""
    rng = np.random.default_rng([seed, 1])
    for k in count():
        x = CHUNK_M * (k + rng.random(PER_CHUNK))
        side = rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, PER_CHUNK)
        up = rng.uniform(-HALF_HEIGHT_M, HALF_HEIGHT_M, PER_CHUNK)
        yield np.column_stack([x, _weave(x)[0] + side, up])


def _weave(x_m: Floats) -> tuple[Floats, Floats]:
    """Return the offset of the road to the left at x, metres, and its direction, radians."""
    phase = 2 * np.pi * x_m / WAVE_M
    return WEAVE_M * np.sin(phase), np.arctan(2 * np.pi * WEAVE_M / WAVE_M * np.cos(phase))


def _in_robot(points_map: Floats, at_m: float) -> Floats:
    left, heading = _weave(np.array(at_m))
    cos, sin = np.cos(heading), np.sin(heading)
    R_map_robot = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray((points_map - [at_m, left, 0.0]) @ R_map_robot)


@dataclass(frozen=True)
class Drive:
    """Measurements of a run.

    Attributes
    ----------
    time_ms : (n,) float64
    visible : (n,) int64
    resident : (k, 3) int64
        Iteration, landmarks seen so far, and bytes held beyond those at the start.
    landmarks, mapped, groups : int
        At the end, as counted by the mapper.
    map_bytes : int
        Of the table of landmarks and of the groups.
    """

    time_ms: Floats
    visible: Ints
    resident: Ints
    landmarks: int
    mapped: int
    groups: int
    map_bytes: int


def drive(known: bool, iterations: int) -> Drive:
    """Map the road in a new process."""
    _go(PointMapper(), road(seed=1), known, WARM_UP)
    gc.collect()
    mapper = PointMapper()
    time_ms, visible, resident = _go(mapper, road(seed=0), known, iterations)
    landmarks, groups = mapper.landmarks, mapper.groups
    held: list[Any] = [landmarks, *groups]
    map_bytes = sum(getattr(one, field.name).nbytes for one in held for field in fields(one))
    mapped = int(np.sum(landmarks.level > 0))
    return Drive(
        time_ms, visible, resident, len(landmarks.landmark), mapped, len(groups), map_bytes
    )


def _go(
    mapper: PointMapper, scans: Scans, known: bool, iterations: int
) -> tuple[Floats, Ints, Ints]:
    """Map; return time and number visible of each iteration, and memory at intervals."""
    time_ms, visible = np.full(iterations, np.nan), np.full(iterations, -1)
    marks = np.linspace(0, iterations, CHECKPOINTS + 1).astype(int)[1:]
    seen = np.full(round(PER_M * (STEP_M * iterations + 2 * RANGE_M + CHUNK_M)), False)
    resident, at_start = [], _resident()
    for k, (points_robot, ids) in enumerate(islice(scans, iterations)):
        began = process_time()
        mapper.update(points_robot, ids if known else None)
        time_ms[k] = 1e3 * (process_time() - began)
        visible[k], seen[ids] = len(ids), True
        if k + 1 in marks:
            resident.append((k + 1, int(seen.sum()), _resident() - at_start))
    return time_ms, visible, np.array(resident)


def _resident() -> int:
    """Return the memory of this process that is resident, bytes."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return 1024 * int(line.split()[1])
    raise RuntimeError("/proc/self/status has no VmRSS")


def print_times(drives: dict[str, Drive]) -> None:
    rows = []
    for name, one in drives.items():
        window = min(WINDOW, len(one.time_ms) // 5)
        warm = one.time_ms[window:]
        early, last = np.median(warm[:window]), np.median(warm[-window:])
        middle, slowest, rare = np.median(warm), warm.max(), np.percentile(warm, 99.9)
        ratios = {"last / early": last / early, "slowest / median": slowest / middle}
        met = ["yes" if ratios[bar] <= limit else "no" for bar, limit in BARS.items()]
        cells = [name, f"{one.visible.mean():.0f}", f"{one.landmarks}", f"{one.mapped}"]
        cells += [f"{early:.3f}", f"{last:.3f}", f"{ratios['last / early']:.2f}", met[0]]
        cells += [f"{middle:.3f}", f"{slowest:.1f} (at {window + int(warm.argmax())})"]
        cells += [f"{ratios['slowest / median']:.1f}", met[1], f"{rare / middle:.1f}"]
        rows.append(cells)
    header = ["association", "visible", "landmarks", "mapped", "early median [ms]"]
    header += ["last median [ms]", "last / early", f"<= {BARS['last / early']}", "median [ms]"]
    header += ["slowest [ms]", "slowest / median", f"<= {BARS['slowest / median']:g}"]
    header += ["99.9 % / median"]
    table("Time of an iteration, beyond the first window", header, rows)


def print_memory(name: str, one: Drive) -> None:
    iteration, seen, resident = one.resident.T
    per_landmark = one.map_bytes / seen[-1]
    beyond = resident - per_landmark * seen
    rows = [
        [f"{k}", f"{n}", f"{r / 2**20:.1f}", f"{b / 2**20:.1f}", f"{b / one.visible.mean():.0f}"]
        for k, n, r, b in zip(iteration, seen, resident, beyond, strict=True)
    ]
    header = ["iterations", "landmarks seen", "resident [MiB]", "beyond the map [MiB]"]
    header += ["beyond the map, bytes per visible observation"]
    table(f"Memory, association {name}", header, rows)
    half = len(seen) // 2
    growth, excess = (np.polyfit(seen[half:], y[half:], 1)[0] for y in (resident, beyond))
    print(
        f"\nSecond half: {growth:.0f} bytes per landmark, of which the map itself has "
        f"{per_landmark:.0f} and {excess:.0f} are beyond it; {one.groups} groups.",
        flush=True,
    )


def main(iterations: int) -> None:
    drives = {}
    for name in ("known", "nearest"):
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            drives[name] = pool.submit(drive, name == "known", iterations).result()
    print_times(drives)
    for name, one in drives.items():
        print_memory(name, one)


if __name__ == "__main__":
    on_one_core()
    parser = argparse.ArgumentParser(description="Measure time and memory over a long road.")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--iterations", metavar="N", type=int, default=20_000, help="at least 100")
    length.add_argument("--quick", dest="iterations", action="store_const", const=5000, help="5000")
    arguments = parser.parse_args()
    if arguments.iterations < 100:
        parser.error(f"--iterations is {arguments.iterations}; it must be 100 or more")
    main(arguments.iterations)
