"""Planes and points mapped from the same noisy points: two maps (Fig. 7), and all noises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from relmap.figures.crossing import HALF, METHODS, Crossing, Method
from relmap.plots.paper import BLUE, GREY, ORANGE, RED, blank, finish
from relmap.plots.planes import TRUE_WALL, WALL, draw_walls

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from relmap.figures.noisy_map import NoisyMaps

COLOURS: dict[Method, str] = {"planes": BLUE, "points": RED, "points, ids given": ORANGE}
BAR = 1.2
"""Map error of planes at Fig. 7's noise, in units of sigma, that is aimed at."""


def plot_noisy_maps(maps: NoisyMaps) -> Figure:
    """Draw the map of planes, and that of points, over the true walls (Fig. 7)."""
    low, high = maps.limits
    width, height = high - low
    scale = min(6.2 / width, 7.0 / height)
    figure = blank(2 * scale * width + 1.6, scale * height + 1.9)
    planes, points = figure.subplots(1, 2, sharey=True)
    for axes in (planes, points):
        draw_walls(axes, maps.true_walls, TRUE_WALL, 3.0, "true wall")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    draw_walls(planes, maps.walls, WALL, 1.0, "mapped wall")
    _path(planes, maps.planes_path)
    finish(planes, f"planes: {maps.said_of_planes}", "x [m]", "y [m]")
    _draw_points(points, maps)
    finish(points, f"points: {maps.said_of_points}", "x [m]", "")
    for axes in (planes, points):
        axes.legend(
            fontsize=8, ncols=4, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.1)
        )
    figure.suptitle(
        f"Figure 7: noise of {maps.sigma:.3g} m, {maps.noise:g} of the {maps.spacing_m:g} m "
        f"between the points, seed {maps.seed}"
    )
    return figure


def _path(axes: Axes, path: NDArray[np.float64]) -> None:
    axes.plot(*path.T, color=GREY, linewidth=0.9, zorder=2, label="path from the map")


def _draw_points(axes: Axes, maps: NoisyMaps) -> None:
    if len(maps.points):
        axes.plot(*maps.points.T, ".", color=WALL, markersize=1.5, label="mapped point")
        _path(axes, maps.points_path)
    else:
        axes.text(
            0.5,
            0.5,
            "no map: no point is recognised\noften enough to be placed",
            ha="center",
            va="center",
            transform=axes.transAxes,
            fontsize=11,
            bbox={"facecolor": "white", "edgecolor": "none"},
            zorder=10,
        )


@dataclass(frozen=True)
class _Panel:
    name: str
    title: str
    unit: str


PANELS = (
    _Panel("map_rmse_m", "error of the map", "RMSE of corners or points [m]"),
    _Panel("ate_m", "error of the path", "ATE of the poses there are [m]"),
    _Panel("coverage", "how much is mapped", "corners or points seen ten times [%]"),
)


def plot_crossing(data: Crossing) -> Figure:
    """Draw errors and what is mapped over the noise: a row for each spacing of the points."""
    spacings = data.spacings_m
    figure = blank(13.5, 0.9 + 3.7 * len(spacings))
    grid = figure.subplots(len(spacings), len(PANELS), squeeze=False)
    for row, spacing_m in zip(grid, spacings, strict=True):
        for axes, panel in zip(row, PANELS, strict=True):
            _draw_panel(axes, data, panel, spacing_m)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=5, loc="outside lower center", frameon=False, fontsize=9)
    title = "Planes and points from the same raw points, over sigma / spacing"
    figure.suptitle(f"{title}\n{said(data)}", fontsize=11)
    return figure


def said(data: Crossing) -> str:
    """Return where planes overtake points, a line for each spacing."""
    return "\n".join(_said(data, spacing_m) for spacing_m in data.spacings_m)


def _said(data: Crossing, spacing_m: float) -> str:
    lowest, highest = data.noises(spacing_m)[0], data.noises(spacing_m)[-1]

    def at(begin: float | None, last: float = highest) -> str:
        if begin is None:
            return "nowhere"
        text = f"from {begin:.2f}" + (" or below" if begin <= lowest else "")
        return text + (f" to {last:g}" if last < highest else "")

    own, known = (data.planes_ahead(method, spacing_m) for method in METHODS[1:])
    fails, planes_fail = (at(data.fails_at(method, spacing_m)) for method in ("points", "planes"))
    return (
        f"points {spacing_m:g} m apart: planes have the better map {at(*own or (None,))}, "
        f"{at(*known or (None,))} if the ids of points were given; "
        f"points lose half {fails}, planes {planes_fail}"
    )


def _draw_panel(axes: Axes, data: Crossing, panel: _Panel, spacing_m: float) -> None:
    noise = np.array(data.noises(spacing_m))
    share = panel.name == "coverage"
    for method, colour in COLOURS.items():
        runs = data.values(panel.name, method, spacing_m) * (100 if share else 1)
        runs = np.where(np.isfinite(runs), runs, np.nan)
        median = data.median(panel.name, method, spacing_m) * (100 if share else 1)
        lost = data.median("coverage", method, spacing_m) < HALF
        median = np.where(np.isfinite(median) & (share | ~lost), median, np.nan)
        axes.plot(noise, runs, ".", color=colour, markersize=4, alpha=0.5)
        axes.plot(noise, median, "o-", color=colour, markersize=5, label=f"{method}, median")
    axes.plot([], [], ".", color=GREY, label="one seed")
    if share:
        axes.axhline(100 * HALF, color=GREY, linestyle=":", linewidth=1.2)
        axes.set_ylim(-4, 104)
    else:
        axes.set_yscale("log")
    if panel.name == "map_rmse_m":
        axes.plot(noise, BAR * noise * spacing_m, ":", color=GREY, label=f"{BAR} sigma")
    title = f"{panel.title}, points {spacing_m:g} m apart"
    finish(axes, title, "noise: sigma / spacing", panel.unit)
