"""The picture of a map of planes in space: in perspective and from above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from relmap.core.arrays import Floats, Ints
from relmap.planes3d.files import COLOURS
from relmap.planes3d.table import Plane3dTable
from relmap.plots.path import broken_at_gaps
from relmap.plots.sheet import BLUE, RED, blank, draw_limits, finish, legend_below, limits_of

LIGHT = np.array([0.3, 0.5, 0.81])
"""Direction of a light: planes facing it are brighter."""


def plot_planes3d(table: Plane3dTable, poses: Floats, stamps_s: Floats, weak: Ints) -> Figure:
    """Draw the outlines of mapped planes and the path of the sensor.

    `poses` (k, 4, 4): ``T_map_sensor``. `stamps_s` (k,): their times; the path is interrupted in
    gaps. `weak` (w,): indices in `poses` of poses that are partly undetermined; marked.
    """
    static = np.flatnonzero(table.status == "static").tolist()
    rows = [k for k in static if len(table.outline[k]) > 2]
    up = upward(table, rows)
    outlines = [table.outline[k] @ up.T for k in rows]
    way = poses[:, :3, 3] @ up.T
    bright = np.abs(table.normal[rows] @ up.T @ LIGHT)[:, None] if rows else np.empty((0, 1))
    colours = COLOURS[table.plane[rows] % len(COLOURS)] / 255 * (0.55 + 0.45 * bright)
    # Room for the label of the vertical axis, which the layout does not know.
    figure = blank(12.0, 6.0, layout=ConstrainedLayoutEngine(wspace=0.12))
    low, high = limits_of(np.concatenate([*outlines, way]), way, 0.2)
    space: Any = figure.add_subplot(1, 2, 1, projection="3d")
    surfaces = Poly3DCollection(
        outlines, facecolors=colours, edgecolors="k", linewidths=0.3, alpha=0.45
    )
    # Its automatic limits would include uninitialised padding of outlines of different length.
    space.add_collection(surfaces, autolim=False)
    path = broken_at_gaps(stamps_s, way)
    space.plot(*path.T, color=BLUE, linewidth=1.5)
    space.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    space.set_box_aspect(np.maximum(high - low, 1e-3))
    space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    space.view_init(elev=35, azim=-60)
    above = figure.add_subplot(1, 2, 2)
    order = np.argsort([outline[:, 2].mean() for outline in outlines], kind="stable")
    flat = [outlines[k][:, :2] for k in order]
    style: dict[str, Any] = {"edgecolors": "k", "linewidths": 0.5, "alpha": 0.45}
    above.add_collection(PolyCollection(flat, facecolors=colours[order], **style))
    above.plot(*path[:, :2].T, color=BLUE, linewidth=1.5, label="path of the sensor")
    above.plot(*way[weak, :2].T, "o", color=RED, markersize=4, label="pose partly undetermined")
    draw_limits(above, (low[:2], high[:2]))
    finish(above, "from above", "x [m]", "y [m]")
    legend_below(figure, 2, above)
    # The layout does not know how high the box is.
    space.set_title(f"{len(rows)} planes, {len(way)} scans", fontsize=10, y=1.0)
    return figure


def upward(table: Plane3dTable, rows: Sequence[int]) -> Floats:
    """Return the rotation that makes the largest floor or ceiling planes level.

    Up is the direction with the largest area within 45 degrees of the first scan's z.
    """
    if not rows:
        return np.eye(3)
    normal, area = table.normal[rows], table.area_m2[rows]
    steep = np.abs(normal[:, 2]) > np.sqrt(0.5)
    if not steep.any():
        return np.eye(3)
    side = normal[steep] * np.sign(normal[steep, 2:])
    alike = (side @ side.T > np.cos(np.deg2rad(5.0))) @ area[steep]
    near = side @ side[np.argmax(alike)] > np.cos(np.deg2rad(5.0))
    z = (side[near] * area[steep][near, None]).sum(axis=0)
    z /= np.linalg.norm(z)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
