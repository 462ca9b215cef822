"""One run: a log goes through a mapper, iteration by iteration, and comes out as a result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog, SensorView
from relmap.evaluation.summary import residuals_told, submaps_told, summary_of, timing
from relmap.io.results import Result, Tracks, shifted
from relmap.planes import PlaneMapper
from relmap.planes.files import DrawnSubmap, PlaneResult
from relmap.planes.table import PlaneTable
from relmap.points import PointMapper
from relmap.segmentation import PlaneSegmenter

Association = Literal["nearest", "known"]
Log = ObservationLog | ScanLog
AnyMapper = PointMapper | PlaneMapper
Progress = Callable[[Iterable[Any]], Iterable[Any]]
"""Wraps the scans of a run, to show how far it is."""
SHOWN = 10
"""Scans without which a submap beside the map is listed only."""


@dataclass(frozen=True, eq=False)
class Run:
    """A result with what only the running program knows.

    Attributes
    ----------
    result : Result
        Of walls a `PlaneResult`.
    groups : tuple of (g,) int64
        Landmark labels of each group.
    """

    result: Result
    groups: tuple[NDArray[np.int64], ...]

    @property
    def planes(self) -> PlaneTable:
        """The walls of a run of the plane mapper."""
        assert isinstance(self.result, PlaneResult)
        return self.result.planes


def run_mapper(
    mapper: AnyMapper,
    log: Log,
    association: Association = "nearest",
    about: dict[str, Any] | None = None,
    progress: Progress | None = None,
    refine: bool = False,
    seen: Sequence[NDArray[np.int64]] = (),
    before: int = 0,
    segmenter: PlaneSegmenter | None = None,
) -> Run:
    """Map a whole log.

    Parameters
    ----------
    mapper : PointMapper or PlaneMapper
        A fresh one, or one that has taken in the first scans of the log.
    log : ObservationLog or ScanLog
        Of landmarks for a point mapper, of point scans for a plane mapper.
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
    segmenter : PlaneSegmenter, optional
        Finds walls; one that knows what the log tells of its sensor where left out.

    Returns
    -------
    Run

    Raises
    ------
    RelmapError
        Where ``known`` is asked of a log without ids, or a scan of the log is damaged.
    """
    known = association == "known"
    if known and getattr(log, "ids", None) is None:
        raise RelmapError("association known needs a log with ids, and this one has none")
    first, n_input = log.first_iteration, len(log)
    scans: Iterable[Any] = ()
    if len(seen) < n_input:
        scans = log.between(first + len(seen), first + n_input).scans()
    prepare = _seen_from(log.sensor, segmenter) if isinstance(log, ScanLog) else _points_of
    new, durations_s = _mapped(mapper, progress(scans) if progress else scans, prepare, known)
    labels = [*seen, *new]
    log = log.between(first, first + len(labels))
    mapper.finish()
    began = perf_counter()
    if refine:
        mapper.refine()
    refine_s = perf_counter() - began
    result = _result(mapper, log, labels, before)
    groups = tuple(group.landmarks for group in mapper.groups)
    summary = {
        **(about or {}),
        "association": association,
        **summary_of(result, log, len(groups)),
        "interrupted": len(log) < n_input,
        "input_iterations": n_input,
        **submaps_told(mapper, first - before),
        "refined": refine,
        **residuals_told(mapper, first - before),
        "timing": timing(durations_s, refine_s, isinstance(log, ScanLog)),
    }
    return Run(replace(result, summary=summary), groups)


def _mapped(
    mapper: AnyMapper,
    scans: Iterable[Any],
    prepare: Callable[[NDArray[np.float64]], Any],
    known: bool,
) -> tuple[list[NDArray[np.int64]], NDArray[np.float64]]:
    """Return the labels (n,) of each scan, and the seconds to prepare and to map it, (k, 2)."""
    labels, durations_s = [], []
    for scan in scans:
        began = perf_counter()
        seen = prepare(scan.points_robot)
        between = perf_counter()
        labels.append(mapper.update(seen, ids=scan.ids if known else None))
        durations_s.append([between - began, perf_counter() - between])
    return labels, np.array(durations_s).reshape(-1, 2)


def _result(
    mapper: AnyMapper, log: Log, labels: Sequence[NDArray[np.int64]], before: int
) -> Result:
    """Return what the mapper has found, without a summary."""
    offset, poses, stamps_s = (
        log.first_iteration - before,
        mapper.trajectory[before:],
        stamps_of(log),
    )
    there, table = np.isfinite(poses).all(axis=(1, 2)), shifted(mapper.landmarks, offset)
    tracks, submaps = _tracks(mapper, log, labels), tuple(mapper.submaps)
    dimensions = 2 if isinstance(log, ScanLog) else log.points_robot.shape[1]
    summary = {"dimensions": dimensions}
    result = Result(table, tracks, stamps_s[there], poses[there], summary, submaps)
    if isinstance(mapper, PointMapper):
        return result
    drawn = tuple(
        DrawnSubmap(stamps_s[slice(*submap.span)], submap.poses, mapper.planes_of(number))
        for number, submap in enumerate(mapper.submaps)
        if number == 0 or len(submap.poses) >= SHOWN
    )
    return PlaneResult(**vars(result), planes=shifted(mapper.planes, offset), drawn=drawn)


def _tracks(mapper: AnyMapper, log: Log, labels: Sequence[NDArray[np.int64]]) -> Tracks:
    """Return what each observation is of; of walls `row` counts those of a scan."""
    counts = [len(each) for each in labels]
    iteration = log.first_iteration + np.repeat(np.arange(len(counts)), counts)
    rows = np.concatenate([np.arange(n) for n in counts] or [np.empty(0, np.int64)])
    if isinstance(log, ObservationLog):
        rows = log.rows
    label = mapper.landmarks_of(np.concatenate([*labels, np.empty(0, np.int64)]))
    known = label >= 0
    return Tracks(iteration[known], rows[known], label[known])


def stamps_of(log: Log) -> NDArray[np.float64]:
    """Return the time of each iteration, seconds, or its number where the log has no clock."""
    if log.stamps_s is not None:
        return log.stamps_s
    return np.arange(log.first_iteration, log.first_iteration + len(log), dtype=np.float64)


def _points_of(points_robot: NDArray[np.float64]) -> NDArray[np.float64]:
    return points_robot


def _seen_from(
    view: SensorView, segmenter: PlaneSegmenter | None
) -> Callable[[NDArray[np.float64]], SimpleNamespace]:
    used = segmenter or segmenter_for(view)
    return lambda points_robot: segment_scan(used, points_robot, view)


def segmenter_for(view: SensorView) -> PlaneSegmenter:
    """Return a segmenter that knows what is known of the sensor."""
    return PlaneSegmenter(view_rad=view.view_rad, range_m=view.range_m)


def segment_scan(
    segmenter: PlaneSegmenter, points_robot: NDArray[np.float64], view: SensorView
) -> SimpleNamespace:
    """Return the planes of a scan as the mapper takes them, seen from where the sensor is.

    A wall whose front looks at the sensor, but not at the robot's centre, is left out.
    """
    c, s = np.cos(view.yaw_rad), np.sin(view.yaw_rad)
    R, t = np.array([[c, -s], [s, c]]), np.array([view.x_m, view.y_m])
    points_sensor = points_robot.copy()
    points_sensor[:, :2] = (points_robot[:, :2] - t) @ R
    found = segmenter.fit(points_sensor).planes_
    ends = found.ends @ R.T + t
    front = ends[:, 0, 0] * ends[:, 1, 1] > ends[:, 0, 1] * ends[:, 1, 0]
    rest = ("end_type", "noise", "n_points", "z_extent")
    return SimpleNamespace(ends=ends[front], **{name: getattr(found, name)[front] for name in rest})
