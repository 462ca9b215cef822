"""The map without noise, and the links that hang on a single partial wall (Fig. 6)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from relmap.figures.partial_wall import PartialWall
from relmap.plots.paper import ORANGE, RED, blank, finish
from relmap.plots.planes import CORNER, TRUE_WALL, WALL, draw_walls

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARGIN_M = 1.5


def plot_partial_wall(run: PartialWall) -> Figure:
    """Draw the map over the truth, weak links marked, and how far the path is off."""
    figure = blank(11.0, 8.0)
    above, below = figure.subplots(2, 1, height_ratios=[2.6, 1.0])
    _draw_map(above, run)
    _draw_errors(below, run)
    before_m, after_m = run.errors_m
    ahead_m, left_m = run.shift
    figure.suptitle(
        f"Figure 6: {run.weak_m:.1f} m along one partial wall, bridged by the motion model: "
        f"{_length(abs(ahead_m))} off along it, {_length(abs(left_m))} across\n"
        f"path before it {_length(before_m)} off, path after it {_length(after_m)}, "
        "each aligned alone",
        fontsize=11,
    )
    return figure


def _length(metres: float | None) -> str:
    if metres is None:
        return "unknown"
    if metres < 1e-6:
        return f"{metres:.0e} m"
    return f"{1000 * metres:.1f} mm" if metres < 0.1 else f"{metres:.2f} m"


def _draw_map(axes: Axes, run: PartialWall) -> None:
    mapped = run.planes.status == "static"
    ends = run.in_truth(run.planes.ends[mapped])
    corners = ends[run.planes.corner[mapped] >= 0]
    path = run.in_truth(run.poses[:, :2, 3])
    weak = np.where(run.weak[:, None], path, np.nan)
    draw_walls(axes, run.true_walls, TRUE_WALL, 5.0, "true wall")
    draw_walls(axes, ends, WALL, 1.5, "mapped wall")
    axes.plot(*corners.T, "o", color=CORNER, markersize=3.5, linestyle="", label="mapped corner")
    axes.plot(*path.T, color="#7f7f7f", linewidth=1.2, label="path of the robot, from the map")
    axes.plot(*weak.T, color=ORANGE, linewidth=4.0, alpha=0.8, label="weak: nothing fixes it along")
    axes.plot(*path[0], "o", color="#7f7f7f", markersize=6, linestyle="", label="start")
    everything = np.concatenate([path, ends.reshape(-1, 2)])
    low, high = everything.min(axis=0) - MARGIN_M, everything.max(axis=0) + MARGIN_M
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    finish(axes, f"{mapped.sum()} walls mapped, {len(corners)} corners", "x [m]", "y [m]")
    axes.legend(fontsize=8, ncols=2, loc="lower center")


def _draw_errors(axes: Axes, run: PartialWall) -> None:
    off = run.in_truth(run.poses[:, :2, 3]) - run.true_poses[:, :2, 3]
    begin, end = run.stretch
    heading = run.true_poses[(begin + end) // 2, :2, :2]
    along, across = 1000 * (off @ heading).T
    iteration = np.arange(len(off))
    axes.axvspan(begin - 0.5, end - 0.5, color=ORANGE, alpha=0.25, linewidth=0, label="weak links")
    axes.plot(iteration, along, color=RED, label="along the wall")
    axes.plot(iteration, across, color=WALL, label="across it")
    finish(axes, "error of the path, aligned before the wall", "iteration", "error [mm]")
    axes.set_xlim(0, len(off) - 1)
    axes.legend(fontsize=8, loc="best")
