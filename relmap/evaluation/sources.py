"""Sources of the data of a run: a log on disk, or a simulated world."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from relmap.core.arrays import Ints
from relmap.core.errors import RelmapError
from relmap.datasets import DATASETS, FORMATS, SCAN_DATASETS, SCAN_FORMATS, open_log, open_scans
from relmap.datasets.bag_detections import BagDetections
from relmap.datasets.bag_scans import BagScans
from relmap.datasets.base import ObservationLog
from relmap.datasets.own_table import OwnTable
from relmap.datasets.scans import ScanLog, SensorView
from relmap.datasets.textfile import invalid, quoted, require_path
from relmap.evaluation.feeding import Log, stamps_of
from relmap.evaluation.levelling import shows_floors
from relmap.evaluation.truth import Judged, Truth, Variant, read_truth
from relmap.simulation import Building, FigureEight, World, simulate_building, simulate_figure_eight
from relmap.simulation.noise import Noise

LogKind = Literal["landmarks", "scans", "clouds"]
L = TypeVar("L", bound=Log, covariant=True)


@dataclass(frozen=True, eq=False)
class Data(Generic[L]):
    """A log of landmarks or of point scans and, if known, the truth."""

    log: L
    truth: Truth | None

    @cached_property
    def kind(self) -> LogKind:
        """The kind of log; "clouds" if scans show floors, ceilings or tilted walls."""
        if not isinstance(self.log, ScanLog):
            return "landmarks"
        return "clouds" if shows_floors(self.log) else "scans"

    @property
    def ids(self) -> Ints | None:
        """The landmark of each observation (n,), negative if unknown; None without ids."""
        ids = self.log.ids if isinstance(self.log, ObservationLog) else None
        return None if ids is None or not (ids >= 0).any() else ids


@dataclass(frozen=True)
class EightSource:
    """A figure eight; see `relmap.simulation.simulate_figure_eight`."""

    density: float = 25.0
    iterations: int = 900
    noise: Noise = "gaussian"
    sigma: float = 0.05
    dynamic: float = 0.0
    seed: int = 0

    def load(self) -> Data[ObservationLog]:
        """Simulate it."""
        world = simulate_figure_eight(**vars(self))
        return Data(world.log, truth_of(world))

    @property
    def about(self) -> str:
        """A short description."""
        moving = f", {100 * self.dynamic:g} % moving" if self.dynamic else ""
        return (
            f"figure eight, density {self.density:g}, {self.noise} noise {self.sigma:g} m"
            f"{moving}, {self.iterations} iterations, seed {self.seed}"
        )


@dataclass(frozen=True)
class BuildingSource:
    """A building; see `relmap.simulation.simulate_building`."""

    iterations: int | None = None
    noise: Noise = "gaussian"
    sigma: float = 0.05
    seed: int = 0

    def load(self) -> Data[ScanLog]:
        """Simulate it."""
        building = simulate_building(**vars(self))
        return Data(log_of(building), truth_of(building))

    @property
    def about(self) -> str:
        """A short description."""
        return f"building, {self.noise} noise {self.sigma:g} m, seed {self.seed}"


@dataclass(frozen=True)
class FileSource:
    """A log of any known format.

    `path`: a file or folder. `format`: None to recognise it by content. `scans`: range of
    iterations. `truth`: what to compare with; None: a folder ``truth`` beside the log, if any.
    `topics`: as for `open_log`.
    """

    path: Path
    format: str | None = None
    scans: tuple[int, int] | None = None
    truth: Path | None = None
    columns: Mapping[str, str] | None = None
    topics: Sequence[str] = ()

    def load(self) -> Data[Log]:
        """Read it; RelmapError if the log or the truth is invalid."""
        variant: Variant = "planes" if self._holds_scans() else "points"
        truth, folder = self.truth, self.path if self.path.is_dir() else self.path.parent
        if truth is None and (folder / "truth").is_dir():
            truth = folder
        log = read_log(self.path, variant, self.format, self.scans, self.columns, self.topics)
        data = Data[Log](log, None)
        if truth is None:
            return data
        with silent() if truth.resolve() == self.path.resolve() else nullcontext():
            judged = "planes3d" if data.kind == "clouds" else variant
            return replace(data, truth=read_truth(truth, judged))

    def _holds_scans(self) -> bool:
        """Return whether the log contains point scans."""
        if self.columns is not None:
            return False
        if self.format is not None:
            if self.format not in (*FORMATS, *SCAN_FORMATS):
                known = ", ".join((*FORMATS, *SCAN_FORMATS))
                raise RelmapError(f"format {quoted(self.format)} is not known, expected {known}")
            return self.format in SCAN_FORMATS
        require_path(self.path)
        scans = any(dataset.recognises(self.path) for dataset in SCAN_DATASETS)
        landmarks = any(dataset.recognises(self.path) for dataset in DATASETS)
        if not (scans or landmarks) and self.path.is_dir():
            problem = "the folder holds neither a landmark log nor a log of point scans"
            raise invalid(self.path, f"{problem}, expected a format that 'relmap map --help' lists")
        return scans and not landmarks

    @property
    def about(self) -> str:
        """A short description."""
        part = f", iterations {self.scans[0]}:{self.scans[1]}" if self.scans else ""
        return f"{self.path.name or self.path}{part}"


Source = EightSource | BuildingSource | FileSource
"""Data that can be sent to another process and loaded there."""


@contextmanager
def silent(name: str = "relmap.datasets") -> Iterator[None]:
    """Suppress warnings, as those about data that are read again: they were shown before."""
    log = logging.getLogger(name)
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


def read_log(
    path: Path,
    variant: Judged,
    log_format: str | None = None,
    scans: tuple[int, int] | None = None,
    columns: Mapping[str, str] | None = None,
    topics: Sequence[str] = (),
) -> Log:
    """Read a log for a variant of the mapper.

    `path`: a file or folder; `log_format`: recognised by the content if omitted; `scans`: the
    iterations to read: the first, and one after the last; `columns`, `topics`: as for
    `relmap.datasets.open_log`. Raises `RelmapError` if there is no such log, it is damaged, or
    its scans are of a 2-D laser and the variant needs clouds.
    """
    whole: Log
    if variant != "points":
        whole = open_scans(path, log_format, topics)
        if variant == "planes3d" and whole.dimension != 3:
            raise RelmapError(
                f"{path}: is from a 2-D laser, and planes3d maps clouds: use --variant planes"
            )
    else:
        whole = open_log(path, log_format, columns, topics)
    return whole if scans is None else whole.between(*scans)


def read_again(path: Path, variant: Variant, summary: Mapping[str, Any]) -> Log:
    """Read a log as the run of a result read it.

    Format, columns and topics are those of its summary; the format only if none is recognised, or
    columns were given. Raises `RelmapError` if there is no such log or it is damaged.
    """
    form, columns, topics = (summary.get(key) for key in ("format", "columns", "topics"))
    known = recognised_format(path, variant)
    own = form == OwnTable.name or known in (None, OwnTable.name)
    if variant == "points" and own and isinstance(columns, dict):
        names = {ours: str(theirs) for ours, theirs in columns.items()}
        return read_log(path, variant, columns=names)
    form = known or (form if isinstance(form, str) else None)
    of_bag = form in (BagScans.name, BagDetections.name) and isinstance(topics, list)
    return read_log(path, variant, form, topics=list(map(str, topics or ())) if of_bag else ())


def recognised_format(path: Path, variant: Judged) -> str | None:
    """Return the recognised format of a log; None if it is not recognised."""
    known = DATASETS if variant == "points" else SCAN_DATASETS
    names = [dataset.name for dataset in known if dataset.recognises(path)]
    return names[0] if len(names) == 1 else None


def log_of(building: Building) -> ScanLog:
    """Return the scans of a simulated building, of a laser in the plane, with the true poses."""
    scans, sensor = building.scans, building.sensor
    d = 3 if scans[0].ranges_m is None else 2
    view = SensorView(sensor.view_rad, sensor.range_m)
    points = [scan.points[:, :d] for scan in scans]
    return ScanLog(d, building.stamps_s, points.__getitem__, building.trajectory, sensor=view)


def truth_of(world: FigureEight | World | Building) -> Truth:
    """Return the truth of a simulated world.

    Parameters
    ----------
    world : FigureEight, World or Building

    Returns
    -------
    Truth
    """
    if isinstance(world, FigureEight | World):
        places, status, stamps_s = world.landmarks_map, world.status, stamps_of(world.log)
        return Truth(world.landmark_ids, places, status, stamps_s, world.trajectory)
    still = ~world.moving
    return Truth(
        stamps_s=world.stamps_s,
        poses=world.trajectory,
        ends=world.walls[still, :4].reshape(-1, 2, 2),
        corner_scans=world.times_seen()[still, 1:],
        seen_m=world.seen_extents()[still],
    )
