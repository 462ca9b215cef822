"""Where scans were found in a map that stays as it is."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relmap.core.landmarks import LandmarkMap
from relmap.plots.path import broken_at_gaps
from relmap.plots.sheet import BLUE, INK, Sheet, to_png


def plot_localised(
    landmarks: LandmarkMap,
    planar: bool,
    scan: NDArray[np.int64],
    poses: NDArray[np.float64],
    n_scans: int,
) -> Figure:
    """Draw a map and where scans were found in it; what is between scans not found is not drawn.

    Parameters
    ----------
    landmarks : LandmarkMap
    planar : bool
        Whether the view from above is enough.
    scan : (k,) int64, ascending
        Which scans of the log were found.
    poses : (k, 4, 4) float64
        ``T_map_robot`` of these.
    n_scans : int
        How many scans the log has.

    Returns
    -------
    matplotlib.figure.Figure
    """
    at = poses[:, :3, 3]
    sheet = Sheet(landmarks.positions, at, planar)
    for axes, pair in sheet.views:
        axes.plot(*landmarks.positions[:, pair].T, ".", color=INK, markersize=4, label="landmark")
        path = broken_at_gaps(scan.astype(np.float64), at)[:, pair]
        style: dict[str, Any] = {"color": BLUE, "markersize": 2.5, "linewidth": 0.7}
        axes.plot(*path.T, ".-", label="scan that was found", **style)
    sheet.finish(f"{len(scan)} of {n_scans} scans found in a map of {len(landmarks)} landmarks")
    return sheet.figure


write_localised_png = to_png(plot_localised)
