"""One run of the plane mapper: a log of point scans goes through it and comes out as a result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.landmarks import Piece
from relmap.datasets.scans import PointScan, ScanLog, SensorView
from relmap.evaluation.run import interruption, timing, versions
from relmap.evaluation.weakness import weakness
from relmap.io.results import Result, Tracks, shifted
from relmap.planes import PlaneMapper
from relmap.planes.submaps import Submap
from relmap.planes.table import PlaneTable
from relmap.segmentation import PlaneSegmenter

SHOWN = 10
"""Scans without which a submap beside the map is listed only."""
Progress = Callable[[Iterable[PointScan]], Iterable[PointScan]]
"""Wraps the scans of a run, to show how far it is."""


@dataclass(frozen=True, eq=False)
class DrawnSubmap:
    """A submap as files and pictures show it.

    Attributes
    ----------
    stamps_s : (k,) float64
    poses : (k, 4, 4) float64
        ``T_submap_robot``.
    planes : PlaneTable
        Mapped in its frame.
    """

    stamps_s: NDArray[np.float64]
    poses: NDArray[np.float64]
    planes: PlaneTable


@dataclass(frozen=True, eq=False)
class PlaneRun:
    """A result with its walls.

    Attributes
    ----------
    result : Result
        Its landmarks are corners; its tracks tell the wall of every one seen: `row` counts the
        walls of a scan, `landmark` is the number of the wall.
    planes : PlaneTable
        Iterations are the log's own numbers.
    submaps : tuple of DrawnSubmap
        Parts of the run that nothing ties to one another, the map itself first.
    """

    result: Result
    planes: PlaneTable
    submaps: tuple[DrawnSubmap, ...]


def run_plane_mapper(
    mapper: PlaneMapper,
    log: ScanLog,
    segmenter: PlaneSegmenter | None = None,
    about: dict[str, Any] | None = None,
    progress: Progress | None = None,
    refine: bool = True,
    seen: Sequence[NDArray[np.int64]] = (),
) -> PlaneRun:
    """Map a whole log of point scans.

    Parameters
    ----------
    mapper : PlaneMapper
        A fresh one, or one that has taken in the first scans of the log.
    log : ScanLog
    segmenter : PlaneSegmenter, optional
        One that knows what the log tells of its sensor where left out.
    about : dict, optional
        What else the summary should tell.
    progress : callable, optional
        Wraps the iterable of scans; where it ends before them, the run does.
    refine : bool
        Whether to refine the map at the end.
    seen : sequence of (m,) int64
        The walls of the scans that the mapper has taken in.

    Raises
    ------
    RelmapError
        Where a scan of the log is damaged.
    """
    first, n_input, view = log.first_iteration, len(log), log.sensor
    scans: Iterable[PointScan] = ()
    if len(seen) < n_input:
        scans = log.between(first + len(seen), first + n_input).scans()
    segmenter = segmenter or segmenter_for(view)
    scans = progress(scans) if progress else scans
    new, durations_s = _mapped(mapper, segmenter, scans, view)
    walls = [*seen, *new]
    log = log.between(first, first + len(walls))
    mapper.finish()
    began = perf_counter()
    if refine:
        mapper.refine()
    refine_s = perf_counter() - began
    planes, poses, tracks = mapper.planes, mapper.trajectory, _tracks(mapper, walls, first)
    table, pieces = mapper.landmarks, tuple(mapper.pieces)
    there = np.isfinite(poses).all(axis=(1, 2))
    summary = {
        **(about or {}),
        "association": "nearest",
        "dimensions": 2,
        "scans": [first, first + len(log)],
        "versions": versions(),
        "counts": _counts(mapper, planes, poses, walls),
        "pieces": [_summary_of(piece, first) for piece in pieces],
        **interruption(len(log), n_input),
        "submaps": [_submap(submap, first) for submap in mapper.submaps],
        "weak_links": (mapper.weak_links + first).tolist(),
        "refined": refine,
        "refinement": weakness(mapper.refined, first),
        "timing": _timing(durations_s, refine_s),
    }
    result = Result(
        shifted(table, first), tracks, log.stamps_s[there], poses[there], summary, pieces
    )
    planes = replace(
        planes,
        first_iteration=planes.first_iteration + first,
        last_iteration=planes.last_iteration + first,
    )
    submaps = tuple(
        DrawnSubmap(log.stamps_s[slice(*submap.span)], submap.poses, mapper.planes_of(number))
        for number, submap in enumerate(mapper.submaps)
        if number == 0 or len(submap.poses) >= SHOWN
    )
    return PlaneRun(result, planes, submaps)


def _submap(submap: Submap, first: int) -> dict[str, Any]:
    begin, end = submap.span
    return {
        "scans": end - begin,
        "iterations": [first + begin, first + end - 1],
        "metres": submap.length_m,
        "refined": submap.refined,
    }


def _timing(durations_s: NDArray[np.float64], refine_s: float) -> dict[str, float | None]:
    """Return what segmenting and mapping (k, 2) took, seconds, as the summary tells it."""
    segmentation_s, total_s = durations_s[:, 0], durations_s.sum(axis=1)
    share = float(segmentation_s.sum() / total_s.sum()) if len(total_s) else None
    return timing(durations_s[:, 1]) | {
        "segmentation_median_ms": _median_ms(segmentation_s),
        "segmentation_share": share,
        "scan_median_ms": _median_ms(total_s),
        "refine_ms": 1e3 * refine_s,
    }


def _mapped(
    mapper: PlaneMapper, segmenter: PlaneSegmenter, scans: Iterable[PointScan], view: SensorView
) -> tuple[list[NDArray[np.int64]], NDArray[np.float64]]:
    """Return the walls of each scan, and the seconds for segmenting and mapping it, (k, 2)."""
    walls, durations_s = [], []
    for scan in scans:
        began = perf_counter()
        planes = segment_scan(segmenter, scan.points_robot, view)
        between = perf_counter()
        walls.append(mapper.update(planes))
        durations_s.append([between - began, perf_counter() - between])
    return walls, np.array(durations_s).reshape(-1, 2)


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
    return SimpleNamespace(
        ends=ends[front],
        end_type=found.end_type[front],
        noise=found.noise[front],
        n_points=found.n_points[front],
        z_extent=found.z_extent[front],
    )


def _median_ms(seconds: NDArray[np.float64]) -> float | None:
    return 1e3 * float(np.median(seconds)) if len(seconds) else None


def _tracks(mapper: PlaneMapper, walls: Sequence[NDArray[np.int64]], first: int) -> Tracks:
    counts = [len(seen) for seen in walls]
    iteration = first + np.repeat(np.arange(len(walls)), counts)
    row = np.concatenate([np.arange(n) for n in counts] or [np.empty(0, dtype=np.int64)])
    labels = np.concatenate([*walls, np.empty(0, dtype=np.int64)])
    return Tracks(iteration, row, mapper.landmarks_of(labels))


def _counts(
    mapper: PlaneMapper,
    planes: PlaneTable,
    poses: NDArray[np.float64],
    walls: Sequence[NDArray[np.int64]],
) -> dict[str, int]:
    table = mapper.landmarks
    status = {
        f"{name}s_{kind}": int((rows.status == kind).sum())
        for name, rows in (("plane", planes), ("corner", table))
        for kind in ("static", "dynamic", "unmapped")
    }
    return {
        "iterations": len(walls),
        "observations": int(sum(map(len, walls))),
        "planes": len(planes.plane),
        "corners": len(table.landmark),
        **status,
        "groups": len(mapper.groups),
        "iterations_without_pose": int((~np.isfinite(poses).all(axis=(1, 2))).sum()),
    }


def _summary_of(piece: Piece, first_iteration: int) -> dict[str, int]:
    return {
        "landmarks": len(piece.landmark_ids),
        "first_iteration": first_iteration + piece.first_iteration,
        "last_iteration": first_iteration + piece.last_iteration,
    }
