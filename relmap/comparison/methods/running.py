"""One method on one log: run, timed, and compared with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from relmap.comparison.memory import PeakMemory
from relmap.comparison.methods.base import Method, MethodInfo, Setup
from relmap.core.landmarks import LandmarkMap, LandmarkTable
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.landmarks import identify, match_landmarks
from relmap.evaluation.run import Association, Log, stamps_of
from relmap.evaluation.sources import Data
from relmap.evaluation.summary import timing_of
from relmap.io.results import Result, Tracks
from relmap.planes.files import PlaneResult
from relmap.points.mapper import PointMapper

ACCURACY = (
    "landmark_rmse_m",
    "often_rmse_m",
    "corner_rmse_m",
    "matched",
    "coverage",
    "landmarks_per_true",
    "purity",
    "ate_m",
    "rpe_m",
)
"""Figures that are the same in every run.

`matched` landmarks or corners are behind the RMSE; `often_rmse_m` is of the landmarks seen in ten
iterations alone, as coverage is: methods that map what they saw once are compared by it.
"""
PATH = ("path_coverage", "relation_m", "relation_rad")
"""Further figures of the path: the share of the iterations that have a pose in the map, which of a
map in submaps are those of the largest, and the error of checked relations between poses."""
COST = ("median_ms", "mean_ms", "last_100_median_ms", "total_s", "memory_mb")
"""Figures that depend on the machine: processor time of one core, and what the process grew by."""
WARM_UP = {"landmarks": 30, "scans": 4}
"""Iterations of a log that are run before, so that all is loaded and compiled."""
GUESSED_FROM = 200
"""Iterations that the noise of a log is estimated from."""
FEW_M = 0.01
"""Noise that is assumed where a log does not tell."""


@dataclass(frozen=True, eq=False)
class MethodRun:
    """What came out of a method.

    Attributes
    ----------
    result : Result
        Of walls a `PlaneResult`.
    figures : dict
        `ACCURACY`, `PATH` and `COST`, None where one cannot be had.
    """

    result: Result
    figures: dict[str, float | None]


def run_method(
    info: MethodInfo, data: Data[Log], association: Association, sigma_m: float | None = None
) -> MethodRun:
    """Run a method over a log and compare what comes out with the truth.

    One thread in every library; a part of the log is run before, on a method of its own.

    Parameters
    ----------
    info : MethodInfo
    data : Data
    association : "nearest" or "known"
    sigma_m : float, optional
        Noise that methods are told; estimated from the log where left out.

    Raises
    ------
    RelmapError
        Where the method cannot use the log.
    """
    with threadpool_limits(1):
        setup = setup_for(data, sigma_m)
        _run(info.make(setup), data, association, WARM_UP[data.kind])
        method = info.make(setup)
        memory = PeakMemory()
        labels, durations_s, finish_s = _run(method, data, association)
        memory_mb = memory.grown_mb
        result = _result(method, data, association, labels)
        figures: dict[str, float | None] = dict.fromkeys((*ACCURACY, *PATH))
        if data.truth is not None:
            figures |= _accuracy(result, data)
        if not (len(method.map.landmark_ids) or isinstance(result, PlaneResult)):
            figures |= dict.fromkeys(("matched", "coverage", "landmarks_per_true", "purity"))
        told = timing_of(durations_s)
        figures |= {
            "path_coverage": len(result.poses) / len(data.log) if len(data.log) else None,
            "median_ms": told["median_ms"],
            "mean_ms": 1e3 * float(durations_s.mean()) if len(durations_s) else None,
            "last_100_median_ms": told["last_100_median_ms"],
            "total_s": float(durations_s.sum()) + finish_s,
            "memory_mb": memory_mb,
        }
        return MethodRun(result, figures)


def setup_for(data: Data[Log], sigma_m: float | None = None) -> Setup:
    """Return what methods are told beforehand of a log."""
    log = data.log
    if isinstance(log, ScanLog):
        points = log.points_of(0) if len(log) else np.empty((0, log.dimension))
        return Setup(log.dimension, sigma_m or FEW_M, _reach(points), log.sensor)
    sigma = sigma_m or _noise_of(log)
    return Setup(log.points_robot.shape[1], sigma, _reach(log.points_robot))


def _reach(points: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(points, axis=1).max(initial=1.0))


def _noise_of(log: ObservationLog) -> float:
    """Estimate the noise of a landmark log, metres."""
    mapper = PointMapper()
    first = log.first_iteration
    for scan in log.between(first, first + GUESSED_FROM).scans():
        mapper.update(scan.points_robot)
    mapper.finish()
    return mapper.noise_m if mapper.noise_m > 0 else FEW_M


def _run(
    method: Method, data: Data[Log], association: Association, most: int | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """Return the labels (n,), and the seconds of each iteration (k,) and of the end."""
    labels, durations_s = [np.empty(0, np.int64)], []
    log = data.log
    if most is not None and len(log):
        log = log.between(log.first_iteration, log.first_iteration + most)
    for scan in log.scans():
        ids = getattr(scan, "ids", None) if association == "known" else None
        began = process_time()
        labels.append(method.update(scan.points_robot, ids))
        durations_s.append(process_time() - began)
    began = process_time()
    method.finish()
    finish_s = process_time() - began
    return method.landmarks_of(np.concatenate(labels)), np.array(durations_s), finish_s


def _result(
    method: Method, data: Data[Log], association: Association, labels: NDArray[np.int64]
) -> Result:
    """Return what a method made of a log as a result."""
    log, poses, seen = data.log, method.trajectory, labels >= 0
    there = np.isfinite(poses).all(axis=(1, 2))
    iteration, rows = np.empty((2, 0), np.int64)
    dimensions = 2
    if isinstance(log, ObservationLog):
        iteration, rows, dimensions = log.iteration, log.rows, log.points_robot.shape[1]
    else:
        labels, seen = labels[:0], seen[:0]
    first = log.first_iteration
    summary = {
        "association": association,
        "dimensions": dimensions,
        "scans": [first, first + len(log)],
    }
    table = table_of(method.map, labels, iteration, range(first, first + len(log)))
    tracks = Tracks(iteration[seen], rows[seen], labels[seen])
    result = Result(table, tracks, stamps_of(log)[there], poses[there], summary)
    planes = method.planes
    return result if planes is None else PlaneResult(**vars(result), planes=planes)


def _accuracy(result: Result, data: Data[Log]) -> dict[str, float | None]:
    """Compare a result with the truth."""
    log, truth = data.log if isinstance(data.log, ObservationLog) else None, data.truth
    assert truth is not None
    found = evaluate(result, truth, log)
    figures = {name: getattr(found, name, None) for name in (*ACCURACY, *PATH)}
    matched = found.counts.get("matched_landmarks", found.counts.get("matched_corners"))
    often = match_landmarks(result, truth, identify(result, log), often=True)
    return figures | {"matched": matched, "often_rmse_m": often.rmse_m if often else None}


def table_of(
    found: LandmarkMap, labels: NDArray[np.int64], iteration: NDArray[np.int64], covered: range
) -> LandmarkTable:
    """Return one row for every landmark that was labelled, mapped or not.

    Parameters
    ----------
    found : LandmarkMap
    labels, iteration : (n,) int64
        Of every observation of the log; -1 where it has no label.
    covered : range
        Iterations of the log.
    """
    landmark, row = np.unique(labels[labels >= 0], return_inverse=True)
    m, iteration = len(landmark), iteration[labels >= 0]
    first, last = np.full(m, covered.stop), np.full(m, covered.start - 1)
    np.minimum.at(first, row, iteration)
    np.maximum.at(last, row, iteration)
    position = np.full((m, 3), np.nan)
    mapped = np.isin(landmark, found.landmark_ids)
    at = np.searchsorted(found.landmark_ids, landmark[mapped])
    position[mapped] = found.positions[at]
    return LandmarkTable(
        landmark=landmark,
        position=position,
        sd=np.full(m, np.nan),
        observations=np.bincount(row, minlength=m),
        first_iteration=first,
        last_iteration=last,
        level=mapped.astype(np.int64),
        status=np.where(mapped, "static", "unmapped"),
        submap=np.where(mapped, 0, -1),
        moving_bin=np.full(m, -1),
    )
