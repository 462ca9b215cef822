"""The result of a mapper without its log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import stored_scans
from relmap.evaluation.feeding import AnyMapper, Association, Log
from relmap.evaluation.run import result_of
from relmap.evaluation.space_run import VARIANT, result_in_space
from relmap.evaluation.summary import is_refined, summary_of
from relmap.io.results import Result, write_result
from relmap.planes import PlaneMapper
from relmap.planes.walls.files import PlaneResult, write_planes, write_submaps
from relmap.planes3d import Plane3dMapper
from relmap.planes3d.files import Plane3dResult, write_parts

OF_THE_LOG = ("observations", "iterations_without_observation")
"""Counts that require the log."""


def result_of_mapper(mapper: AnyMapper) -> Result:
    """Return the result of a mapper, without tracks.

    For walls it is a `PlaneResult`, for planes in space a `Plane3dResult`.
    """
    walls, n = isinstance(mapper, PlaneMapper), mapper.n_iterations
    none = np.empty(0, dtype=np.int64)
    times_s = mapper.stamps_s
    if np.isnan(times_s).any():
        times_s = np.arange(float(n))
    log: Log = stored_scans(np.empty((0, 2)), np.zeros(n + 1, dtype=np.int64), times_s)
    if isinstance(mapper, Plane3dMapper):
        result: Result = result_in_space(mapper, log, [none] * n)
        variant, found = VARIANT, result.summary
    else:
        variant = "planes" if walls else "points"
        association: Association = "known" if mapper.engine.association.has_ids else "nearest"
        if not walls:
            points = np.empty((0, max(mapper.engine.store.dimension, 2)))
            log = ObservationLog(points, none, none, 0, n, stamps_s=times_s)
        result = result_of(mapper, log, [none] * n, association, 0)
        found = result.summary | summary_of(mapper, result, log, 0, len(mapper.groups))
    for name in OF_THE_LOG:
        found["counts"].pop(name, None)
    about = {"variant": variant, "configuration": mapper.settings}
    more = {"interrupted": False, "refined": is_refined(mapper)}
    return replace(result, summary=about | found | more)


def write_tables(folder: Path, result: Result) -> None:
    """Write the files of a result, except the pictures, into an existing folder.

    Raises `RelmapError` if a file cannot be written.
    """
    write_result(folder, result)
    if isinstance(result, Plane3dResult):
        write_parts(folder, result)
    elif isinstance(result, PlaneResult):
        write_planes(folder, result.planes)
        write_submaps(folder, result.drawn)
