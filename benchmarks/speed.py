"""Time of an iteration compared with plain averaging and with ICP, on the same scans in one run.

    python benchmarks/speed.py [--quick]

Every scan of the figure eight (sigma 0.05 m, seed 0) goes to all methods in turn, in an order
that changes with every scan.  Times are processor time, which counts every thread, with one thread
in each library; the first iterations are left out.  The mean decides, since groups are not formed
in every iteration; the median stands beside it.

Frame-to-map is given the ids.  KISS-ICP (Vizzo et al., RA-L 2023; `pip install kiss-icp`) gets the
landmarks of a scan as its point cloud and runs `register_frame`: no deskewing, as a scan is one
instant; its default range of 100 m, beyond the sensor's 80; and its default voxel, a hundredth of
that, 1 m, smaller than the landmarks' spacing.  Its path error shows whether it keeps track.

Compiling is measured in separate processes: with an empty cache, and from the cache.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np
from shared.runs import mapped
from shared.tables import table

from relmap import PlaneMapper, PointMapper
from relmap.comparison.baselines.frames import FrameToMap
from relmap.comparison.baselines.icp import KissIcp
from relmap.core.arrays import Floats
from relmap.datasets.base import ObservationLog, Scan
from relmap.evaluation.feeding import feed
from relmap.evaluation.metrics import ate
from relmap.evaluation.sources import log_of
from relmap.simulation import simulate_building, simulate_figure_eight

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
DENSITIES = (23, 92, 367, 918)
"""Landmarks per 100 m; about 20, 80, 320 and 800 are visible."""
WARM_UP = 50
"""Iterations left out at the beginning."""
SENSOR_M = 80.0
"""Range of the sensor."""
BARS = (
    ("frame-to-map", 1.5, 1.5),
    ("KISS-ICP", 1.0, 0.5),
    ("KISS-ICP", 0.7, 0.35),
    ("KISS-ICP", 0.5, 0.25),
)
"""The reference at each density, and the largest allowed ratios of relmap's mean time to its time:
without ids and with them."""
OURS = ("relmap nearest", "relmap known")

Step = Callable[[Scan], object]
Times = dict[str, Floats]


def on_one_core() -> None:
    """Start this program anew with one thread in every library, unless it has been."""
    if any(os.environ.get(name) != "1" for name in THREADS):
        one_each = os.environ | dict.fromkeys(THREADS, "1")
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], one_each)


def kiss_icp() -> KissIcp | None:
    try:
        return KissIcp(SENSOR_M)
    except ImportError:
        return None


def methods(icp: KissIcp | None) -> dict[str, Step]:
    nearest, known, plain = PointMapper(), PointMapper(), FrameToMap()
    steps: dict[str, Step] = {
        "relmap nearest": lambda scan: nearest.update(scan.points_robot),
        "relmap known": lambda scan: known.update(scan.points_robot, scan.ids),
        "frame-to-map": lambda scan: plain.update(scan.points_robot, scan.ids),
    }
    return (
        steps if icp is None else steps | {"KISS-ICP": lambda scan: icp.update(scan.points_robot)}
    )


def side_by_side(log: ObservationLog, steps: dict[str, Step]) -> Times:
    """Return the time of each iteration with each method, milliseconds."""
    names, times = list(steps), {name: np.zeros(len(log)) for name in steps}
    for k, scan in enumerate(log.scans()):
        first = k % len(names)
        for name in names[first:] + names[:first]:
            began = process_time()
            steps[name](scan)
            times[name][k] = 1e3 * (process_time() - began)
    return {name: time_ms[WARM_UP:] for name, time_ms in times.items()}


@dataclass(frozen=True)
class Timing:
    """What was measured at one density."""

    visible: float
    times_ms: Times
    error_m: float | None  # of the path of KISS-ICP; None where it is missing


def timing(density: float, iterations: int) -> Timing:
    world, icp = simulate_figure_eight(density, iterations), kiss_icp()
    times_ms = side_by_side(world.log, methods(icp))
    visible = len(world.log.points_robot) / len(world.log)
    error_m = ate(icp.trajectory, world.trajectory, planar=False) if icp else None
    return Timing(visible, times_ms, error_m)


def print_times(timings: list[Timing]) -> None:
    names = list(timings[0].times_ms)
    rows = [
        [f"{one.visible:.1f}"]
        + [f"{np.median(t):.3f} ({np.mean(t):.3f})" for t in one.times_ms.values()]
        + [f"{one.error_m:.2f}" if one.error_m is not None else "not installed"]
        for one in timings
    ]
    header = ["visible", *names, "path error of KISS-ICP [m]"]
    table("Time of an iteration, median (mean), ms", header, rows)


def print_ratios(timings: list[Timing]) -> None:
    rows = []
    for one, (other, *bars) in zip(timings, BARS, strict=False):
        for name, bar in zip(OURS, bars, strict=True):
            cells = [f"{one.visible:.1f}", name, other]
            if other in one.times_ms:
                ours, theirs = one.times_ms[name], one.times_ms[other]
                ratio = ours.mean() / theirs.mean()
                met = "yes" if ratio <= bar else "no"
                medians = np.median(ours) / np.median(theirs)
                cells += [f"{medians:.2f}", f"{ratio:.2f}", f"{bar:g}", met]
            else:
                cells += ["not installed", "", f"{bar:g}", "not measured"]
            rows.append(cells)
    header = ["visible", "method", "against", "ratio of medians", "of means", "aim", "met"]
    table("Ratios", header, rows)


# Compiling.


def use_cache(folder: str) -> None:
    os.environ["NUMBA_CACHE_DIR"] = folder


def points() -> Callable[[], object]:
    """Return what maps a log with ids and without, and refines it."""
    log = simulate_figure_eight(density=50, iterations=120, dynamic=0.2).log
    return lambda: [mapped(log, known) for known in (False, True)]


def walls() -> Callable[[], object]:
    """Return what maps scans of a laser, and refines the map."""
    log = log_of(simulate_building(361, sigma=0.01, sampling="laser", iterations=120))
    return lambda: feed(PlaneMapper(), log, "nearest", refine=True)


def timed(run: Callable[[], object]) -> Floats:
    """Return the time of a run, of clock and processor, s."""
    began = clocks()
    run()
    return clocks() - began


def clocks() -> Floats:
    return np.array([perf_counter(), process_time()])


def first_run(kind: Callable[[], Callable[[], object]]) -> tuple[Floats, Floats]:
    """Return how long numba takes to load and how much longer a first run takes, as `timed`."""
    run = kind()
    loaded = timed(lambda: import_module("numba"))
    first = timed(run)
    return loaded, first - timed(run)


def print_compiling() -> None:
    rows = []
    for kind in points, walls:
        with TemporaryDirectory() as folder:
            for cache in ("cold", "warm"):
                with ProcessPoolExecutor(1, get_context("spawn"), use_cache, (folder,)) as pool:
                    measured = pool.submit(first_run, kind).result()
                times = (f"{clock:.2f} ({processor:.2f})" for clock, processor in measured)
                rows.append([kind.__name__, cache, *times])
    title = (
        "Compiling: a map of points with ids and without, or of walls; clock (processor) time, s"
    )
    table(title, ["landmarks", "cache", "numba loads", "first run takes longer by"], rows)


if __name__ == "__main__":
    on_one_core()
    parser = argparse.ArgumentParser(description="Time an iteration beside other methods.")
    parser.add_argument("--quick", action="store_true", help="up to 80 visible, not compiling")
    quick = parser.parse_args().quick
    if kiss_icp() is None:
        print("KISS-ICP is not installed (pip install kiss-icp): its columns are left out")
    iterations, densities = (150, DENSITIES[:2]) if quick else (900, DENSITIES)
    for world in (DENSITIES[0], iterations), (DENSITIES[1], 150):
        timing(*world)  # until everything is compiled
    measured = [timing(density, iterations) for density in densities]
    print_times(measured)
    print_ratios(measured)
    if not quick:
        print_compiling()
