"""The test bench as a picture and as an animation: observations and map of a plane mapper."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation
from PIL import Image

from relmap.core.errors import RelmapError
from relmap.plots.bench_recorder import BenchFrame
from relmap.plots.planes import CORNER, draw_true_walls, draw_walls
from relmap.plots.sheet import GREY, INK, RED, Limits, blank, draw_limits, finish, limits_of

TITLE = "the test bench"
ROBOT_FRAME = ", robot frame"
PLANE_COLOURS = (
    "#1f77b4", "#ff7f0e", "#2ca02c", "#9467bd", "#8c564b", "#e377c2", "#17becf", "#bcbd22",
)  # fmt: skip
WIDTH_IN, HEIGHT_IN, DPI = 11.0, 9.0, 110
GIF_DPI = 72
FPS = 8
HOLD = 16
"""Number of frames for which the last one is shown beyond its own."""
MARGIN_M = 0.8
LEGEND_IN = 0.45
"""Distance of the legend below its panel."""


def write_bench_gif(
    path: Path,
    frames: Sequence[BenchFrame],
    progress: Callable[[Sequence[BenchFrame]], Iterable[BenchFrame]] | None = None,
    title: str = TITLE,
) -> None:
    """Draw an animation of the bench into a GIF file; RelmapError if there is no frame."""
    if not frames:
        raise RelmapError("an animation needs at least one scan")
    limits = _limits_of(frames)
    with mpl.rc_context():
        mpl.rcdefaults()
        figure = blank(WIDTH_IN, HEIGHT_IN, GIF_DPI, layout=None)
        images = []
        for frame in progress(frames) if progress else frames:
            figure.clear()
            _draw(figure, frame, limits, title)
            canvas = cast("Any", figure.canvas)
            canvas.draw()
            images.append(Image.fromarray(np.array(canvas.buffer_rgba())[:, :, :3]))
    shown_ms = [1000 // FPS] * len(images)
    shown_ms[-1] *= 1 + HOLD
    images[0].save(path, "GIF", save_all=True, append_images=images[1:], duration=shown_ms, loop=0)


def plot_bench(frame: BenchFrame, title: str = TITLE) -> Figure:
    """Draw mapped against true walls, the robot's points, the segmented planes, and the groups."""
    figure = blank(WIDTH_IN, HEIGHT_IN, DPI, layout=None)
    _draw(figure, frame, _limits_of([frame]), title)
    return figure


def _limits_of(frames: Sequence[BenchFrame]) -> tuple[Limits, Limits]:
    """Return the limits of the world and of the robot's view, over all frames."""
    walls = [ends.reshape(-1, 2) for frame in frames for ends in (frame.walls, frame.true_walls)]
    world = np.concatenate(walls), np.concatenate([frame.path for frame in frames])
    robot = np.concatenate([frame.points_robot for frame in frames]), np.zeros((1, 2))
    return limits_of(*world, MARGIN_M), limits_of(*robot, MARGIN_M)


def _draw(figure: Figure, frame: BenchFrame, limits: tuple[Limits, Limits], title: str) -> None:
    """Draw everything into an empty figure with a fixed layout, for animations."""
    panels = figure.subplots(2, 2)
    figure.subplots_adjust(0.07, 0.1, 0.98, 0.91, 0.16, 0.34)
    world, robot = limits
    for axes, limits_m in zip(panels.ravel(), (world, robot, robot, world), strict=True):
        draw_limits(axes, limits_m)
    _draw_mapped(panels[0, 0], frame)
    _draw_points(panels[0, 1], frame)
    _draw_planes(panels[1, 0], frame)
    _draw_groups(panels[1, 1], frame)
    figure.suptitle(f"{title}, iteration {frame.iteration}", fontsize=13)


def _name(axes: Axes, title: str, frame: str = "") -> None:
    """Label a panel and its axes, with a legend below it."""
    finish(axes, title, f"x{frame} [m]", f"y{frame} [m]")
    figure = axes.get_figure()
    assert figure is not None
    below = axes.transAxes + ScaledTranslation(0, -LEGEND_IN, figure.dpi_scale_trans)
    style: dict[str, Any] = {"ncols": 4, "frameon": False, "fontsize": 8, "bbox_transform": below}
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), **style)


def _draw_mapped(axes: Axes, frame: BenchFrame) -> None:
    known = len(frame.true_walls) > 0
    if known:
        draw_true_walls(axes, frame.true_walls)
    _draw_map(axes, frame)
    axes.plot(*frame.path.T, color=GREY, linewidth=0.9, zorder=2, label="path")
    elsewhere = len(frame.walls) > 0 and not np.isfinite(frame.T_world_robot).all()
    title = "mapped walls over the true ones" if known else "mapped walls"
    _name(axes, f"{title}; this scan is in another submap" if elsewhere else title)


def _draw_map(axes: Axes, frame: BenchFrame) -> None:
    draw_walls(axes, frame.walls)
    style: dict[str, Any] = {"linestyle": "", "zorder": 6}
    axes.plot(*frame.corners.T, "o", color=CORNER, markersize=2.5, label="corner", **style)
    x, y = frame.T_world_robot[:2, 3]
    if np.isfinite(x):
        turned = np.rad2deg(np.arctan2(frame.T_world_robot[1, 0], frame.T_world_robot[0, 0]))
        axes.plot(x, y, marker=(3, 0, turned - 90), color=RED, markersize=9, **style)


def _draw_points(axes: Axes, frame: BenchFrame) -> None:
    axes.plot(*frame.points_robot.T, ".", color=INK, markersize=1.5, label="point")
    axes.plot(0, 0, marker=(3, 0, -90), color=RED, markersize=9, linestyle="", label="robot")
    n = len(frame.points_robot)
    _name(axes, f"what the robot sees: {n} points", ROBOT_FRAME)


def _draw_planes(axes: Axes, frame: BenchFrame) -> None:
    for plane, ends in enumerate(frame.ends_robot):
        colour = PLANE_COLOURS[plane % len(PLANE_COLOURS)]
        own = frame.points_robot[frame.label == plane]
        axes.plot(*own.T, ".", color=colour, markersize=1.2, alpha=0.5)
        axes.plot(*ends.T, color=colour, linewidth=2.2)
    free = frame.points_robot[frame.label < 0]
    axes.plot(*free.T, ".", color=GREY, markersize=1.2, alpha=0.5)
    style: dict[str, Any] = {"linestyle": "", "color": INK, "markersize": 5, "zorder": 6}
    axes.plot(*frame.ends_robot[frame.static_end].T, "o", label="static end", **style)
    cut = frame.ends_robot[~frame.static_end]
    axes.plot(*cut.T, "o", markerfacecolor="white", label="end of the visible part", **style)
    axes.plot(0, 0, marker=(3, 0, -90), color=RED, markersize=9, linestyle="")
    _name(axes, f"segmented: {len(frame.ends_robot)} planes", ROBOT_FRAME)


def _draw_groups(axes: Axes, frame: BenchFrame) -> None:
    alpha = float(np.clip(60 / max(len(frame.links), 1), 0.08, 0.6))
    lines = LineCollection(list(frame.links), colors=RED, linewidths=0.7, alpha=alpha, zorder=1)
    axes.add_collection(lines)
    axes.plot([], [], color=RED, linewidth=0.9, label="group, from its centre to its walls")
    _draw_map(axes, frame)
    _name(axes, "the map with group connectivity")
