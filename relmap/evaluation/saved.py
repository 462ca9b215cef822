"""The result of a mapper without its log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.scan import numbers
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import stored_scans
from relmap.evaluation.feeding import AnyMapper, Association, Log
from relmap.evaluation.run import result_of
from relmap.evaluation.summary import summary_of
from relmap.io.files import staged_folder
from relmap.io.results import MAPPER, Result, write_result
from relmap.planes import PlaneMapper
from relmap.planes.files import PlaneResult, write_planes, write_submaps

OF_THE_LOG = ("observations", "iterations_without_observation")
"""Counts that require the log."""


def result_of_mapper(mapper: AnyMapper, stamps_s: Floats | None = None) -> Result:
    """Return the result of a mapper, without tracks.

    Parameters
    ----------
    mapper : PointMapper or PlaneMapper
    stamps_s : (n_iterations,) float64, optional
        Time of each scan, seconds; by default iteration numbers.

    Returns
    -------
    Result
        For walls a `PlaneResult`.
    """
    walls, n = isinstance(mapper, PlaneMapper), mapper.n_iterations
    none = np.empty(0, dtype=np.int64)
    association: Association = "known" if mapper.engine.association.has_ids else "nearest"
    d = 2 if walls else max(mapper.engine.store.dimension, 2)
    log: Log = ObservationLog(np.empty((0, d)), none, none, 0, n, stamps_s=stamps_s)
    if walls:
        times_s = np.arange(float(n)) if stamps_s is None else stamps_s
        log = stored_scans(np.empty((0, 2)), np.zeros(n + 1, dtype=np.int64), times_s)
    result = result_of(mapper, log, [none] * n, association, 0)
    found = summary_of(mapper, result, log, 0, len(mapper.groups))
    for name in OF_THE_LOG:
        found["counts"].pop(name, None)
    about = {"variant": "planes" if walls else "points", "configuration": mapper.settings}
    more = {"interrupted": False, "refined": len(mapper.refined) > 0}
    return replace(result, summary=about | result.summary | found | more)


def save_results(
    mapper: AnyMapper, folder: Path, pictures: Any, stamps_s: ArrayLike | None = None
) -> None:
    """Write a mapper's result into a folder, with the pictures that `relmap.plots.of_mapper` draws.

    Raises
    ------
    RelmapError
        If the times are invalid, or the folder cannot be written.
    """
    times_s = None if stamps_s is None else _checked(stamps_s, mapper.n_iterations)
    with staged_folder(folder) as staging:
        result = result_of_mapper(mapper, times_s)
        write_result(staging, result)
        if isinstance(result, PlaneResult):
            write_planes(staging, result.planes)
            write_submaps(staging, [(each.stamps_s, each.poses) for each in result.drawn])
        pictures.write_pictures(staging, result, mapper)
        mapper.save(staging / MAPPER)


def _checked(stamps_s: ArrayLike, n: int) -> Floats:
    """Return the times (n,) of n scans.

    Raises
    ------
    RelmapError
        If these are not n finite, ascending numbers.
    """
    wanted = f"{n} ascending times, seconds, one per scan"
    times_s = numbers(stamps_s, "stamps_s", wanted, 0.0)
    if times_s.shape != (n,) or not (np.isfinite(times_s).all() and (np.diff(times_s) > 0).all()):
        raise RelmapError(f"stamps_s of shape {times_s.shape}: expected {wanted}")
    return times_s
