"""Trees of Victoria Park beside those of a reference (Fig. 17)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.baselines.known import least_squares_map
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.landmarks import overlay
from relmap.evaluation.metrics import seen_often
from relmap.evaluation.truth import Truth
from relmap.io.results import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TREE = "#1f3fd0"
REFERENCE = "#f5a300"
SELDOM = "#fbe0a8"
PATH = "#b9b9b9"
HEIGHT_IN = 7.0
"""Height of the panels; their widths follow, all in one scale."""
NARROWEST_IN = 4.2
LEFT_IN, GAP_IN, RIGHT_IN, TOP_IN, BOTTOM_IN = 0.8, 0.9, 0.3, 1.1, 1.15
TITLE_IN = 0.12
RIM_M = 10.0
TREES = "trees mapped without ids (no dot: has no published id)"


@dataclass(frozen=True, eq=False)
class Panel:
    """One stretch of the drive.

    Attributes
    ----------
    title : str
    trees_map : (n, 2) float64, map frame, metres
        As relmap maps them.
    reference_map : (m, 2) float64, map frame, metres
        As batch least squares with the published ids maps them, laid on relmap's.
    often : (m,) bool
        Which of those were seen at least ten times.
    path_map : (k, 2) float64, map frame, metres
        Of the robot, as relmap has it.
    rmse_m : float
        Of the trees against the reference.
    coverage : float
        Share of the trees seen at least ten times that are mapped.
    """

    title: str
    trees_map: NDArray[np.float64]
    reference_map: NDArray[np.float64]
    often: NDArray[np.bool_]
    path_map: NDArray[np.float64]
    rmse_m: float
    coverage: float


def compare_with_reference(result: Result, log: ObservationLog) -> Panel:
    """Lay the reference on the map of a stretch of the drive, by rigid alignment.

    Parameters
    ----------
    result : Result
        Of mapping the log.
    log : ObservationLog
        With the published ids, which judge the map and make the reference.

    Raises
    ------
    RelmapError
        Where the ids are missing or make no reference, or the log is not the one that was mapped.
    """
    reference = least_squares_map(log)
    ids = reference.landmark_ids
    status = np.full(len(ids), "static")
    truth = Truth(ids, reference.positions, status, np.empty(0), np.empty((0, 4, 4)))
    evaluation, laid_over = evaluate(result, truth, log), overlay(result, truth, log)
    if laid_over is None or log.ids is None or evaluation.landmark_rmse_m is None:
        raise RelmapError("none of the mapped trees has a published id")
    often = np.isin(ids, seen_often(log.ids, log.iteration))
    due, mapped = int(often.sum()), round((evaluation.coverage or 0.0) * often.sum())
    title = (
        f"scans {log.first_iteration} to {log.end_iteration - 1}\n"
        f"RMSE {evaluation.landmark_rmse_m:.2f} m over {len(laid_over.errors_map)} trees\n"
        f"{mapped} of the {due} trees seen 10 times are mapped"
    )
    trees = result.landmarks.position[result.mapped][:, :2]
    path = result.poses[:, :2, 3]
    reference_map, rmse_m = laid_over.landmarks_map[:, :2], evaluation.landmark_rmse_m
    return Panel(title, trees, reference_map, often, path, rmse_m, evaluation.coverage or 0.0)


def plot_panels(panels: Sequence[Panel]) -> Figure:
    """Draw relmap's trees over those of the reference.

    Each stretch has a panel, all in one scale, turned so that the truck drives up the page.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = [_turned(panel) for panel in panels]
    limits = [_limits(panel) for panel in panels]
    tall_m = max(float(high[1] - low[1]) for low, high in limits)
    scale = HEIGHT_IN / tall_m
    widths = [max(scale * float(high[0] - low[0]), NARROWEST_IN) for low, high in limits]
    width = LEFT_IN + sum(widths) + GAP_IN * (len(panels) - 1) + RIGHT_IN
    height = TOP_IN + HEIGHT_IN + BOTTOM_IN
    figure = Figure(figsize=(width, height), dpi=150)
    FigureCanvasAgg(figure)
    left = LEFT_IN
    for panel, (low, high), wide in zip(panels, limits, widths, strict=True):
        box = (left / width, BOTTOM_IN / height, wide / width, HEIGHT_IN / height)
        axes = figure.add_axes(box, aspect="equal")
        x, y = (low + high) / 2
        axes.set_xlim(x - wide / scale / 2, x + wide / scale / 2)
        axes.set_ylim(y - tall_m / 2, y + tall_m / 2)
        _draw(axes, panel)
        left += wide + GAP_IN
    title = "Figure 17: trees of Victoria Park, mapped without ids and odometry"
    figure.suptitle(title, y=1 - TITLE_IN / height, fontsize=11)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def _turned(panel: Panel) -> Panel:
    """Return a panel whose y axis points from the start of the path to its end."""
    if len(panel.path_map) < 2:
        return panel
    start, end = panel.path_map[[0, -1]]
    y = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    R = np.array([[y[1], -y[0]], y])
    places = (panel.trees_map, panel.reference_map, panel.path_map)
    trees, reference, path = ((place - start) @ R.T for place in places)
    return replace(panel, trees_map=trees, reference_map=reference, path_map=path)


def _limits(panel: Panel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = np.concatenate([panel.trees_map, panel.reference_map, panel.path_map])
    return points.min(axis=0) - RIM_M, points.max(axis=0) + RIM_M


def _draw(axes: Axes, panel: Panel) -> None:
    axes.set_title(panel.title, fontsize=10)
    axes.set_xlabel("across the drive [m]")
    axes.set_ylabel("from start to end of the drive [m]")
    axes.grid(color="#ececec", linewidth=0.5)
    axes.set_axisbelow(True)
    x, y = panel.path_map.T
    axes.plot(x, y, color=PATH, linewidth=1.4, zorder=2, label="path of the truck (relmap)")
    x, y = panel.trees_map.T
    square: dict[str, Any] = {"marker": "s", "facecolors": "none", "edgecolors": TREE}
    axes.scatter(x, y, s=42, linewidths=1.0, zorder=4, label=TREES, **square)
    for chosen, colour, label in (
        (panel.often, REFERENCE, "reference with published ids, seen 10 times or more"),
        (~panel.often, SELDOM, "reference, seen less often"),
    ):
        x, y = panel.reference_map[chosen].T
        axes.scatter(x, y, s=16, c=colour, linewidths=0, zorder=3, label=label)
