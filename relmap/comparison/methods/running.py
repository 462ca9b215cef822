"""Runs one method on one log, timed, and compares the result with the truth."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from threadpoolctl import threadpool_limits

from relmap.comparison.baselines.base import Setup
from relmap.comparison.methods.registry import MethodInfo, find_method
from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.feeding import Association, Log, feed
from relmap.evaluation.landmarks import identify, match_landmarks
from relmap.evaluation.run import result_of
from relmap.evaluation.sources import Data, Source, silent
from relmap.evaluation.summary import timing_of
from relmap.io.results import Result
from relmap.planes.walls.files import PlaneResult
from relmap.planes3d.files import Plane3dResult
from relmap.points.mapper import PointMapper

OF_A_MAP = ("matched", "coverage", "landmarks_per_true", "purity")
"""Figures that a method without a map does not have."""
ACCURACY = ("landmark_rmse_m", "often_rmse_m", "corner_rmse_m", *OF_A_MAP, "ate_m", "rpe_m")
"""Figures that are the same in every run.

`matched` is the number of landmarks or corners in the RMSE; `often_rmse_m` covers only landmarks
seen in ten iterations, as coverage does, for comparison with methods that map landmarks seen once.
"""
PATH = ("path_coverage", "relation_m", "relation_rad")
"""Further figures of the path: the fraction of iterations with a pose in the map, which for a map
in submaps is the largest one, and the error of checked relations between poses."""
COST = ("median_ms", "mean_ms", "last_100_median_ms", "total_s", "memory_mb")
"""Figures that depend on the machine: processor time of one core, and memory growth."""
WARM_UP = {"landmarks": 30, "scans": 4, "clouds": 4}
"""Iterations of a log that are run first, so that everything is loaded and compiled."""
GUESSED_FROM = 200
"""Number of iterations from which the noise of a log is estimated."""
FEW_M = 0.01
"""Noise assumed if it cannot be estimated from the log."""
_STATUS = Path("/proc/self/status")
_RESET = Path("/proc/self/clear_refs")
KB_PER_MB = 1024


@dataclass(frozen=True, eq=False)
class MethodRun:
    """The result of a method, and its `ACCURACY`, `PATH` and `COST`, None where not available.

    `notes`: those of its `Evaluation`.
    """

    result: Result
    figures: dict[str, float | None]
    notes: tuple[str, ...] = ()


def run_method(
    info: MethodInfo, data: Data[Log], association: Association, sigma_m: float | None = None
) -> MethodRun:
    """Run a method on a log and compare the result with the truth.

    All libraries use one thread; a part of the log is run first, on a separate instance.

    `sigma_m`: noise passed to methods, metres; estimated from the log if not given. Raises
    `RelmapError` if the method cannot use the log.
    """
    log, setup = data.log, replace(setup_for(data, sigma_m), has_ids=association == "known")
    first = log.first_iteration
    with threadpool_limits(1):
        if len(log):
            begin = log.between(first, first + WARM_UP[data.kind])
            with silent("relmap"):  # the result is not used
                feed(info.make(setup), begin, association, info.refine, clock=process_time)
        method = info.make(setup)
        before_kb = _reset_peak()
        fed = feed(method, log, association, info.refine, clock=process_time)
        peak_kb = _kibibytes("VmHWM")
        result = result_of(method, log, fed.labels, association, first)
        figures, notes = _accuracy(result, data)
        durations_s = fed.durations_s.sum(axis=1)
        times = timing_of(durations_s)
        figures |= {
            "path_coverage": len(result.poses) / len(log) if len(log) else None,
            "median_ms": times["median_ms"],
            "mean_ms": 1e3 * float(durations_s.mean()) if len(durations_s) else None,
            "last_100_median_ms": times["last_100_median_ms"],
            "total_s": float(durations_s.sum()) + fed.finish_s + fed.refine_s,
            "memory_mb": max(peak_kb - before_kb, 0) / KB_PER_MB if peak_kb and before_kb else None,
        }
        return MethodRun(result, figures, notes)


def try_method(
    name: str, source: Source, association: Association, sigma_m: float | None
) -> tuple[MethodRun | None, str]:
    """Return what `run_method` does, or None, and the reason if it failed, else an empty text."""
    try:
        with silent():  # the warnings were shown when the data were loaded first
            data = source.load()
        return run_method(find_method(name), data, association, sigma_m), ""
    except (RelmapError, RuntimeError, ImportError, np.linalg.LinAlgError) as error:
        return None, "failed: " + " ".join(str(error).split())[:200]


def setup_for(data: Data[Log], sigma_m: float | None = None) -> Setup:
    """Return the information about a log that methods get in advance.

    `sigma_m`: standard deviation of an observed coordinate, metres; estimated from the log if not
    given.
    """
    log = data.log
    if isinstance(log, ScanLog):
        clouds = (scan.points_robot for scan in log.scans() if len(scan.points_robot))
        points = next(clouds, np.empty((0, log.dimension)))
        return Setup(log.dimension, sigma_m or FEW_M, _reach(points))
    if not sigma_m:
        mapper, first = PointMapper(), log.first_iteration
        feed(mapper, log.between(first, first + GUESSED_FROM), "nearest")
        sigma_m = mapper.noise_m if mapper.noise_m > 0 else FEW_M
    return Setup(log.points_robot.shape[1], sigma_m, _reach(log.points_robot))


def _reach(points: Floats) -> float:
    return float(np.linalg.norm(points, axis=1).max(initial=1.0))


def _accuracy(result: Result, data: Data[Log]) -> tuple[dict[str, float | None], tuple[str, ...]]:
    """Compare a result with the truth; a method without a map has no map figures."""
    figures: dict[str, float | None] = dict.fromkeys((*ACCURACY, *PATH))
    if data.truth is None:
        return figures, ()
    log = data.log if isinstance(data.log, ObservationLog) else None
    found = evaluate(result, data.truth, log)
    figures |= {name: getattr(found, name, None) for name in figures}
    if isinstance(result, PlaneResult):
        return figures | {"matched": found.counts.get("matched_corners")}, found.notes
    if isinstance(result, Plane3dResult) or not result.mapped.any():
        return figures | dict.fromkeys(OF_A_MAP), found.notes
    often = match_landmarks(result, data.truth, identify(result, log), often=True)
    figures["matched"] = found.counts.get("matched_landmarks")
    return figures | {"often_rmse_m": often.rmse_m if often else None}, found.notes


def _reset_peak() -> int | None:
    """Reset the peak memory of this process where possible, and return its memory, kilobytes."""
    with suppress(OSError):
        _RESET.write_text("5")
    return _kibibytes("VmRSS")


def _kibibytes(name: str) -> int | None:
    """Return a line of the process status, kilobytes."""
    try:
        lines = _STATUS.read_text().splitlines()
    except OSError:
        return None
    found = [line.split()[1] for line in lines if line.startswith(f"{name}:")]
    return int(found[0]) if found else None
