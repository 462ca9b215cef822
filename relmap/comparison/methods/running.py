"""One method on one log: run, timed, and compared with the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from relmap.comparison.memory import PeakMemory
from relmap.comparison.methods.base import Association, Method, MethodInfo, Setup
from relmap.comparison.methods.relmap_planes import RelmapPlanes
from relmap.comparison.sources import Data, Landmarks, Scans
from relmap.core.landmarks import LandmarkMap, LandmarkTable
from relmap.datasets.base import ObservationLog
from relmap.evaluation import metrics
from relmap.evaluation.evaluate import evaluate, identify, match_landmarks
from relmap.evaluation.plane_evaluate import evaluate_planes
from relmap.evaluation.run import stamps_of, timing
from relmap.evaluation.truth import Truth
from relmap.io.results import Result, Tracks
from relmap.planes.table import PlaneTable
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
map in pieces are those of the largest, and the error of checked relations between poses."""
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
    planes : PlaneTable or None
        The walls, where it maps walls.
    figures : dict
        `ACCURACY`, `PATH` and `COST`, None where one cannot be had.
    """

    result: Result
    planes: PlaneTable | None
    figures: dict[str, float | None]


def run_method(
    info: MethodInfo, data: Data, association: Association, sigma_m: float | None = None
) -> MethodRun:
    """Run a method over a log and compare what comes out with the truth.

    One thread in every library; a part of the log is run before, on a method of its own.

    Parameters
    ----------
    info : MethodInfo
    data : Landmarks or Scans
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
        kind = "landmarks" if isinstance(data, Landmarks) else "scans"
        _run(info.make(setup), data, association, WARM_UP[kind])
        method = info.make(setup)
        memory = PeakMemory()
        labels, durations_s, finish_s = _run(method, data, association)
        memory_mb = memory.grown_mb
        cost = _cost(durations_s, finish_s) | {"memory_mb": memory_mb}
        if isinstance(data, Landmarks):
            return _of_landmarks(method, data, association, labels, cost)
        return _of_scans(method, data, cost)


def setup_for(data: Data, sigma_m: float | None = None) -> Setup:
    """Return what methods are told beforehand of a log."""
    if isinstance(data, Scans):
        points = data.log.points_of(0) if len(data.log) else np.empty((0, data.log.dimension))
        return Setup(data.log.dimension, sigma_m or FEW_M, _reach(points), data.log.sensor)
    log = data.log
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
    method: Method, data: Data, association: Association, most: int | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """Return the labels (n,), and the seconds of each iteration (k,) and of the end."""
    labels, durations_s = [np.empty(0, np.int64)], []
    log = data.log
    if most is not None and len(log):
        log = log.between(log.first_iteration, log.first_iteration + most)
    known = association == "known" and isinstance(data, Landmarks)
    for scan in log.scans():
        ids = getattr(scan, "ids", None) if known else None
        began = process_time()
        labels.append(method.update(scan.points_robot, ids))
        durations_s.append(process_time() - began)
    began = process_time()
    method.finish()
    finish_s = process_time() - began
    return method.landmarks_of(np.concatenate(labels)), np.array(durations_s), finish_s


def _cost(durations_s: NDArray[np.float64], finish_s: float) -> dict[str, float | None]:
    told = timing(durations_s)
    return {
        "median_ms": told["median_ms"],
        "mean_ms": 1e3 * float(durations_s.mean()) if len(durations_s) else None,
        "last_100_median_ms": told["last_100_median_ms"],
        "total_s": float(durations_s.sum()) + finish_s,
    }


def _of_landmarks(
    method: Method,
    data: Landmarks,
    association: Association,
    labels: NDArray[np.int64],
    cost: dict[str, float | None],
) -> MethodRun:
    """Compare a map of landmarks with the truth."""
    log = data.log
    table = table_of(method.map, labels, log)
    seen = labels >= 0
    tracks = Tracks(log.iteration[seen], log.rows[seen], labels[seen])
    summary: dict[str, Any] = {
        "association": association,
        "dimensions": log.points_robot.shape[1],
        "scans": [log.first_iteration, log.end_iteration],
    }
    poses = method.trajectory
    there = np.isfinite(poses).all(axis=(1, 2))
    result = Result(table, tracks, stamps_of(log)[there], poses[there], summary)
    figures: dict[str, float | None] = dict.fromkeys((*ACCURACY, *PATH))
    if data.truth is not None:
        figures |= _known(evaluate(result, data.truth, log).as_dict())
        figures["often_rmse_m"] = _rmse_of_often_seen(result, data.truth, log)
    if not len(method.map.landmark_ids):
        figures |= dict.fromkeys(("matched", "coverage", "landmarks_per_true", "purity"))
    return MethodRun(result, None, figures | _path_coverage(len(result.poses), len(log)) | cost)


