"""Localised scans in an unchanged map."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relmap.evaluation.feeding import AnyMapper
from relmap.planes import PlaneMapper
from relmap.plots.path import broken_at_gaps
from relmap.plots.planes import draw_walls
from relmap.plots.sheet import BLUE, INK, Sheet, to_png


def plot_localised(
    mapper: AnyMapper, scan: NDArray[np.int64], poses: NDArray[np.float64], n_scans: int
) -> Figure:
    """Draw a map and the localised scans; the path is interrupted at scans not found.

    Parameters
    ----------
    mapper : PointMapper or PlaneMapper
    scan : (k,) int64, ascending
        The localised scans of the log.
    poses : (k, 4, 4) float64
        ``T_map_robot`` of these.
    n_scans : int
        Number of scans of the log.

    Returns
    -------
    matplotlib.figure.Figure
    """
    at = poses[:, :3, 3]
    if isinstance(mapper, PlaneMapper):
        table = mapper.planes
        ends = table.ends[table.status == "static"]
        places = np.column_stack([ends.reshape(-1, 2), np.zeros(2 * len(ends))])
        planar, what = True, f"{len(ends)} walls"
    else:
        ends, places = np.empty((0, 2, 2)), mapper.map.positions
        planar, what = mapper.engine.store.dimension == 2, f"{len(places)} landmarks"
    sheet = Sheet(places, at, planar)
    for axes, pair in sheet.views:
        if len(ends):
            draw_walls(axes, ends, colour=INK, width=0.8)
        else:
            axes.plot(*places[:, pair].T, ".", color=INK, markersize=4, label="landmark")
        path = broken_at_gaps(scan.astype(np.float64), at)[:, pair]
        style: dict[str, Any] = {"color": BLUE, "markersize": 2.5, "linewidth": 0.7}
        axes.plot(*path.T, ".-", label="scan that was found", **style)
    sheet.finish(f"{len(scan)} of {n_scans} scans found in a map of {what}")
    return sheet.figure


write_localised_png = to_png(plot_localised)
