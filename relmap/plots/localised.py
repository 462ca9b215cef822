"""Localised scans in an unchanged map."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import LandmarkMap
from relmap.plots.path import broken_at_gaps
from relmap.plots.planes import draw_walls
from relmap.plots.sheet import BLUE, INK, Sheet, to_png


def plot_localised(
    landmarks: LandmarkMap,
    planar: bool,
    scan: Ints,
    poses: Floats,
    n_scans: int,
    ends: Floats | None = None,
) -> Figure:
    """Draw a map and the localised scans; the path is interrupted at scans not found.

    `planar`: whether the view from above suffices; `scan` (k,), ascending: the localised scans of
    the log; `poses` (k, 4, 4): ``T_map_robot`` of these; `n_scans`: number of scans of the log;
    `ends` (w, 2, 2): walls of the map, drawn instead of the landmarks.
    """
    at, places, what = poses[:, :3, 3], landmarks.positions, f"{len(landmarks)} landmarks"
    if ends is not None:
        places, what = np.zeros((2 * len(ends), 3)), f"{len(ends)} walls"
        places[:, :2] = ends.reshape(-1, 2)
    sheet = Sheet(places, at, planar)
    for axes, pair in sheet.views:
        if ends is not None:
            draw_walls(axes, ends, colour=INK, width=0.8)
        else:
            axes.plot(*places[:, pair].T, ".", color=INK, markersize=4, label="landmark")
        path = broken_at_gaps(scan.astype(np.float64), at)[:, pair]
        style: dict[str, Any] = {"color": BLUE, "markersize": 2.5, "linewidth": 0.7}
        axes.plot(*path.T, ".-", label="localised scan", **style)
    sheet.finish(f"{len(scan)} of {n_scans} scans localised in a map of {what}")
    return sheet.figure


write_localised_png = to_png(plot_localised)