def _rmse_of_often_seen(result: Result, truth: Truth, log: ObservationLog) -> float | None:
    """Return the landmark RMSE of what was seen in at least ten iterations; None without ids."""
    identified = identify(result, log)
    if identified is None:
        return None
    labels, ids, _ = metrics.majority_ids(identified.landmark, identified.true_id)
    often = metrics.seen_often(identified.seen_id, identified.seen_iteration)
    table = result.landmarks
    kept = np.isin(table.landmark, labels[np.isin(ids, often)])
    position = np.where(kept[:, None], table.position, np.nan)
    result = replace(result, landmarks=replace(table, position=position))
    matched = match_landmarks(result, truth, identified)
    if matched is None:
        return None
    d = 2 if result.planar else 3
    return metrics.rms((matched.position @ matched.R.T + matched.t - matched.truth)[:, :d])


def _of_scans(method: Method, data: Scans, cost: dict[str, float | None]) -> MethodRun:
    """Compare a map of walls, or a path alone, with the truth."""
    log, poses = data.log, method.trajectory
    there = np.isfinite(poses).all(axis=(1, 2))
    no_rows = np.empty(0, np.int64)
    result = Result(
        _empty_table(),
        Tracks(no_rows, no_rows, no_rows),
        log.stamps_s[there],
        poses[there],
        {"association": "nearest", "dimensions": 2},
    )
    planes = method.planes if isinstance(method, RelmapPlanes) else None
    figures: dict[str, float | None] = dict.fromkeys((*ACCURACY, *PATH))
    if data.truth is not None:
        walls = planes if planes is not None else _no_planes()
        figures |= _known(evaluate_planes(result, walls, data.truth).as_dict())
    if planes is None:
        figures |= dict.fromkeys(("matched", "coverage"))
    return MethodRun(result, planes, figures | _path_coverage(len(result.poses), len(log)) | cost)


def _path_coverage(poses: int, iterations: int) -> dict[str, float | None]:
    return {"path_coverage": poses / iterations if iterations else None}


def _known(figures: dict[str, Any]) -> dict[str, float | None]:
    counts = figures["counts"]
    matched = counts.get("matched_landmarks", counts.get("matched_corners"))
    names = (*ACCURACY, *PATH)
    return {name: figures[name] for name in names if name in figures} | {"matched": matched}


def table_of(found: LandmarkMap, labels: NDArray[np.int64], log: ObservationLog) -> LandmarkTable:
    """Return one row for every landmark that was labelled, mapped or not.

    Parameters
    ----------
    found : LandmarkMap
    labels : (n,) int64
        Of every observation of the log; -1 where it has none.
    log : ObservationLog
    """
    landmark, row = np.unique(labels[labels >= 0], return_inverse=True)
    m, iteration = len(landmark), log.iteration[labels >= 0]
    first, last = np.full(m, log.end_iteration), np.full(m, log.first_iteration - 1)
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
        piece=np.where(mapped, 0, -1),
        moving_bin=np.full(m, -1),
    )


def _empty_table() -> LandmarkTable:
    whole, real = np.empty(0, np.int64), np.empty(0)
    text = np.empty(0, np.str_)
    return LandmarkTable(
        whole, np.empty((0, 3)), real, whole, whole, whole, whole, text, whole, whole
    )


def _no_planes() -> PlaneTable:
    whole, pairs = np.empty(0, np.int64), np.empty((0, 2))
    corner, text = np.empty((0, 2), np.int64), np.empty(0, np.str_)
    ends = np.empty((0, 2, 2))
    return PlaneTable(whole, ends, pairs, pairs, corner, whole, whole, whole, text)
