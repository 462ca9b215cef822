"""The corner test: which of four estimated midpoint pairs of two walls stays where it is (Fig. 4).

As in the paper: observed corner points in blue, estimated midpoints in red, the static pair in
green.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relmap.figures.corner_test import SIDES, CornerTest
from relmap.plots.paper import BLUE, GREY, ORANGE, RED, SAND, blank, finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GREEN = "#0b7a3b"
WALL = "#333333"
BROWN, VIOLET = "#8c564b", "#7b4fa3"
MARGIN_M = 0.8


def plot_corner_test(test: CornerTest, view_rad: float, range_m: float) -> Figure:
    """Draw a scan with its estimated midpoints, the four pairs, and their shifts over time.

    Parameters
    ----------
    test : CornerTest
    view_rad, range_m : float
        Field of view and range of the sensor, drawn as the shaded frustum.
    """
    figure = blank(14.0, 4.8)
    seen, pairs, shifts = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.15])
    for axes in (seen, pairs):
        _draw_frustum(axes, view_rad, range_m)
        _draw_walls(axes, test)
    _draw_ends(seen, test)
    _draw_pairs(pairs, test)
    _draw_shifts(shifts, test)
    told = [axes.get_legend_handles_labels() for axes in (seen, pairs)]
    handles, labels = (told[0][k] + told[1][k] for k in (0, 1))
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.suptitle(
        f"Figure 4: the static corners of walls {test.planes[0]} and {test.planes[1]}, "
        f"seen together in iterations {test.iterations[0]} to {test.iterations[-1]}"
    )
    return figure


def _shown(test: CornerTest) -> int:
    """Return the iteration in which midpoints and ends of both walls lie farthest apart."""
    clear = np.full(len(test.iterations), np.inf)
    for ends, size in ((test.first, test.sizes[0]), (test.second, test.sizes[1])):
        seen = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        clear = np.minimum(clear, np.minimum(abs(size - seen), abs(size / 2 - seen)))
    return int(clear.argmax())


def _off(test: CornerTest) -> NDArray[np.float64]:
    """Return how far each pair's offset is from its mean, (k, 2, 2), metres."""
    return np.asarray(np.linalg.norm(test.offsets - test.offsets.mean(axis=0), axis=3))


def _midpoints(ends: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """Return the midpoints (2, 2) estimated from the right and the left end (2, 2)."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return np.stack([ends[0] + size / 2 * along, ends[1] - size / 2 * along])


def _both(test: CornerTest) -> list[tuple[NDArray[np.float64], float]]:
    k = _shown(test)
    return [(test.first[k], test.sizes[0]), (test.second[k], test.sizes[1])]


def _draw_frustum(axes: Axes, view_rad: float, range_m: float) -> None:
    from matplotlib.patches import Wedge

    half = np.rad2deg(view_rad / 2)
    axes.add_patch(Wedge((0, 0), range_m, -half, half, color=SAND, alpha=0.45, zorder=0))
    axes.plot(0, 0, ">", color=WALL, markersize=9, zorder=4)


def _draw_walls(axes: Axes, test: CornerTest) -> None:
    """Draw the walls as observed, dashed as far as their sizes say that they go on."""
    points = [np.zeros((1, 2))]
    for number, (ends, size) in enumerate(_both(test)):
        fixed = test.static[number]
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        far = ends[fixed] + (1 - 2 * fixed) * size * along
        axes.plot(*np.stack([ends[fixed], far]).T, "--", color=WALL, linewidth=1, zorder=2)
        axes.plot(*ends.T, color=WALL, linewidth=2.5, zorder=2)
        off = np.array([-along[1], along[0]]) * -0.45
        axes.annotate(
            str(test.planes[number]), ends.mean(axis=0) + off, ha="center", va="center", color=WALL
        )
        points += [ends, far[None], _midpoints(ends, size)]
    flat = np.concatenate(points)
    low, high = flat.min(axis=0) - MARGIN_M, flat.max(axis=0) + MARGIN_M
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def _draw_ends(axes: Axes, test: CornerTest) -> None:
    ends = np.concatenate([ends for ends, _ in _both(test)])
    midpoints = np.concatenate([_midpoints(*wall) for wall in _both(test)])
    style: dict[str, Any] = {
        "linestyle": "",
        "markersize": 8,
        "markerfacecolor": "none",
        "zorder": 5.0,
    }
    axes.plot(*ends.T, "o", color=BLUE, label="observed corner point", **style)
    axes.plot(*midpoints.T, "o", color=RED, label="estimated midpoint", **style)
    axes.plot([], [], ">", color=WALL, label="robot, with what it can see")
    axes.plot([], [], "--", color=WALL, label="size, fixed over the interval")
    title = f"iteration {test.iterations[_shown(test)]}: midpoints from either end"
    finish(axes, title, "x, robot frame [m]", "y, robot frame [m]")


def _colours(test: CornerTest) -> dict[tuple[int, int], str]:
    others = iter((ORANGE, BROWN, VIOLET))
    return {
        pair: GREEN if pair == test.chosen else next(others)
        for pair in ((0, 0), (0, 1), (1, 0), (1, 1))
    }


def _named(pair: tuple[int, int]) -> str:
    return f"{SIDES[pair[0]]}–{SIDES[pair[1]]}"


def _draw_pairs(axes: Axes, test: CornerTest) -> None:
    first, second = (_midpoints(*wall) for wall in _both(test))
    for pair, colour in _colours(test).items():
        a, b = first[pair[0]], second[pair[1]]
        width = 3.0 if pair == test.chosen else 1.2
        arrow = {
            "arrowstyle": "-|>",
            "color": colour,
            "linewidth": width,
            "shrinkA": 4,
            "shrinkB": 4,
        }
        axes.annotate("", b, a, arrowprops=arrow, zorder=6)
        axes.plot([], [], color=colour, linewidth=width, label=f"from the ends {_named(pair)}")
    for points in (first, second):
        axes.plot(*points.T, "o", color=RED, markersize=8, markerfacecolor="none", zorder=5)
    finish(axes, "the four midpoint pairs", "x, robot frame [m]", "y, robot frame [m]")


def _draw_shifts(axes: Axes, test: CornerTest) -> None:
    """Draw how far each pair's offset is from its mean in each iteration."""
    from matplotlib.ticker import MaxNLocator

    off = _off(test)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    for (i, j), colour in _colours(test).items():
        chosen = (i, j) == test.chosen
        label = f"{_named((i, j))}: {_length(test.deviation[i, j])}" + (
            ", static" if chosen else ""
        )
        axes.plot(
            test.iterations,
            off[:, i, j],
            ".-",
            color=colour,
            linewidth=2.5 if chosen else 1.2,
            label=label,
        )
    axes.axhline(0, color=GREY, linewidth=0.8)
    right = "as" if test.chosen == test.static else "unlike what"
    title = f"lowest deviation: {_named(test.chosen)}, {right} the end types say"
    finish(axes, title, "iteration", "offset of the pair from its mean [m]")
    axes.legend(fontsize=8, title="standard deviation", title_fontsize=8, loc="best")


def _length(metres: float) -> str:
    if metres < 1e-6:
        return f"{metres:.0e} m"
    return f"{metres:.3f} m"
