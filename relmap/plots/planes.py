"""Pictures of walls: mapped, compared with the truth, and simulated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import in_space
from relmap.evaluation.truth import Truth
from relmap.evaluation.walls import MatchedCorners
from relmap.planes.walls.files import DrawnSubmap
from relmap.planes.walls.table import PlaneTable
from relmap.planes3d.files import COLOURS
from relmap.planes3d.table import Plane3dTable
from relmap.plots.path import broken_at_gaps, broken_at_jumps
from relmap.plots.sheet import (
    BLUE,
    INK,
    PALE,
    RED,
    Sheet,
    blank,
    draw_limits,
    finish,
    first_of,
    legend_below,
    limits_of,
    note_empty,
)
from relmap.simulation import Building

WALL = BLUE
CORNER = "#0b7a3b"
PATH = "#7f7f7f"
POINT = "#b4b4b4"
FINE, DOT, FINE_DPI = 1.1, 2.0, 240
"""Line width of a wall, and size of a corner, slightly larger so that it is seen."""
PANEL_IN = 3.4
RIM_M = 0.8
"""Margin around a panel."""
TRUE_WALL = "#e0a800"
"""As in the paper: the true map in yellow, the computed one in blue (Fig. 7)."""
LIGHT = np.array([0.3, 0.5, 0.81])
"""Direction of a light: planes facing it are brighter."""
LABEL_PT = 12.0
"""Distance of labels from an axis in space, beyond its numbers."""
TICKS = 8
"""Number of ticks along the longest side of a box, in space."""


def plot_submaps(submaps: Sequence[DrawnSubmap], n_submaps: int) -> Figure:
    """Draw walls and paths of some submaps, the map itself first, each in its frame and panel."""
    if len(submaps) < 2:
        return _plot_submap(submaps[0], n_submaps)
    columns = int(np.ceil(np.sqrt(len(submaps))))
    rows = -(-len(submaps) // columns)
    figure = blank(PANEL_IN * columns, PANEL_IN * rows + 0.8, dpi=110)
    for number, submap in enumerate(submaps):
        axes = figure.add_subplot(rows, columns, number + 1)
        ends = submap.planes.ends[submap.planes.status == "static"].reshape(-1, 2)
        draw_limits(axes, limits_of(ends, submap.poses[:, :2, 3], RIM_M))
        n_walls, n_corners = _draw_submap(axes, submap)
        name = "map" if number == 0 else f"submap {number}"
        axes.set_title(
            f"{name}: {len(submap.poses)} scans, {n_walls} walls, {n_corners} corners", fontsize=8
        )
        axes.set_xlabel("x [m]", fontsize=7)
        axes.set_ylabel("y [m]", fontsize=7)
        axes.grid(color=PALE, linewidth=0.5)
        axes.tick_params(labelsize=6)
    left = n_submaps - len(submaps)
    also = f", {left} of a few scans not drawn" if left else ""
    figure.suptitle(f"{n_submaps} separate submaps, each in its own frame{also}", fontsize=11)
    legend_below(figure, 4, *figure.axes)
    return figure


def _plot_submap(submap: DrawnSubmap, n_submaps: int) -> Figure:
    planes, poses = submap.planes, submap.poses
    sheet = _sheet(planes.ends[planes.status == "static"].reshape(-1, 2), poses)
    n_walls, n_corners = _draw_submap(sheet.views[0][0], submap)
    counts = f"{n_walls} walls, {n_corners} corners, {len(poses)} poses"
    return sheet.finish(first_of(n_submaps) + counts)


def _draw_submap(axes: Axes, submap: DrawnSubmap) -> tuple[int, int]:
    """Draw the floor plan over the scan points; return the number of walls and corners."""
    points, at = submap.points, submap.poses[:, :2, 3]
    axes.plot(*points.T, ",", color=POINT, zorder=1.5, rasterized=True)
    axes.plot([], [], ".", color=POINT, label="point of a scan")
    counts = _draw_map(axes, submap.planes, submap.poses)
    if not counts[0]:
        note_empty(axes)
    axes.plot(*at[0], "o", color=INK, markersize=5, zorder=7, label="start", linestyle="")
    axes.plot(*at[-1], "s", color=INK, markersize=5, zorder=7, label="end", linestyle="")
    if len(submap.weak):
        ring: dict[str, Any] = {"color": RED, "markerfacecolor": "none", "markersize": 7}
        between = (at[submap.weak - 1] + at[submap.weak]) / 2
        axes.plot(*between.T, "o", zorder=7, label="weak link", linestyle="", **ring)
    return counts


def _draw_map(axes: Axes, planes: PlaneTable, poses: Floats) -> tuple[int, int]:
    """Draw mapped walls, their corners and the path; return the number of walls and corners."""
    mapped = planes.status == "static"
    draw_walls(axes, planes.ends[mapped], "wall", width=FINE)
    at = planes.ends[mapped][planes.corner[mapped] >= 0]
    dot: dict[str, Any] = {"color": CORNER, "markersize": DOT, "markeredgewidth": 0}
    axes.plot(*at.T, "o", zorder=6, label="corner", linestyle="", **dot)
    path = broken_at_jumps(poses[:, :2, 3])
    axes.plot(*path.T, color=PATH, linewidth=0.6, zorder=2, label="path of the robot")
    return int(mapped.sum()), len(at)


def _sheet(places: Floats, poses: Floats) -> Sheet:
    """Return a figure for positions (n, 2) and the path of poses (k, 4, 4)."""
    return Sheet(in_space(places), in_space(poses[:, :2, 3]), planar=True, dpi=FINE_DPI)


def plot_planes(
    planes: PlaneTable,
    poses: Floats,
    truth: tuple[Truth, MatchedCorners] | None = None,
    title: str | None = None,
) -> Figure:
    """Draw mapped walls, their corners and the path from above.

    `poses` (k, 4, 4): ``T_map_robot``; `truth`: true walls, and the alignment of the map to them;
    `title`: by default the counts.
    """
    places = planes.ends[planes.status == "static"].reshape(-1, 2)
    true_ends = np.empty((0, 2, 2))
    if truth is not None:
        true_ends = (truth[0].ends - truth[1].t) @ truth[1].R
    sheet = _sheet(np.concatenate([places, true_ends.reshape(-1, 2)]), poses)
    axes = sheet.views[0][0]
    if truth is not None:
        draw_true_walls(axes, true_ends)
    n_walls, n_corners = _draw_map(axes, planes, poses)
    return sheet.finish(title or f"{n_walls} walls, {n_corners} corners, {len(poses)} poses")


def plot_building(building: Building) -> Figure:
    """Draw a simulated building and the path from above, with the points of the first scan."""
    ends = building.walls[:, :4].reshape(-1, 2, 2)
    way = building.trajectory[:, :3, 3]
    T_map_robot = building.trajectory[0]
    seen = building.scans[0].points @ T_map_robot[:3, :3].T + T_map_robot[:3, 3]
    sheet = Sheet(in_space(ends.reshape(-1, 2)), way, planar=True)
    axes = sheet.views[0][0]
    draw_walls(axes, ends, "wall", INK, zorder=3.0)
    axes.plot(*way[:, :2].T, color=BLUE, linewidth=1.2, zorder=4, label="path of the robot")
    axes.plot(*way[0, :2], "o", color=BLUE, markersize=5, zorder=5, label="start", linestyle="")
    axes.plot(*seen[:, :2].T, ".", color=RED, markersize=0.8, zorder=2, label="first scan")
    return sheet.finish(f"{len(ends)} sides of walls, {len(building.scans)} scans")


def draw_walls(
    axes: Axes,
    ends: Floats,
    label: str = "mapped wall",
    colour: str = WALL,
    width: float = 1.5,
    zorder: float = 5.0,
) -> None:
    """Draw walls (m, 2, 2) as lines."""
    lines = LineCollection(list(ends), colors=colour, linewidths=width, zorder=zorder)
    axes.add_collection(lines)
    axes.plot([], [], color=colour, linewidth=width, label=label)


def draw_true_walls(axes: Axes, ends: Floats) -> None:
    """Draw true walls (m, 2, 2) as thin lines, below those of the map."""
    draw_walls(axes, ends, "true wall", TRUE_WALL, width=1.0, zorder=4.0)


def _draw_box(space: Any, low: Floats, high: Floats) -> None:
    """Draw axes in space between two corners (3,), with as many ticks as each side has room for."""
    size = np.maximum(high - low, 1e-3)
    space.set(xlim=(low[0], high[0]), xlabel="x [m]", ylim=(low[1], high[1]), ylabel="y [m]")
    space.set(zlim=(low[2], high[2]), zlabel="z [m]", box_aspect=size)
    for axis, share in zip("xyz", size / size.max(), strict=True):
        space.locator_params(axis=axis, nbins=max(round(TICKS * float(share)), 2))
    space.xaxis.labelpad = space.yaxis.labelpad = LABEL_PT


def plot_planes3d(
    table: Plane3dTable, poses: Floats, stamps_s: Floats, weak: Ints, n_submaps: int = 1
) -> Figure:
    """Draw the outlines of mapped planes and the path of the sensor.

    `poses` (k, 4, 4): ``T_map_sensor``. `stamps_s` (k,): their times; the path is interrupted in
    gaps. `weak` (w,): indices in `poses` of poses that are partly undetermined; marked.
    `n_submaps`: number of submaps, of which the first is drawn.
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
    _draw_box(space, low, high)
    space.view_init(elev=35, azim=-60)
    above = figure.add_subplot(1, 2, 2)
    order = np.argsort([outline[:, 2].mean() for outline in outlines], kind="stable")
    flat = [outlines[k][:, :2] for k in order]
    style: dict[str, Any] = {"edgecolors": "k", "linewidths": 0.5, "alpha": 0.45}
    above.add_collection(PolyCollection(flat, facecolors=colours[order], **style))
    above.plot(*path[:, :2].T, color=BLUE, linewidth=1.5, label="path of the sensor")
    if len(weak):
        above.plot(*way[weak, :2].T, "o", color=RED, markersize=4, label="pose partly undetermined")
    draw_limits(above, (low[:2], high[:2]))
    finish(above, "from above", "x [m]", "y [m]")
    legend_below(figure, 2, above)
    # The layout does not know how high the box is.
    space.set_title(
        f"{first_of(n_submaps)}{len(rows)} planes, {len(way)} scans", fontsize=10, y=1.0
    )
    # With a fixed aspect the layout is right only from the second drawing on.
    figure.draw_without_rendering()
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
