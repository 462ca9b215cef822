"""The picture of a simulated building: its walls, the way through it, and what one scan saw."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from relmap.plots.sheet import BLUE, INK, RED, Sheet, to_png
from relmap.simulation import Building


def plot_building(building: Building) -> Figure:
    """Draw the walls and the path from above, with the points of the first scan.

    Parameters
    ----------
    building : Building

    Returns
    -------
    matplotlib.figure.Figure
    """
    ends_map = building.walls[:, :4].reshape(-1, 2)
    way = building.trajectory[:, :3, 3]
    T_map_robot = building.trajectory[0]
    seen = building.scans[0].points @ T_map_robot[:3, :3].T + T_map_robot[:3, 3]
    flat = np.column_stack([ends_map, np.zeros(len(ends_map))])
    sheet = Sheet(flat, way, planar=True)
    axes = sheet.views[0][0]
    axes.add_collection(LineCollection(list(ends_map.reshape(-1, 2, 2)), colors=INK, zorder=3))
    axes.plot([], [], color=INK, label="wall")
    axes.plot(*way[:, :2].T, color=BLUE, linewidth=1.2, zorder=4, label="path of the robot")
    axes.plot(*way[0, :2], "o", color=BLUE, markersize=5, zorder=5, label="start", linestyle="")
    axes.plot(*seen[:, :2].T, ".", color=RED, markersize=0.8, zorder=2, label="first scan")
    walls, scans = len(building.walls), len(building.scans)
    sheet.finish(f"{walls} sides of walls, {scans} scans")
    return sheet.figure


write_building_png = to_png(plot_building)
