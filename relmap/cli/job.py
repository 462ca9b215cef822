"""The job of `relmap map`, also stored in a journal for `relmap resume`."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from relmap.cli.arguments import Association, Interval, Level, Odometry, Variant
from relmap.core.config import MapperConfig
from relmap.core.errors import RelmapError
from relmap.evaluation.feeding import AnyMapper, Log
from relmap.io.journal import JournalReader
from relmap.io.results import MAPPER
from relmap.planes import PlaneMapper
from relmap.planes3d import Plane3dMapper
from relmap.points import PointMapper
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
            **dict(zip(sigmas, self.sigmas or (), strict=False)),
            "--onto": self.onto and self.onto.name,
        }
        words = ["relmap", "map", self.source.name, "-o", "RESULT"]
        for name, value in options.items():
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
        """Return the location of a path of the job."""
        return self.folder / path if self.resumed else path

    def mapper(self, after: Callable[[Any], object] | None = None) -> AnyMapper:
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
