"""The figure eight with its map, in space, from above and from the side (Fig. 13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relmap.plots.paper import BLUE, RED, SAND, blank, finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


STRETCH = 1.6
RIM_M = 10.0


@dataclass(frozen=True, eq=False)
class EightPicture:
    """A map of the figure eight, brought into the frame of the truth.

    Attributes
    ----------
    landmarks_map, path_map : (m, 3), (k, 3) float64, metres
        As mapped; the path is that of the robot.
    true_landmarks_map, true_path_map : (t, 3), (p, 3) float64, metres
    rmse_m : float
        Of the landmarks.
    """

    landmarks_map: NDArray[np.float64]
    path_map: NDArray[np.float64]
    true_landmarks_map: NDArray[np.float64]
    true_path_map: NDArray[np.float64]
    rmse_m: float


def plot_eight(data: EightPicture) -> Figure:
    """Draw the eight in space, and beside it from above and from the side."""
    from matplotlib.ticker import MaxNLocator

    figure = blank(12.5, 6.0)
    grid = figure.add_gridspec(2, 3, width_ratios=[1.3, 0.06, 1.0], height_ratios=[1.6, 1.0])
    space: Any = figure.add_subplot(grid[:, 0], projection="3d")
    _draw(space, data, [0, 1, 2])
    points = np.concatenate([data.true_landmarks_map, data.true_path_map])
    low, high = points.min(axis=0) - RIM_M, points.max(axis=0) + RIM_M
    space.set_box_aspect((high - low) * [1, 1, STRETCH], zoom=1.25)
    space.view_init(elev=28, azim=-62)
    space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    for axis in (space.xaxis, space.yaxis, space.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    title = (
        f"Figure 13: the eight, mapped without ids: {len(data.landmarks_map)} landmarks "
        f"for {len(data.true_landmarks_map)} true ones, RMSE {data.rmse_m:.2g} m"
    )
    figure.suptitle(title, fontsize=11)
    space.set_title(f"in space, z stretched {STRETCH} times", fontsize=10)
    for row, across, name in ((0, 1, "from above"), (1, 2, "from the side")):
        axes = figure.add_subplot(grid[row, 2])
        _draw(axes, data, [0, across])
        finish(axes, name, "x [m]", f"{'xyz'[across]} [m]")
        axes.set_aspect("equal")
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[across], high[across])
    handles, labels = axes.get_legend_handles_labels()
    style: dict[str, Any] = {"ncols": 4, "frameon": False, "fontsize": 9}
    figure.legend(handles, labels, loc="outside lower center", **style)
    return figure


def _draw(axes: Axes, data: EightPicture, pair: list[int]) -> None:
    """Draw map and truth on the axes named by `pair`; three of them are a view in space."""
    true, mapped = data.true_landmarks_map[:, pair].T, data.landmarks_map[:, pair].T
    hollow: dict[str, Any] = {"marker": "o", "markerfacecolor": "none", "markersize": 5}
    style: dict[str, Any] = {"linestyle": "", "markeredgewidth": 0.7, "markeredgecolor": RED}
    axes.plot(*true, label="true landmark", **hollow, **style)
    axes.plot(*mapped, ".", color="black", markersize=3.5, label="mapped landmark")
    path, true_path = data.path_map[:, pair].T, data.true_path_map[:, pair].T
    axes.plot(*true_path, color=SAND, linewidth=4.0, label="true path")
    axes.plot(*path, color=BLUE, linewidth=1.2, label="path of the robot, from the map")
