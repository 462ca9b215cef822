"""Pictures and result folder of a mapper of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from relmap.core.arrays import Ints
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import AnyMapper, Association, Log
from relmap.evaluation.run import result_of, write_tables
from relmap.evaluation.summary import is_refined, summary_of
from relmap.io.files import atomic_write, staged_folder
from relmap.io.results import MAP_PNG, MAPPER, REPORT, Result, stale_files
from relmap.planes import PlaneMapper
from relmap.planes.walls.files import PlaneResult
from relmap.planes3d import Plane3dMapper
from relmap.planes3d.files import Plane3dResult
from relmap.plots.planes import plot_planes, plot_planes3d, plot_submaps
from relmap.plots.report import report_page
from relmap.plots.run import plot_run
from relmap.plots.sheet import write_png


def plot_mapper(mapper: AnyMapper) -> Figure:
    """Draw the map of a mapper: landmarks; of walls each submap in a panel; planes in space."""
    return plot_result(result_of_mapper(mapper), groups_of(mapper))


def save_results(mapper: AnyMapper, folder: Path) -> None:
    """Write a mapper's result into a folder; RelmapError if the folder cannot be written."""
    with staged_folder(folder, stale_files(folder)) as staging:
        result = result_of_mapper(mapper)
        write_tables(staging, result)
        command = f"{type(mapper).__name__}.save_results"
        write_pictures(staging, result, groups_of(mapper), command, "a run")
        mapper.save(staging / MAPPER)


def result_of_mapper(mapper: AnyMapper) -> Result:
    """Return the result of a mapper, of the class for its kind of landmarks, without tracks."""
    walls, n = isinstance(mapper, PlaneMapper), mapper.n_iterations
    none = np.empty(0, dtype=np.int64)
    times_s = mapper.stamps_s
    if np.isnan(times_s).any():
        times_s = np.arange(float(n))
    log: Log = ScanLog(2, times_s, lambda _: np.empty((0, 2)))
    if isinstance(mapper, Plane3dMapper):
        result = result_of(mapper, log, [none] * n, "nearest", 0)
        variant, found = "planes3d", result.summary
    else:
        variant = "planes" if walls else "points"
        association: Association = "known" if mapper.engine.association.has_ids else "nearest"
        if not walls:
            points = np.empty((0, max(mapper.engine.store.dimension, 2)))
            log = ObservationLog(points, none, none, 0, n, stamps_s=times_s)
        result = result_of(mapper, log, [none] * n, association, 0)
        found = result.summary | summary_of(mapper, result, log, 0, len(mapper.groups))
    for name in ("observations", "iterations_without_observation"):  # the log is not known
        found["counts"].pop(name, None)
    about = {"variant": variant, "configuration": mapper.settings}
    more = {"interrupted": False, "refined": is_refined(mapper)}
    return replace(result, summary=about | found | more)


def groups_of(mapper: AnyMapper) -> list[Ints]:
    """Return the labels of the landmarks of each group, if a mapper has groups."""
    groups = [] if isinstance(mapper, Plane3dMapper) else mapper.groups
    return [group.landmarks for group in groups]


def write_pictures(
    folder: Path, result: Result, groups: Sequence[Ints], command: str, name: str
) -> None:
    """Write ``map.png`` and ``report.html``, see `plot_run` and `report_page`, into a folder."""
    write_png(folder / MAP_PNG, plot_result, result, groups)
    atomic_write(folder / REPORT, report_page(result, command, name))


def plot_result(result: Result, groups: Sequence[Ints] = ()) -> Figure:
    """Draw the map of a result; `groups` as for `write_pictures`."""
    if isinstance(result, Plane3dResult):
        path = result.poses, result.stamps_s, result.weak
        return plot_planes3d(result.planes, *path, len(result.parts))
    if isinstance(result, PlaneResult):
        if not result.drawn:
            return plot_planes(result.planes, result.poses)
        return plot_submaps(result.drawn, len(result.summary["submaps"]))
    return plot_run(result, groups)
