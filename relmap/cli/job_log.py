"""The log of a job: read, levelled, without repeated points, with the noise of the sensor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import typer

from relmap.cli.console import busy
from relmap.cli.job import Job
from relmap.core.errors import RelmapError
from relmap.core.sensor import range_bearing_covariances
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog
from relmap.datasets.textfile import invalid
from relmap.evaluation.feeding import Log
from relmap.evaluation.levelling import levelled, shows_floors
from relmap.evaluation.sources import read_log
from relmap.io.results import MAPPER, NAMES, read_names
from relmap.segmentation.segmenter import SPATIAL

NEAR_M, FAR_M = 0.1, 100.0
"""Half of the points of a scan are farther than the first and nearer than the second, as those of
2-D lasers and most of a lidar are: other coordinates are hardly metres."""


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
        typer.echo(f"relmap: {source}: mapped without odometry: {log.no_odometry}", err=True)
    if job.variant == "planes3d" and job.odometry == "auto" and log.odometry is not None:
        typer.echo(f"relmap: {source}: planes3d does not use the odometry of the log", err=True)
    doubt_unit(source, log)
    log = _level(job, log) if job.association == "known" else _each_once(job, _level(job, log))
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
    """Warn of point scans that are hardly in metres: the map would be as good, in their unit."""
    if not isinstance(log, ScanLog):
        return
    scans = (scan.points_robot for scan in log.scans() if len(scan.points_robot))
    middle_m = float(np.median(np.linalg.norm(next(scans, np.ones((1, 3))), axis=1)))
    if not NEAR_M < middle_m < FAR_M:
        typer.echo(
            f"relmap: {source}: the points of the first scan are {middle_m:.3g} m away in the "
            "median: coordinates must be in metres",
            err=True,
        )


def _level(job: Job, log: Log) -> Log:
    """Return a log levelled if requested and needed."""
    if job.level == "none" or job.segmenter in SPATIAL:
        return log
    return level_if_needed(job.source, log)


def level_if_needed(source: Path, log: Log) -> Log:
    """Return a log, clouds that show floors levelled; this is reported on the standard error."""
    if not isinstance(log, ScanLog) or not shows_floors(log):
        return log
    message = "clouds are levelled by their floor and walls, and reduced to 2-D scans of the walls"
    typer.echo(f"relmap: {source}: {message}", err=True)
    return levelled(log)


def _each_once(job: Job, log: Log) -> Log:
    if not isinstance(log, ObservationLog):
        return log
    once = log.each_once()
    n_again = len(log.rows) - len(once.rows)
    if n_again:
        message = f"{n_again} points left out that repeat another one of their scan exactly"
        typer.echo(f"relmap: {job.source}: {message}", err=True)
    return once
