"""Running a log, scan by scan, through a mapper or another method."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter
from types import SimpleNamespace
from typing import Any, Literal, Protocol

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.geometry.motions import rotations
from relmap.core.landmarks import LandmarkMap, LandmarkTable, Submap
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog, SensorView
from relmap.planes import PlaneMapper
from relmap.planes3d import Plane3dMapper
from relmap.points import PointMapper
from relmap.segmentation import PlaneSegmenter

Association = Literal["nearest", "known"]
Log = ObservationLog | ScanLog
AnyMapper = PointMapper | PlaneMapper | Plane3dMapper
Through = Callable[[Iterable[Any]], Iterable[Any]]
"""Wraps the scans of a run; it may end early."""
Progress = Callable[[int, int], object]
"""Called after each scan with the number of scans done and the total."""


class Method(Protocol):
    """A mapper, or another method for comparison."""

    def update(self, points: Any, /, ids: Any = None) -> Ints:
        """Process one iteration.

        `points` (n, 2) or (n, 3), robot frame, metres. `ids` (n,): known association; negative for
        unidentified landmarks. Returns (n,): label of the landmark of each observation; -1 for
        none.
        """

    def finish(self) -> None:
        """Complete the map at the end of the log."""

    def landmarks_of(self, labels: Ints, /) -> Ints:
        """Return the current labels of landmarks (n,), given labels from earlier updates."""

    @property
    def map(self) -> LandmarkMap:
        """The landmarks mapped so far; none if a method makes no map of landmarks."""

    @property
    def landmarks(self) -> LandmarkTable:
        """Every landmark ever seen, mapped or not."""

    @property
    def submaps(self) -> Sequence[Submap]:
        """The submaps, the map itself first; empty if not supported."""

    @property
    def trajectory(self) -> Floats:
        """``T_map_robot`` of every iteration so far, (k, 4, 4); NaN if unknown."""


@dataclass(frozen=True, eq=False)
class Fed:
    """Labels and times of a run of a log through a method.

    `labels`, list of (n,): of each scan; `durations_s` (k, 2): times of preparation (segmentation)
    and mapping of each scan, seconds; `reading_s`: time that the log took to provide the scans.
    """

    labels: list[Ints]
    durations_s: Floats
    reading_s: float
    finish_s: float
    refine_s: float


def feed(
    method: Method | Plane3dMapper,
    log: Log,
    association: Association,
    refine: bool = False,
    through: Through = iter,
    n_seen: int = 0,
    segmenter: PlaneSegmenter | None = None,
    odometry: bool = False,
    progress: Progress | None = None,
    clock: Callable[[], float] = perf_counter,
) -> Fed:
    """Run a log through a method to its end, and measure the time.

    `method`: a mapper of planes gets those of a scan, every other method its points; `log`,
    `association`, `refine`, `through`, `segmenter`, `odometry`, `progress`: as for `run_mapper`;
    `n_seen`: scans of the log that the method has already processed; `clock`: returns the time,
    seconds. Raises `RelmapError` if ``known`` is requested for a log without ids or a mapper that
    associates itself, if a `Plane3dMapper` has mapped another log, or a scan is damaged.
    """
    known = association == "known"
    if isinstance(method, Plane3dMapper) and (known or method.n_iterations > n_seen):
        why = "has no known association" if known else "maps one log; this one has mapped another"
        raise RelmapError(f"a Plane3dMapper {why}")
    if known and getattr(log, "ids", None) is None:
        raise RelmapError("association known needs a log with ids, and this one has none")
    first, end = log.first_iteration, log.first_iteration + len(log)
    scans = log.between(first + n_seen, end).scans() if n_seen < len(log) else iter(())
    prepare, stamps_s = preparation(method, log, segmenter), _new_stamps(method, log, n_seen)
    labels: list[Ints] = []
    times_s = [[0.0, 0.0, clock()]]  # of each scan: when it was there, prepared, and mapped
    for scan in through(scans):
        began = clock()
        seen = prepare(scan.points_robot)
        between = clock()
        # The motion to the first scan of a log starts where no scan was taken.
        more = _known_of(method, scan, known, odometry and scan.iteration > first)
        if stamps_s is not None:
            more["stamp_s"] = stamps_s[scan.iteration - first]
        labels.append(method.update(seen, **more))
        times_s.append([began, between, clock()])
        if progress is not None:
            progress(n_seen + len(labels), len(log))
    over = clock()
    method.finish()
    finished = clock()
    if refine and isinstance(method, AnyMapper):
        method.refine()
    times = np.array(times_s)
    reading_s = float(np.sum(times[1:, 0] - times[:-1, 2]))
    return Fed(labels, np.diff(times[1:]), reading_s, finished - over, clock() - finished)


def _known_of(
    method: Method | Plane3dMapper, scan: Any, ids: bool, odometry: bool
) -> dict[str, Any]:
    """Return the additional input of a mapper for a scan."""
    more = {"ids": scan.ids} if ids else {}
    if isinstance(method, PlaneMapper):
        more["beams"] = scan.points_robot
    elif isinstance(method, PointMapper) and scan.covariances is not None:
        more["covariances"] = scan.covariances
    if odometry and scan.odometry is not None and isinstance(method, PointMapper | PlaneMapper):
        more["odometry"] = scan.odometry
    return more


def _new_stamps(method: Method | Plane3dMapper, log: Log, n_seen: int) -> Floats | None:
    """Return the times of the log, if later than those of the scans that a mapper has seen."""
    stamps_s = log.stamps_s
    if stamps_s is None or not isinstance(method, AnyMapper):
        return None
    known_s = method.stamps_s[np.isfinite(method.stamps_s)]
    return stamps_s if (np.diff(np.append(known_s[-1:], stamps_s[n_seen:])) > 0).all() else None


def preparation(
    method: Method | Plane3dMapper, log: Log, segmenter: PlaneSegmenter | None = None
) -> Callable[[Floats], Any]:
    """Return the conversion from the points of a scan to the input of the method."""
    if isinstance(method, Plane3dMapper):
        return lambda points_robot: method.segmenter.fit(points_robot).patches_
    if not (isinstance(method, PlaneMapper) and isinstance(log, ScanLog)):
        return lambda points_robot: points_robot
    view = log.sensor
    used = segmenter or segmenter_for(view)
    return lambda points_robot: segment_scan(used, points_robot, view)


def segmenter_for(view: SensorView, method: str | None = None) -> PlaneSegmenter:
    """Return a segmenter with the known limits of the sensor; `method` as for `PlaneSegmenter`."""
    return PlaneSegmenter(method, view_rad=view.view_rad, range_m=view.range_m)


def segment_scan(
    segmenter: PlaneSegmenter, points_robot: Floats, view: SensorView
) -> SimpleNamespace:
    """Return the planes of a scan as input for the mapper, as seen from the sensor.

    A wall whose front faces the sensor, but not the robot's centre, is left out.

    `points_robot` (n, 2) or (n, 3), robot frame, metres; `view`: pose of the sensor on the robot.
    Returns `ends`, `end_type`, `noise`, `n_points` and `z_extent` as in
    `relmap.segmentation.Planes`, in the robot frame, and `origin`, the position of the sensor.
    """
    R, t = pose_on_robot(view)
    points_sensor = points_robot.copy()
    points_sensor[:, :2] = (points_robot[:, :2] - t) @ R
    found = segmenter.fit(points_sensor).planes_
    ends = found.ends @ R.T + t
    front = ends[:, 0, 0] * ends[:, 1, 1] > ends[:, 0, 1] * ends[:, 1, 0]
    names = ("end_type", "noise", "n_points", "z_extent")
    columns = {name: getattr(found, name)[front] for name in names}
    return SimpleNamespace(**columns, ends=ends[front], origin=t)


def pose_on_robot(view: SensorView) -> tuple[Floats, Floats]:
    """Return rotation (2, 2) and position (2,), metres, of a sensor on the robot."""
    return rotations(np.array([[view.yaw_rad]]))[0], np.array([view.x_m, view.y_m])


def stamps_of(log: Log) -> Floats:
    """Return the time of each iteration, seconds, or its number if the log has no clock."""
    if log.stamps_s is not None:
        return log.stamps_s
    return np.arange(log.first_iteration, log.first_iteration + len(log), dtype=np.float64)
