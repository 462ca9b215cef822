"""Readers of logs, one file per format.

Logs of landmarks all give an `ObservationLog`, logs of point scans a `ScanLog`; `open_log` and
`open_scans` recognise the format by its content.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from relmap.core.errors import RelmapError
from relmap.datasets.bag_detections import BagDetections
from relmap.datasets.bag_scans import BagScans
from relmap.datasets.base import Dataset, ObservationLog, Scan
from relmap.datasets.carmen_log import CarmenLog, carmen_logs
from relmap.datasets.clouds import as_laser, without_no_return
from relmap.datasets.depth_images import DepthImages
from relmap.datasets.dlr_circles import DlrCircles
from relmap.datasets.foreign import foreign_at
from relmap.datasets.headers import read_head
from relmap.datasets.kitti_bin import KittiBin
from relmap.datasets.mrclam import Mrclam
from relmap.datasets.mrpt_landmarks import MrptLandmarks
from relmap.datasets.mrpt_laser import MrptLaser
from relmap.datasets.observation_csv import OTHER_NAMES, ObservationCsv, write_observation_csv
from relmap.datasets.odometry import with_odometry_beside
from relmap.datasets.own_table import OwnTable, log_of_frame
from relmap.datasets.point_clouds import PointClouds
from relmap.datasets.scans import PointScan, ScanLog
from relmap.datasets.scans_npz import ScansNpz, write_scans_npz
from relmap.datasets.slsjf import SlsjfSimulation
from relmap.datasets.textfile import invalid, open_text, quoted, require_path, shown
from relmap.datasets.trajectories import Relations, read_relations
from relmap.datasets.tum_rgbd import TumRgbd
from relmap.datasets.victoria_park import VictoriaPark

__all__ = [
    "DATASETS",
    "FORMATS",
    "SCAN_DATASETS",
    "SCAN_FORMATS",
    "Dataset",
    "ObservationLog",
    "PointScan",
    "Relations",
    "Scan",
    "ScanLog",
    "log_of_frame",
    "open_log",
    "open_scans",
    "read_relations",
    "write_observation_csv",
    "write_scans_npz",
]

DATASETS: tuple[Dataset[ObservationLog], ...] = (
    ObservationCsv(),
    MrptLandmarks(),
    VictoriaPark(),
    DlrCircles(),
    SlsjfSimulation(),
    Mrclam(),
    OwnTable(),
    BagDetections(),
)
"""Every format, in the order in which messages list them."""

SCAN_DATASETS: tuple[Dataset[ScanLog], ...] = (
    ScansNpz(),
    CarmenLog(),
    MrptLaser(),
    PointClouds(),
    BagScans(),
    KittiBin(),
    DepthImages(),
    TumRgbd(),
)
"""Every format of point scans, in the same order."""

FORMATS = tuple(dataset.name for dataset in DATASETS)
SCAN_FORMATS = tuple(dataset.name for dataset in SCAN_DATASETS)
"""Kinds of logs."""

Log = TypeVar("Log", ObservationLog, ScanLog)


def open_log(
    path: Path | str,
    format: str | None = None,
    columns: Mapping[str, str] | None = None,
    topics: Sequence[str] = (),
) -> ObservationLog:
    """Read a landmark log of any known format.

    Parameters
    ----------
    path : Path or str
        A file, or a folder that holds a log.
    format : str or None
        One of `FORMATS`; None: recognised by the content.
    columns : mapping of str to str, optional
        Column names, if different, of ``iteration``, ``stamp``, ``x``, ``y``, ``z`` or instead
        ``range``, ``bearing``, ``elevation``, of ``id``, and of the covariances ``cxx`` to ``czz``;
        see `relmap.datasets.own_table`.
    topics : sequence of str
        Topics of a bag to read if there are several of a kind.

    Returns
    -------
    ObservationLog
        With the odometry of the log itself or of ``odometry.csv`` or ``odometry.tum`` beside it.

    Raises
    ------
    RelmapError
        If there is no log of a known format, or it is damaged: file, line, field.
    """
    datasets = DATASETS
    if columns is not None:
        datasets, format = (OwnTable(columns),), OwnTable.name
    return _opened(Path(path), format, datasets, topics)


def open_scans(path: Path | str, format: str | None = None, topics: Sequence[str] = ()) -> ScanLog:
    """Read a log of point scans of any known format.

    Parameters
    ----------
    path, topics
        As for `open_log`.
    format : str or None
        One of `SCAN_FORMATS`; None: recognised by the content.

    Returns
    -------
    ScanLog
        The points of a scan may be read lazily. Odometry as for `open_log`.

    Raises
    ------
    RelmapError
        If there is no log of a known format, or it is damaged: file, line, field.
    """
    log = _opened(Path(path), format, SCAN_DATASETS, topics)
    return without_no_return(Path(path), log) if log.dimension == 3 else log


def _opened(
    path: Path, format: str | None, datasets: tuple[Dataset[Log], ...], topics: Sequence[str]
) -> Log:
    """Read a log with the odometry beside it."""
    dataset = _chosen(path, format, datasets)
    if topics:
        if not isinstance(dataset, BagScans | BagDetections):
            raise invalid(path, f"is not a bag ({dataset.name}), so it has no topics")
        dataset = replace(dataset, topics=tuple(topics))
    log = dataset.load(path)
    if isinstance(log, ScanLog):
        log = as_laser(path, log)
    return with_odometry_beside(log, path)


def _chosen(path: Path, format: str | None, datasets: tuple[Dataset[Log], ...]) -> Dataset[Log]:
    """Return the named format, or the one that recognises the path."""
    names = [dataset.name for dataset in datasets]
    if format is not None and format not in names:
        raise RelmapError(f"format {quoted(format)} is not known, expected {', '.join(names)}")
    require_path(path)
    if format is not None:
        return datasets[names.index(format)]
    found = [dataset for dataset in datasets if dataset.recognises(path)]
    if len(found) == 1:
        return found[0]
    if found:
        candidates = " and ".join(dataset.name for dataset in found)
        raise invalid(path, f"may be {candidates}, expected one: name it with --format")
    known = "; ".join(f"{dataset.name}: {dataset.description}" for dataset in datasets)
    found_instead = _found_instead(path, of_landmarks=datasets is not SCAN_DATASETS)
    raise invalid(path, f"{found_instead}, expected {known}")


def _found_instead(path: Path, of_landmarks: bool) -> str:
    """Describe the content of a path that no format of the wanted kind recognises."""
    what, other, variant = "log of point scans", "landmark log", "points"
    others: tuple[Dataset[Any], ...] = DATASETS
    if of_landmarks:
        what, other, variant, others = other, what, "planes", SCAN_DATASETS
    for dataset in others:
        if dataset.recognises(path):
            found = f"is a {other} ({dataset.name}), expected a {what}"
            raise invalid(path, f"{found}; 'relmap map --variant {variant}' maps these")
    if path.is_dir() and not of_landmarks and (logs := carmen_logs(path)):
        found = f"holds {len(logs)} log{'s' * (len(logs) > 1)} of CARMEN"
        names = ", ".join(shown(file.name) for file in logs)
        raise invalid(path, f"{found}, expected the name of one of them: {names}")
    foreign = foreign_at(path)
    if path.is_dir():
        return f"the folder holds no {what}" + (f" but {foreign}" if foreign else "")
    if foreign:
        return f"is {foreign}, not a {what}"
    with open_text(path) as stream:
        head = read_head(path, stream)
    found = f"line {head.line}: {quoted(','.join(head.columns))} does not start a {what}"
    if of_landmarks and len(head.columns) > 1:
        expected = f"expected iteration,x,y[,z][,id] or, {OTHER_NAMES}"
        raise invalid(path, f"{found}, {expected}; formats: {', '.join(FORMATS)}")
    return found
