"""Figure 17: the trees of Victoria Park, mapped without ids and without odometry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.comparison.baselines.batch import least_squares_map
from relmap.core.arrays import Bools, Floats
from relmap.core.errors import RelmapError
from relmap.datasets import open_log
from relmap.datasets.base import ObservationLog
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.landmarks import overlay
from relmap.evaluation.metrics import seen_often
from relmap.evaluation.run import run_mapper
from relmap.evaluation.truth import Truth
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged, sentence
from relmap.io.results import Result
from relmap.plots.path import broken_at_gaps
from relmap.plots.sheet import blank, draw_limits, finish, legend_below, limits_of
from relmap.points.mapper import PointMapper

FORMAT = "victoria-park"
INTERVALS = ((1181, 1642), (4220, 4634))
"""Scans used in the paper: elsewhere too few trees are seen at once."""
CLOSE_M = 1.0
COVERED = 0.9
TREE, REFERENCE, SELDOM, PATH = "#1f3fd0", "#f5a300", "#fbe0a8", "#b9b9b9"
HEIGHT_IN, NARROWEST_IN, MARGINS_IN = 7.0, 4.2, 2.2
"""Height of the panels; the widths follow, all in one scale."""
RIM_M = 10.0
TREES = "trees mapped without ids (no dot: has no published id)"


@dataclass(frozen=True, eq=False)
class Panel:
    """One stretch of the drive.

    `trees_map` (n, 2), map frame, metres: mapped by relmap. `reference_map` (m, 2), map frame,
    metres: mapped by batch least squares with the published ids, aligned to relmap's map. `often`
    (m,): which of those were seen at least ten times. `path_map` (k, 2), map frame, metres: path of
    the robot according to relmap; NaN where unknown. `rmse_m`: error of the trees against the
    reference. `coverage`: fraction of the trees seen at least ten times that are mapped.
    """

    title: str
    trees_map: Floats
    reference_map: Floats
    often: Bools
    path_map: Floats
    rmse_m: float
    coverage: float


def compare_with_reference(result: Result, log: ObservationLog) -> Panel:
    """Align the reference to the map of a stretch of the drive.

    `result`: result of mapping the log; `log`: with the published ids, for the evaluation and for
    the reference. Raises `RelmapError` if the ids are missing or give no reference, or the log is
    not the one that was mapped.
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
    path = broken_at_gaps(result.stamps_s, result.poses[:, :2, 3])
    reference_map, rmse_m = laid_over.landmarks_map[:, :2], evaluation.landmark_rmse_m
    return Panel(title, trees, reference_map, often, path, rmse_m, evaluation.coverage or 0.0)


def _run(quick: bool, data: Path | None, watch: Watch) -> list[Panel]:
    if data is None:
        raise RelmapError("figure 17 needs the Victoria Park data: --data PATH")
    log = victoria_park(data)
    panels = []
    for interval in watch(INTERVALS):
        part = log.between(*interval)
        result = run_mapper(PointMapper(), part, "nearest", refine=True).result
        panels.append(compare_with_reference(result, part))
    return panels


@cache
def victoria_park(path: Path) -> ObservationLog:
    """Read the data from their folder or its parent; RelmapError if they are not there."""
    inner = path / FORMAT
    return open_log(inner if inner.is_dir() else path, FORMAT)


def _judge(panels: list[Panel]) -> Outcome:
    rows: list[tuple[object, ...]] = []
    for number, panel in enumerate(panels):
        rows += [(number, "tree", "", *place) for place in panel.trees_map.tolist()]
        reference = zip(panel.often.tolist(), panel.reference_map.tolist(), strict=True)
        rows += [(number, "reference", int(often), *place) for often, place in reference]
        path = panel.path_map[np.isfinite(panel.path_map[:, 0])]
        rows += [(number, "pose", "", *place) for place in path.tolist()]
    return Outcome(
        Table(("stretch", "what", "seen_ten_times", "x", "y"), rows),
        max(panel.rmse_m for panel in panels),
        " ".join(sentence(panel.title.replace("\n", ", ")) for panel in panels),
        judged(*(panel.rmse_m < CLOSE_M and panel.coverage >= COVERED for panel in panels)),
    )


def _plot(panels: list[Panel]) -> Figure:
    """Draw relmap's trees over those of the reference.

    Each stretch has a panel, all in one scale, turned so that the truck drives up the page.
    """
    panels = [_turned(panel) for panel in panels]
    places = [np.concatenate([panel.trees_map, panel.reference_map]) for panel in panels]
    pairs = zip(places, panels, strict=True)
    limits = [limits_of(trees, panel.path_map, RIM_M) for trees, panel in pairs]
    tall_m = max(float(high[1] - low[1]) for low, high in limits)
    wide_m = [max(high[0] - low[0], tall_m * NARROWEST_IN / HEIGHT_IN) for low, high in limits]
    width_in = HEIGHT_IN * sum(wide_m) / tall_m + len(panels)
    figure = blank(width_in, HEIGHT_IN + MARGINS_IN)
    all_axes = figure.subplots(1, len(panels), width_ratios=wide_m, squeeze=False)[0]
    for axes, panel, (low, high), across_m in zip(all_axes, panels, limits, wide_m, strict=True):
        middle, half = (low + high) / 2, np.array([across_m, tall_m]) / 2
        draw_limits(axes, (middle - half, middle + half))
        _draw(axes, panel)
    figure.suptitle(
        "Figure 17: trees of Victoria Park, mapped without ids and odometry", fontsize=11
    )
    legend_below(figure, 2, axes)
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


def _draw(axes: Axes, panel: Panel) -> None:
    finish(axes, panel.title, "across the drive [m]", "from start to end of the drive [m]")
    label = "path of the truck (relmap)"
    axes.plot(*panel.path_map.T, color=PATH, linewidth=1.4, zorder=2, label=label)
    square: dict[str, Any] = {"marker": "s", "facecolors": "none", "edgecolors": TREE}
    x, y = panel.trees_map.T
    axes.scatter(x, y, s=42, linewidths=1.0, zorder=4, label=TREES, **square)
    for chosen, colour, label in (
        (panel.often, REFERENCE, "reference with published ids, seen 10 times or more"),
        (~panel.often, SELDOM, "reference, seen less often"),
    ):
        x, y = panel.reference_map[chosen].T
        axes.scatter(x, y, s=16, c=colour, linewidths=0, zorder=3, label=label)


FIGURE = PaperFigure(
    name="17",
    title="Victoria Park",
    claim=(
        "In the stretches of Victoria Park in which enough trees are in view, trees are mapped "
        "without odometry at the positions that an EKF with odometry finds."
    ),
    criterion=(
        f"in both stretches the RMSE against batch least squares with the published tree ids is "
        f"below {CLOSE_M:g} m and {COVERED:.0%} of the trees seen ten times are mapped; partly "
        "where this holds in one stretch"
    ),
    unit="RMSE of the trees in m in the worse stretch",
    run=_run,
    judge=_judge,
    draw=_plot,
)
