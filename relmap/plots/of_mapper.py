"""Pictures of a mapper without its log."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from relmap.evaluation.feeding import AnyMapper
from relmap.evaluation.saved import result_of_mapper
from relmap.io.files import atomic_write
from relmap.io.results import MAP_PNG, Result
from relmap.planes.walls.files import PlaneResult
from relmap.plots.planes import plot_planes, plot_submaps
from relmap.plots.report import REPORT, report_page
from relmap.plots.run import plot_run
from relmap.plots.sheet import write_png


def plot_mapper(mapper: AnyMapper) -> Figure:
    """Draw the map of a mapper: for points the landmarks, for walls each submap in a panel."""
    return _drawn(result_of_mapper(mapper), mapper)


def write_pictures(folder: Path, result: Result, mapper: AnyMapper) -> None:
    """Write ``map.png`` and ``report.html`` of a result without a log into a folder."""
    write_png(folder / MAP_PNG, lambda: _drawn(result, mapper))
    command = f"{type(mapper).__name__}.save_results"
    atomic_write(folder / REPORT, report_page(result, command, "a run"))


def _drawn(result: Result, mapper: AnyMapper) -> Figure:
    if isinstance(result, PlaneResult):
        if not result.drawn:
            return plot_planes(result.planes, result.poses)
        return plot_submaps(result.drawn, len(result.summary["submaps"]))
    return plot_run(result, [group.landmarks for group in mapper.groups])
