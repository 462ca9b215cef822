"""The job of `relmap map`, also stored in a journal for `relmap resume`, and its log."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import typer
from numpy.typing import NDArray

from relmap.cli.arguments import Association, Interval, Level, Odometry, Variant
from relmap.cli.console import busy
from relmap.core.config import MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.sensor import range_bearing_covariances
from relmap.datasets.base import ObservationLog
from relmap.datasets.copies import copies, without_copies
from relmap.datasets.scans import ScanLog
from relmap.datasets.textfile import invalid
from relmap.evaluation.feeding import AnyMapper, Log
from relmap.evaluation.levelling import levelled, shows_floors
from relmap.evaluation.sources import read_log
from relmap.io.journal import JournalReader
from relmap.io.results import MAPPER, NAMES, read_names
from relmap.planes import PlaneMapper
from relmap.planes3d import Plane3dMapper
from relmap.points import PointMapper
from relmap.segmentation.segmenter import SPATIAL
from relmap.segmentation.space import PatchSegmenter

T = TypeVar("T")
MAPPERS: dict[str, type[AnyMapper]] = {
    "points": PointMapper,
    "planes": PlaneMapper,
    "planes3d": Plane3dMapper,
}
"""The mapper of each variant."""
NOTED = {
    **{name: name for name in ("folder", "out", "association", "refine", "animate", "sigmas")},
    **{name: name for name in ("odometry", "level", "segmenter", "columns", "topics")},
    **{"input": "source", "scans": "interval", "format": "log_format", "voxel": "voxel_m"},
}
"""The keys of what is stored in a journal, and the names of the fields."""
NEAR_M, FAR_M = 0.1, 100.0
"""Half of the points of a scan are farther than the first and nearer than the second, as those of
2-D lasers and most of a lidar are: other coordinates are hardly metres."""
FAR_LANDMARKS_M = 1000.0
"""Half of the landmarks of a scan are nearer."""
AT_ORIGIN = 3
"""Minimum number of points at the origin that stand for no detection: a robot may start there."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """A log to be mapped into a folder: the arguments of the command line, and more.

    `settings`: those of points and walls; `voxel_m`: that of planes in space; `folder`: to which
    other paths are relative; `resumed`: whether to continue an existing journal; `sigmas`: noise of
    range, metres, bearing and elevation, radians; those of the log if None; `live`, `live_file`:
    whether to show the run live, and the file to record it in instead, if any; `stopped`: returns
    whether to stop before the end of the log.
    """

    source: Path
    out: Path
    settings: MapperConfig | None = None
    variant: Variant = "points"
    association: Association = "nearest"
    interval: Interval | None = None
    log_format: str | None = None
    refine: bool = True
    journal: Path | None = None
    folder: Path = field(default_factory=Path.cwd)
    resumed: bool = False
    onto: Path | None = None
    animate: bool = False
    sigmas: tuple[float, ...] | None = None
    odometry: Odometry = "none"
    level: Level = "none"
    segmenter: str | None = None
    voxel_m: float | None = None
    columns: dict[str, str] | None = None
    topics: tuple[str, ...] = ()
    live: bool = False
    live_file: Path | None = None
    stopped: Callable[[], bool] = lambda: False

    @property
    def noted(self) -> dict[str, Any]:
        """The part stored in a journal."""
        values = {key: getattr(self, name) for key, name in NOTED.items()}
        return {key: str(v) if isinstance(v, Path) else v for key, v in values.items()}

    @property
    def command(self) -> str:
        """The part needed to map the log again, without folders and settings."""
        sigmas = ("--range-sigma", "--bearing-sigma", "--elevation-sigma")
        options = {
            "--variant": None if self.variant == "points" else self.variant,
            "--segmenter": self.segmenter,
            "--voxel": self.voxel_m,
            "--association": None if self.association == "nearest" else self.association,
            "--scans": self.interval and "{}:{}".format(*self.interval),
            "--format": self.log_format,
            "--columns": self.columns and ",".join(map("=".join, self.columns.items())),
            "--odometry": None if self.odometry == "auto" else self.odometry,
            "--level": "none" if (self.variant, self.level) == ("planes", "none") else None,
            **dict(zip(sigmas, self.sigmas or (), strict=False)),
            "--onto": self.onto and self.onto.name,
        }
        words = ["relmap", "map", self.source.name, "-o", "RESULT"]
        for name, value in [*options.items(), *(("--topic", topic) for topic in self.topics)]:
            words += [] if value is None else [name, str(value)]
        return shlex.join(words if self.refine else [*words, "--no-refine"])

    @classmethod
    def of_journal(cls, path: Path, meta: dict[str, Any]) -> Job:
        """Return the job stored in a journal; RelmapError if it was written by another program."""
        run = meta.get("run")
        if run is None:
            raise RelmapError(
                f"journal {path} was not written by relmap map and does not name its log; "
                f"continue it with {MAPPERS[meta['variant']].__name__}.resume"
            )
        try:
            given = {name: run[key] for key, name in NOTED.items() if key in run}
            given |= {name: Path(given[name]) for name in ("folder", "source", "out")}
            given["interval"] = given["interval"] and Interval(*map(int, given["interval"]))
            given["sigmas"] = tuple(map(float, given.get("sigmas") or ())) or None
            given["topics"] = tuple(map(str, given.get("topics") or ()))
            return cls(**given, variant=meta["variant"], journal=path.absolute(), resumed=True)
        except (LookupError, TypeError, ValueError) as error:
            raise RelmapError(f"journal {path}: its run cannot be read: {error!r}") from error

    def at(self, path: Path) -> Path:
        """Return a path of the job as seen from the current folder."""
        return self.folder / path if self.resumed and self.folder != Path.cwd() else path

    def mapper(self, after: Callable[[Any], object] | None) -> AnyMapper:
        """Return the mapper to start or to continue with; `after` as for `Mapper.resume`."""
        kind = MAPPERS[self.variant]
        if self.resumed and self.journal is not None:
            return kind.resume(self.journal, after)
        if self.onto is not None:
            return kind.load(self.onto / MAPPER)
        given: Any = self.settings
        if self.variant == "planes3d":
            given = PatchSegmenter(voxel_m=self.voxel_m)
        return kind(given, journal=self.journal, run=self.noted)

    def scans(self, scans: Iterable[T]) -> Iterator[T]:
        """Yield scans until stopped."""
        for scan in scans:
            yield scan
            if self.stopped():
                return


def journaled_labels(job: Job, log: Log) -> list[NDArray[Any]]:
    """Return the labels (n,) of each scan in the journal of a resumed job.

    Raises `RelmapError` if the journal is damaged or the log is not the one it was started with.
    """
    if not job.resumed or job.journal is None:
        return []
    labels, now = [], iter(log.scans())
    with JournalReader(job.journal) as reader:
        for k, was in enumerate(reader.scans()):
            # Otherwise the journal contains the planes of the scans, not their points.
            if job.variant == "points" and not _is_same(was, next(now, None)):
                raise RelmapError(
                    f"{job.source} is not the log of journal {job.journal}: scan {k} differs"
                )
            labels.append(was.labels)
    if len(labels) > len(log):
        raise RelmapError(
            f"{job.at(job.source)} has {len(log)} scans, fewer than journal {job.journal}"
        )
    return labels


def _is_same(was: Any, scan: Any) -> bool:
    if scan is None or not np.array_equal(was.values.ravel(), scan.points_robot.ravel()):
        return False
    return was.ids is None or np.array_equal(was.ids, scan.ids)


def log_of(job: Job) -> Log:
    """Return the log as it is mapped, and report on the standard error what was changed.

    Raises `RelmapError` if it cannot be read, or lacks what the job needs.
    """
    source = job.at(job.source)
    with busy("reading"):
        log = read_log(source, job.variant, job.log_format, job.interval, job.columns, job.topics)
    ids = getattr(log, "ids", None)
    if job.association == "known" and (ids is None or not (ids >= 0).any()):
        raise RelmapError(f"--association known needs ids, and {source} has none")
    if job.onto is not None and job.association == "known" and isinstance(log, ObservationLog):
        log = _named_as_in_map(job.source, log, job.onto)
    if job.odometry == "auto" and log.odometry is None and log.no_odometry:
        _tell(source, f"mapped without odometry: {log.no_odometry}")
    if job.variant == "planes3d" and job.odometry == "auto" and log.odometry is not None:
        _tell(source, "planes3d does not use the odometry of the log")
    doubt_unit(source, log)
    if job.odometry == "auto" and isinstance(log, ObservationLog):
        log = without_copies(log)
    doubt_repeats(source, log)
    log = _without_faults(job, log)
    if job.level != "none" and job.segmenter not in SPATIAL:
        log = level_if_needed(job.source, log)
    if job.sigmas is None:
        return log
    assert isinstance(log, ObservationLog)
    if len(job.sigmas) > log.points_robot.shape[1]:
        raise RelmapError("--elevation-sigma is for logs in space, and this one is planar")
    return replace(log, covariances=range_bearing_covariances(log.points_robot, *job.sigmas))


def _named_as_in_map(source: Path, log: ObservationLog, onto: Path) -> ObservationLog:
    """Return a log whose text ids have the numbers that a map has for them, new ones behind."""
    new, known = log.names, read_names(onto)
    if new is None and known is not None:
        raise RelmapError(f"the ids of {source} are numbers, those of the map {onto} texts")
    if new is not None and known is None and (onto / MAPPER).is_file():
        raise RelmapError(f"the ids of {source} are texts, and the map {onto} has no {NAMES}")
    if new is None or known is None or log.ids is None:
        return log
    if sorted(known) != list(range(len(known))):
        raise invalid(onto / NAMES, "the landmarks are not numbered from 0, each once")
    names = tuple(dict.fromkeys((*(known[k] for k in range(len(known))), *new)))
    number = {name: k for k, name in enumerate(names)}
    numbers = np.array([*map(number.__getitem__, new), -1])
    return replace(log, ids=numbers[np.maximum(log.ids, -1)], names=names)


def doubt_unit(source: Path, log: Log) -> None:
    """Warn of scans that are hardly in metres: the map would be as good, in their unit."""
    scans = (scan.points_robot for scan in log.scans() if len(scan.points_robot))
    middle_m = float(np.median(np.linalg.norm(next(scans, np.ones((1, 3))), axis=1)))
    near_m, far_m = (NEAR_M, FAR_M) if isinstance(log, ScanLog) else (0.0, FAR_LANDMARKS_M)
    if not near_m <= middle_m < far_m:
        found = (
            f"the points of the first scan are {float(f'{middle_m:.3g}'):g} m away in the median"
        )
        _tell(source, f"{found}: coordinates must be in metres, in the frame of the robot")


def doubt_repeats(source: Path, log: Log) -> None:
    """Warn of scans that repeat the one before: their noise is not independent, as is assumed.

    Not of clouds, which are read from their files one by one.
    """
    if isinstance(log, ScanLog) and log.dimension == 3:
        return
    n = int(copies(log).sum())
    if n:
        which = "1 scan repeats" if n == 1 else f"{n} scans repeat"
        advice = "copies are not new measurements, leave them out"
        _tell(source, f"{which} the one before exactly: {advice}")


def require_dimension(source: Path | str, log: Log, mapper: AnyMapper, result: Path | str) -> None:
    """Raise a `RelmapError` if landmarks are in space and a map is planar, or the reverse."""
    if not isinstance(mapper, PointMapper) or not isinstance(log, ObservationLog):
        return
    kind = {2: "planar", 3: "in space"}
    seen, mapped = log.points_robot.shape[1], mapper.engine.store.dimension
    if seen != mapped in kind:
        raise RelmapError(f"the log {source} is {kind[seen]}, the map {result} {kind[mapped]}")


def level_if_needed(source: Path, log: Log) -> Log:
    """Return a log, clouds that show floors levelled; this is reported on the standard error."""
    if not isinstance(log, ScanLog) or not shows_floors(log):
        return log
    how = "levelled by their floor and walls, and reduced to 2-D scans of the walls"
    _tell(source, f"clouds are {how}")
    return levelled(log)


def _without_faults(job: Job, log: Log) -> Log:
    """Return a log of landmarks without points that stand for no detection, or repeat another."""
    if not isinstance(log, ObservationLog):
        return log
    there = np.asarray(log.points_robot.any(axis=1))
    n_at_origin = int((~there).sum())
    if n_at_origin >= AT_ORIGIN:
        _tell(job.source, f"{n_at_origin} points of range 0 left out: no detection")
        log = log.only(there)
    once = log.each_once() if job.association == "nearest" else log
    n_again = len(log.rows) - len(once.rows)
    if n_again:
        _tell(
            job.source, f"{n_again} points left out that repeat another one of their scan exactly"
        )
    return once


def _tell(source: Path, message: str) -> None:
    """Report on the standard error that something of a log was changed, or is doubtful."""
    typer.echo(f"relmap: {source}: {message}", err=True)
