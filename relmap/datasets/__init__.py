"""Readers of landmark logs: one file per format, all giving an `ObservationLog`.

`open_log` recognises the format by its content.
"""

from __future__ import annotations

from pathlib import Path

from relmap.core.errors import RelmapError
from relmap.datasets.base import LandmarkDataset, ObservationLog, Scan
from relmap.datasets.dlr_circles import DlrCircles
from relmap.datasets.mrpt_landmarks import MrptLandmarks
from relmap.datasets.observation_csv import ObservationCsv, write_observation_csv
from relmap.datasets.slsjf import SlsjfSimulation
from relmap.datasets.textfile import open_text, quoted, read_head, require_path, shown
from relmap.datasets.victoria_park import VictoriaPark

__all__ = [
    "DATASETS",
    "FORMATS",
    "LandmarkDataset",
    "ObservationLog",
    "Scan",
    "open_log",
    "write_observation_csv",
]

DATASETS: tuple[LandmarkDataset, ...] = (
    ObservationCsv(),
    MrptLandmarks(),
    VictoriaPark(),
    DlrCircles(),
    SlsjfSimulation(),
)
"""Every format, in the order in which messages list them."""

FORMATS: tuple[str, ...] = tuple(dataset.name for dataset in DATASETS)
"""Names that ``--format`` takes."""


def open_log(path: Path | str, format: str | None = None) -> ObservationLog:
    """Read a landmark log of any known format.

    Parameters
    ----------
    path : Path or str
        A file, or a folder that holds a log.
    format : str or None
        One of `FORMATS`; None: recognised by the content.

    Raises
    ------
    RelmapError
        Where there is no log of a known format, or it is damaged: file, line, field.
    """
    path = Path(path)
    if format is not None and format not in FORMATS:
        raise RelmapError(f"format {quoted(format)} is not known, expected {', '.join(FORMATS)}")
    require_path(path)
    if format is not None:
        return DATASETS[FORMATS.index(format)].load(path)
    return _recognise(path).load(path)


def _recognise(path: Path) -> LandmarkDataset:
    """Return the one format that recognises the path."""
    found = [dataset for dataset in DATASETS if dataset.recognises(path)]
    if len(found) == 1:
        return found[0]
    if found:
        names = " and ".join(dataset.name for dataset in found)
        raise RelmapError(f"{shown(path)}: may be {names}, expected one: name it with --format")
    known = "; ".join(f"{dataset.name}: {dataset.description}" for dataset in DATASETS)
    if path.is_dir():
        raise RelmapError(f"{shown(path)}: the folder holds no landmark log, expected {known}")
    with open_text(path) as stream:
        head = read_head(path, stream)
    first = quoted(",".join(head.columns))
    raise RelmapError(
        f"{shown(path)}: line {head.line}: {first} begins no landmark log, expected {known}"
    )
