"""One run: a log goes through a mapper, iteration by iteration, and comes out as a result."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from time import perf_counter
from typing import Any, Literal, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

import relmap
from relmap.core.errors import RelmapError
from relmap.core.landmarks import LandmarkTable, Piece
from relmap.core.refinement.joint import Refined
from relmap.datasets.base import ObservationLog, Scan
from relmap.evaluation.weakness import weakness
from relmap.io.results import Result, Tracks, shifted

Association = Literal["nearest", "known"]
Progress = Callable[[Iterable[Scan]], Iterable[Scan]]
"""Wraps the scans of a run, to show how far it is."""


class Grouped(Protocol):
    """A group of landmarks that were mapped together."""

    @property
    def landmarks(self) -> NDArray[np.int64]:
        """Labels, (g,) int64."""
        ...


class Mapper(Protocol):
    """What a mapper offers to a run; see `relmap.PointMapper`."""

    def update(
        self, points: NDArray[np.float64], ids: NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Take one iteration's observations; return the label of each."""
        ...

    def finish(self) -> object:
        """Map what is left."""
        ...

    def refine(self) -> object:
        """Lay all relative maps on one another at once."""
        ...

    def landmarks_of(self, labels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return what landmarks, labelled by earlier updates, are called now."""
        ...

    @property
    def landmarks(self) -> LandmarkTable:
        """Every landmark ever seen."""
        ...

    @property
    def rejected(self) -> NDArray[np.int64]:
        """Iterations (r,) whose scans fit no other and so add nothing to the map."""
        ...

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """Pose of every iteration, (k, 4, 4), NaN where there is none."""
        ...

    @property
    def pieces(self) -> Sequence[Piece]:
        """The pieces of the map, the largest first."""
        ...

    @property
    def refined(self) -> Sequence[Refined]:
        """The pieces as refined, with what their segments and merges are apart; or none."""
        ...

    @property
    def groups(self) -> Sequence[Grouped]:
        """The groups in the order in which they were mapped."""
        ...


MANY = 100
"""Rejected iterations that the summary lists one by one."""


@dataclass(frozen=True, eq=False)
class Run:
    """A result with what only the running program knows.

    Attributes
    ----------
    result : Result
    groups : tuple of (g,) int64
        Landmark labels of each group.
    """

    result: Result
    groups: tuple[NDArray[np.int64], ...]


def run_mapper(
    mapper: Mapper,
    log: ObservationLog,
    association: Association,
    about: dict[str, Any] | None = None,
    progress: Progress | None = None,
    refine: bool = False,
    seen: Sequence[NDArray[np.int64]] = (),
    before: int = 0,
) -> Run:
    """Map a whole log.

    Parameters
    ----------
    mapper : Mapper
        A fresh one, or one that has taken in the first scans of the log.
    log : ObservationLog
    association : "nearest" or "known"
        ``known`` hands the ids of the log to the mapper, ``nearest`` keeps them from it.
    about : dict, optional
        What else the summary should tell: configuration, input, ...
    progress : callable, optional
        Wraps the iterable of scans; where it ends before them, the run does.
    refine : bool
        Whether to refine the map at the end.
    seen : sequence of (n,) int64
        The labels of the scans that the mapper has taken in.
    before : int
        Iterations of the mapper before the log.  They have numbers below those of the log.

    Returns
    -------
    Run

    Raises
    ------
    RelmapError
        Where ``known`` is asked of a log without ids.
    """
    if association == "known" and log.ids is None:
        raise RelmapError("association known needs a log with ids, and this one has none")
    scans: Iterable[Scan] = islice(log.scans(), len(seen), None)
    new, durations_s = _mapped(mapper, progress(scans) if progress else scans, association)
    labels, n_input = np.concatenate([*seen, *new, np.empty(0, np.int64)]), len(log)
    log = log.between(log.first_iteration, log.first_iteration + len(seen) + len(new))
    mapper.finish()
    refine_s = _refined(mapper, refine)
    label = mapper.landmarks_of(labels)
    table, poses, groups = mapper.landmarks, mapper.trajectory[before:], mapper.groups
    offset = log.first_iteration - before
    pieces = tuple(mapper.pieces)
    summary = {
        **(about or {}),
        "association": association,
        **_summary(log, table, poses, len(groups), pieces, offset),
        **interruption(len(log), n_input),
        "refined": refine,
        "refinement": weakness(mapper.refined, offset),
        "rejected_iterations": rejected_iterations(mapper.rejected + offset),
        "timing": timing(durations_s) | {"refine_ms": 1e3 * refine_s},
    }
    table, tracks = shifted(table, offset), _tracks(log, label)
    result = Result(table, tracks, *_trajectory(log, poses), summary, pieces)
    return Run(result, tuple(group.landmarks for group in groups))


def _mapped(
    mapper: Mapper, scans: Iterable[Scan], association: Association
) -> tuple[list[NDArray[np.int64]], NDArray[np.float64]]:
    """Return the labels (n,) of each scan, and the time of each update, seconds, (k,)."""
    labels, durations_s = [], []
    for scan in scans:
        ids = scan.ids if association == "known" else None
        began = perf_counter()
        labels.append(mapper.update(scan.points_robot, ids=ids))
        durations_s.append(perf_counter() - began)
    return labels, np.array(durations_s)


def interruption(n_mapped: int, n_input: int) -> dict[str, Any]:
    """Return what a summary tells of a run that may have been stopped before the end."""
    return {"interrupted": n_mapped < n_input, "input_iterations": n_input}


def _refined(mapper: Mapper, refine: bool) -> float:
    """Refine the map where that is asked for; return how long it took, seconds."""
    began = perf_counter()
    if refine:
        mapper.refine()
    return perf_counter() - began


def _summary(
    log: ObservationLog,
    table: LandmarkTable,
    poses: NDArray[np.float64],
    n_groups: int,
    pieces: Sequence[Piece],
    offset: int,
) -> dict[str, Any]:
    return {
        "dimensions": log.points_robot.shape[1],
        "scans": [log.first_iteration, log.end_iteration],
        "versions": versions(),
        "counts": _counts(log, table, poses, n_groups),
        "pieces": [_summary_of(piece, offset) for piece in pieces],
    }


def rejected_iterations(rejected: NDArray[np.int64]) -> dict[str, Any]:
    """Return how many iterations were rejected, and which; of many the first and the last."""
    numbers = rejected.tolist()
    if len(numbers) > MANY:
        numbers = numbers[: MANY // 2] + numbers[-MANY // 2 :]
    return {"count": len(rejected), "iterations": numbers}


def _summary_of(piece: Piece, first_iteration: int) -> dict[str, int]:
    return {
        "landmarks": len(piece.landmark_ids),
        "first_iteration": first_iteration + piece.first_iteration,
        "last_iteration": first_iteration + piece.last_iteration,
    }


def _tracks(log: ObservationLog, label: NDArray[np.int64]) -> Tracks:
    known = label >= 0
    return Tracks(log.iteration[known], log.rows[known], label[known])


def _trajectory(
    log: ObservationLog, poses: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    there = np.isfinite(poses).all(axis=(1, 2))
    return stamps_of(log)[there], poses[there]


def stamps_of(log: ObservationLog) -> NDArray[np.float64]:
    """Return the time of each iteration, seconds, or its number where the log has no clock."""
    if log.stamps_s is not None:
        return log.stamps_s
    return np.arange(log.first_iteration, log.end_iteration, dtype=np.float64)


def _counts(
    log: ObservationLog, table: LandmarkTable, poses: NDArray[np.float64], groups: int
) -> dict[str, int]:
    return {
        "iterations": len(log),
        "observations": len(log.points_robot),
        "landmarks": len(table.landmark),
        "mapped": int(np.isfinite(table.position).all(axis=1).sum()),
        "static": int((table.status == "static").sum()),
        "dynamic": int((table.status == "dynamic").sum()),
        "moving_bins": len(np.unique(table.moving_bin[table.moving_bin >= 0])),
        "unmapped": int((table.status == "unmapped").sum()),
        "groups": groups,
        "iterations_without_observation": len(log) - len(np.unique(log.iteration)),
        "iterations_without_pose": int(len(log) - np.isfinite(poses).all(axis=(1, 2)).sum()),
    }


def timing(durations_s: NDArray[np.float64]) -> dict[str, float | None]:
    """Return the time per iteration in milliseconds, from that of each in seconds, (k,)."""
    if not len(durations_s):
        return dict.fromkeys(["median_ms", "p95_ms", "first_100_median_ms", "last_100_median_ms"])
    in_ms = 1e3 * durations_s
    return {
        "median_ms": float(np.median(in_ms)),
        "p95_ms": float(np.percentile(in_ms, 95)),
        "first_100_median_ms": float(np.median(in_ms[:100])),
        "last_100_median_ms": float(np.median(in_ms[-100:])),
    }


def versions() -> dict[str, str]:
    """Return the versions of what the numbers may depend on."""
    return {
        "relmap": relmap.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
