"""The picture of mapped walls, over the true ones where they are known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from relmap.planes.table import PlaneTable
from relmap.plots.sheet import Sheet, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from relmap.evaluation.plane_evaluate import MatchedCorners, WallTruth

WALL = "#1f4e9e"
CORNER = "#0b7a3b"
PATH = "#7f7f7f"
TRUE_WALL = "#e0a800"
"""As in the paper: the actual map in yellow, the calculated one in blue (Fig. 7)."""


def write_planes_png(
    path: Path,
    planes: PlaneTable,
    poses: NDArray[np.float64],
    truth: tuple[WallTruth, MatchedCorners] | None = None,
    title: str | None = None,
) -> None:
    """Draw walls into a PNG file; see `plot_planes`.  The same run gives the same bytes.

    Raises
    ------
    RelmapError
        Where the file cannot be written.
    """
    write_png(path, lambda: plot_planes(planes, poses, truth, title))


def plot_planes(
    planes: PlaneTable,
    poses: NDArray[np.float64],
    truth: tuple[WallTruth, MatchedCorners] | None = None,
    title: str | None = None,
) -> Figure:
    """Draw mapped walls, their corners and the path from above.

    Parameters
    ----------
    planes : PlaneTable
    poses : (k, 4, 4) float64
        ``T_map_robot``.
    truth : tuple, optional
        True walls, and how the map lies in them.
    title : str, optional
        The counts where left out.

    Returns
    -------
    matplotlib.figure.Figure
    """
    mapped = planes.status == "static"
    everything = [planes.ends[mapped].reshape(-1, 2), poses[:, :2, 3]]
    true_ends = np.empty((0, 2, 2))
    if truth is not None:
        true_ends = (truth[0].ends - truth[1].t) @ truth[1].R
        everything.append(true_ends.reshape(-1, 2))
    flat = np.concatenate(everything)
    sheet = Sheet(np.column_stack([flat, np.zeros(len(flat))]), planar=True)
    axes = sheet.views[0][0]
    if truth is not None:
        draw_walls(axes, true_ends, TRUE_WALL, 3.0, "true wall")
    draw_walls(axes, planes.ends[mapped], WALL, 1.0, "wall")
    at = planes.ends[mapped][planes.corner[mapped] >= 0]
    axes.plot(*at.T, "o", color=CORNER, markersize=2.2, zorder=6, label="corner", linestyle="")
    axes.plot(*poses[:, :2, 3].T, color=PATH, linewidth=0.8, zorder=2, label="path of the robot")
    sheet.finish(title or f"{mapped.sum()} walls, {len(at)} corners, {len(poses)} poses")
    return sheet.figure


def draw_walls(
    axes: Axes, ends: NDArray[np.float64], colour: str, width: float, label: str
) -> None:
    """Draw walls (m, 2, 2) as lines."""
    from matplotlib.collections import LineCollection

    lines = LineCollection(list(ends), colors=colour, linewidths=width, zorder=5 - width / 3)
    axes.add_collection(lines)
    axes.plot([], [], color=colour, linewidth=width, label=label)
