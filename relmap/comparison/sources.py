"""Where the data of a comparison come from: a log on disk, or a simulated world."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

import numpy as np

from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog, SensorView, stored_scans
from relmap.datasets.textfile import quoted, require_path, shown
from relmap.evaluation.plane_evaluate import WallTruth
from relmap.evaluation.plane_truth import read_plane_truth
from relmap.evaluation.run import stamps_of
from relmap.evaluation.truth import Truth, read_truth
from relmap.simulation import FigureEight, simulate_building, simulate_figure_eight
from relmap.simulation.noise import Noise


@dataclass(frozen=True, eq=False)
class Landmarks:
    """A landmark log and, where it is known, the truth."""

    log: ObservationLog
    truth: Truth | None


@dataclass(frozen=True, eq=False)
class Scans:
    """A log of point scans and, where it is known, the truth."""

    log: ScanLog
    truth: WallTruth | None


Data = Landmarks | Scans


class Source(Protocol):
    """What can be sent to another process and loaded there."""

    def load(self) -> Data:
        """Return the data."""
        ...

    @property
    def about(self) -> str:
        """What it is, in a few words."""
        ...


@dataclass(frozen=True)
class EightSource:
    """A figure eight; see `relmap.simulation.simulate_figure_eight`."""

    density: float = 25.0
    iterations: int = 900
    noise: str = "gaussian"
    sigma: float = 0.05
    dynamic: float = 0.0
    seed: int = 0

    def load(self) -> Landmarks:
        """Simulate it."""
        noise = cast(Noise, self.noise)
        world = simulate_figure_eight(
            self.density, self.iterations, noise, self.sigma, self.dynamic, self.seed
        )
        return Landmarks(world.log, eight_truth(world))

    @property
    def about(self) -> str:
        """What it is, in a few words."""
        moving = f", {100 * self.dynamic:g} % moving" if self.dynamic else ""
        return (
            f"figure eight, density {self.density:g}, {self.noise} noise {self.sigma:g} m"
            f"{moving}, {self.iterations} iterations, seed {self.seed}"
        )


@dataclass(frozen=True)
class BuildingSource:
    """A building; see `relmap.simulation.simulate_building`."""

    iterations: int | None = None
    noise: str = "gaussian"
    sigma: float = 0.05
    seed: int = 0

    def load(self) -> Scans:
        """Simulate it."""
        noise = cast(Noise, self.noise)
        building = simulate_building(
            sigma=self.sigma, noise=noise, iterations=self.iterations, seed=self.seed
        )
        offsets = np.cumsum([0, *(len(scan.points) for scan in building.scans)])
        points = np.concatenate([scan.points for scan in building.scans])
        truth = WallTruth(
            building.walls[:, :4].reshape(-1, 2, 2),
            building.times_seen()[:, 1:],
            building.stamps_s,
            building.trajectory,
        )
        view = SensorView(building.sensor.view_rad, building.sensor.range_m)
        return Scans(stored_scans(points, offsets, building.stamps_s, sensor=view), truth)

    @property
    def about(self) -> str:
        """What it is, in a few words."""
        return f"building, {self.noise} noise {self.sigma:g} m, seed {self.seed}"


@dataclass(frozen=True)
class FileSource:
    """A log of any known format.

    Attributes
    ----------
    path : Path
        A file or folder.
    format : str or None
        Recognised where it is None.
    scans : tuple of two int, or None
        Which iterations.
    truth : Path or None
        What to compare with; None: a folder ``truth`` beside the log, where there is one.
    """

    path: Path
    format: str | None = None
    scans: tuple[int, int] | None = None
    truth: Path | None = None

    def load(self) -> Data:
        """Read it.

        Raises
        ------
        RelmapError
            Where the log or the truth cannot be used.
        """
        from relmap.datasets import open_log, open_scans

        truth = self.truth or self._beside()
        if self._holds_scans():
            clouds = open_scans(self.path, self.format)
            clouds = clouds.between(*self.scans) if self.scans else clouds
            return Scans(clouds, read_plane_truth(truth) if truth else None)
        log = open_log(self.path, self.format)
        part = log.between(*self.scans) if self.scans else log
        return Landmarks(part, read_truth(truth) if truth else None)

    def _holds_scans(self) -> bool:
        """Tell whether the log is one of point scans."""
        from relmap.datasets import DATASETS, FORMATS, SCAN_DATASETS, SCAN_FORMATS

        if self.format is not None:
            if self.format not in (*FORMATS, *SCAN_FORMATS):
                known = ", ".join((*FORMATS, *SCAN_FORMATS))
                raise RelmapError(f"format {quoted(self.format)} is not known, expected {known}")
            return self.format in SCAN_FORMATS
        require_path(self.path)
        scans = any(dataset.recognises(self.path) for dataset in SCAN_DATASETS)
        landmarks = any(dataset.recognises(self.path) for dataset in DATASETS)
        if not (scans or landmarks) and self.path.is_dir():
            raise RelmapError(
                f"{shown(self.path)}: the folder holds neither a landmark log nor a log of point "
                "scans, expected a format that 'relmap map --help' lists"
            )
        return scans and not landmarks

    def _beside(self) -> Path | None:
        folder = self.path if self.path.is_dir() else self.path.parent
        return folder if (folder / "truth").is_dir() else None

    @property
    def about(self) -> str:
        """What it is, in a few words."""
        part = f", iterations {self.scans[0]}:{self.scans[1]}" if self.scans else ""
        return f"{self.path.name or self.path}{part}"


def eight_truth(world: FigureEight) -> Truth:
    """Return the truth of a simulated figure eight."""
    return Truth(
        world.landmark_ids,
        world.landmarks_map,
        world.status,
        stamps_of(world.log),
        world.trajectory,
    )


def has_ids(data: Data) -> bool:
    """Tell whether a log tells which landmark is which."""
    if isinstance(data, Scans) or data.log.ids is None:
        return False
    return bool(np.any(data.log.ids >= 0))


def require_ids(data: Data) -> None:
    """Make sure that a log tells which landmark is which.

    Raises
    ------
    RelmapError
        Where it does not.
    """
    if isinstance(data, Scans):
        raise RelmapError("--association known is for landmarks: point scans have no ids")
    if not has_ids(data):
        raise RelmapError("--association known needs a log with ids, and this one has none")
