"""One run: from a log, through a mapper, to a result.

`relmap map`, `relmap compare`, the figures and the benchmarks all run logs through this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.shown import Brief
from relmap.datasets.base import ObservationLog
from relmap.datasets.copies import without_copies
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import (
    AnyMapper,
    Association,
    Log,
    Method,
    Progress,
    Through,
    feed,
    stamps_of,
)
from relmap.evaluation.space_run import result_in_space
from relmap.evaluation.summary import completion, is_refined, summary_of
from relmap.io.results import LEAST_SCANS, Result, SubmapPath, Tracks, shifted, write_result
from relmap.planes import PlaneMapper
from relmap.planes.walls.files import DrawnSubmap, PlaneResult, write_planes, write_submaps
from relmap.planes.walls.table import PlaneTable
from relmap.planes3d import Plane3dMapper
from relmap.planes3d.files import Plane3dResult, write_parts
from relmap.points import PointMapper
from relmap.segmentation import PlaneSegmenter

POINTS_DRAWN = 100_000
"""Maximum number of points in a picture of a submap."""


@dataclass(frozen=True, eq=False, repr=False)
class Run(Brief):
    """A result and the groups behind it.

    Attributes
    ----------
    result : Result
        For walls a `PlaneResult`, for planes in space a `Plane3dResult`.
    groups : tuple of (g,) int64
        Landmark labels of each group.
    """

    result: Result
    groups: tuple[Ints, ...]

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
    through: Through = iter,
    refine: bool = False,
    seen: Sequence[Ints] = (),
    segmenter: PlaneSegmenter | None = None,
    odometry: bool = False,
    progress: Progress | None = None,
) -> Run:
    """Map a whole log.

    Parameters
    ----------
    mapper : PointMapper, PlaneMapper or Plane3dMapper
        A new mapper, or one that has processed the first scans of the log or, except for planes in
        space, other logs.
    log : ObservationLog or ScanLog
        Landmarks for a point mapper, point scans for the others.
    association, refine, odometry, progress
        As for `map_log`.
    about : dict, optional
        Additional entries of the summary, such as the input.
    through : callable, optional
        Wraps the iterable of scans; if it ends early, so does the run.
    seen : sequence of (n,) int64
        The labels of the scans of the log that the mapper has already processed.
    segmenter : PlaneSegmenter, optional
        Finds walls; by default one with the sensor limits given by the log.

    Returns
    -------
    Run

    Raises
    ------
    RelmapError
        If ``known`` is requested for a log without ids, or a scan of the log is damaged.
    """
    offset = log.first_iteration - (mapper.n_iterations - len(seen))
    fed = feed(mapper, log, association, refine, through, len(seen), segmenter, odometry, progress)
    labels = [*seen, *fed.labels]
    done = log.between(log.first_iteration, log.first_iteration + len(labels))
    result = result_of(mapper, done, labels, association, offset)
    groups: tuple[Ints, ...] = ()
    summary = (about or {}) | {"configuration": mapper.settings} | result.summary
    if not isinstance(mapper, Plane3dMapper):
        groups = tuple(group.landmarks for group in mapper.groups)
        summary |= summary_of(mapper, result, done, offset, len(groups))
    summary |= completion(log, done, fed, is_refined(mapper))
    return Run(replace(result, summary=summary), groups)


def map_log(
    log: Log,
    mapper: AnyMapper | None = None,
    *,
    association: Association = "nearest",
    odometry: bool = True,
    refine: bool = True,
    progress: Progress | None = None,
) -> Run:
    """Map a whole log as `relmap map` does.

    Parameters
    ----------
    log : ObservationLog or ScanLog
        As read by `relmap.datasets`, or made from a data frame.
    mapper : PointMapper, PlaneMapper or Plane3dMapper, optional
        Processes the log; by default a new one, for points or walls according to the log.
    association : "nearest" or "known"
        ``known`` passes the ids of the log to the mapper, ``nearest`` does not.
    odometry : bool
        Whether to use the odometry of the log, if any.
    refine : bool
        Whether to refine the map at the end.
    progress : callable, optional
        Called as ``f(done, total)`` after each scan.

    Returns
    -------
    Run
        Its `result` is what `relmap map` writes.

    Raises
    ------
    RelmapError
        If `log` is not a log, ``known`` is requested for a log without ids, or a scan is damaged.
    """
    if not isinstance(log, ObservationLog | ScanLog):
        raise RelmapError(
            f"map_log got a {type(log).__name__}, expected a log: open_log and open_scans of "
            "relmap.datasets read files, log_of_frame takes a data frame"
        )
    if mapper is None:
        mapper = PlaneMapper() if isinstance(log, ScanLog) else PointMapper()
    if odometry and isinstance(log, ObservationLog):
        log = without_copies(log)
    return run_mapper(mapper, log, association, refine=refine, odometry=odometry, progress=progress)


def result_of(
    method: Method | Plane3dMapper,
    log: Log,
    labels: Sequence[Ints],
    association: Association,
    offset: int,
) -> Result:
    """Return the result of a method on a log.

    `log`: the last processed iterations; `labels`, sequence of (n,): labels of each scan; `offset`:
    log number of the method's first iteration. For walls the result is a `PlaneResult`, for planes
    in space a `Plane3dResult`. Otherwise its summary only contains association, dimensions and
    iterations.
    """
    tracks = _tracks(method, log, labels, association)
    if isinstance(method, Plane3dMapper):
        return result_in_space(method, log, tracks)
    first, k = log.first_iteration, len(log)
    poses, stamps_s = method.trajectory[first - offset :], stamps_of(log)
    there = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    paths = method.paths if isinstance(method, PointMapper) else []
    dimensions = 2 if isinstance(log, ScanLog) else log.points_robot.shape[1]
    scans = [first, first + k]
    result = Result(
        shifted(method.landmarks, offset),
        tracks,
        stamps_s[there],
        poses[there],
        {"association": association, "dimensions": dimensions, "scans": scans},
        tuple(method.submaps),
        first + there,
        tuple(_path(offset + iterations, poses, log) for iterations, poses in paths),
    )
    if not isinstance(method, PlaneMapper):
        return result
    every_s = np.concatenate([np.full(first - offset, np.nan), stamps_s])
    weak = method.weak_links
    drawn = tuple(
        _drawn(method, number, every_s[slice(*submap.span)], offset, weak)
        for number, submap in enumerate(method.submaps)
        if number == 0 or submap.n_scans >= LEAST_SCANS
    )
    return PlaneResult(**vars(result), planes=shifted(method.planes, offset), drawn=drawn)


def write_tables(folder: Path, result: Result) -> None:
    """Write the files of a result, except the pictures; RelmapError if one cannot be written."""
    write_result(folder, result)
    if isinstance(result, Plane3dResult):
        write_parts(folder, result)
    elif isinstance(result, PlaneResult):
        write_planes(folder, result.planes)
        write_submaps(folder, result.drawn)


def _path(iterations: Ints, poses: Floats, log: Log) -> SubmapPath:
    """Return the part of the path in a submap, (p,) and (p, 4, 4), of the scans of the log."""
    own = iterations >= log.first_iteration
    scans = iterations[own]
    return SubmapPath(scans, stamps_of(log)[scans - log.first_iteration], poses[own])


def _drawn(
    mapper: PlaneMapper, number: int, stamps_s: Floats, offset: int, weak_links: Ints
) -> DrawnSubmap:
    """Return a submap for files and pictures."""
    submap = mapper.submaps[number]
    known = submap.known
    beams = mapper.beams_of(number, POINTS_DRAWN)
    weak = np.searchsorted(known, np.intersect1d(weak_links - submap.span[0], known))
    return DrawnSubmap(
        offset + submap.span[0] + known,
        stamps_s[known],
        submap.poses[known],
        shifted(mapper.planes_of(number), offset),
        beams.ends,
        np.searchsorted(known, beams.scan),
        weak[weak > 0],
    )


def _tracks(
    method: Method | Plane3dMapper, log: Log, labels: Sequence[Ints], association: Association
) -> Tracks:
    """Return the landmark of each observation; of planes, `row` is the index in the scan."""
    counts = [len(each) for each in labels]
    iteration = log.first_iteration + np.repeat(np.arange(len(counts)), counts)
    if isinstance(log, ObservationLog):
        rows = log.rows
    else:
        rows = np.concatenate([*map(np.arange, counts), np.empty(0, np.int64)])
    label = np.concatenate([*labels, np.empty(0, np.int64)])
    if isinstance(method, PlaneMapper):  # as they are now: scans may have been mapped again
        label = method.history.plane[len(method.history.plane) - len(label) :]
    label = method.landmarks_of(label)
    known, rejected = label >= 0, None
    if isinstance(log, ObservationLog) and log.ids is not None and association == "known":
        rejected = np.where(label != log.ids, log.ids, -1)[known]
    overruled = None if rejected is None or not (rejected >= 0).any() else rejected
    return Tracks(iteration[known], rows[known], label[known], overruled)
