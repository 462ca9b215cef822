"""Methods side by side: errors and times, the landmarks' errors as enlarged arrows; and sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.core.arrays import Floats
from relmap.evaluation.landmarks import Overlay
from relmap.io.results import Result
from relmap.plots.path import broken_at_gaps, broken_at_jumps
from relmap.plots.sheet import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    Sheet,
    blank,
    finish,
    legend_below,
    write_in_full,
)

Figures = Mapping[str, float | None]
OURS = "relmap"
"""Prefix of the names of relmap's own methods."""
ROW_IN = 0.34
MANY = 30.0
"""Ratio of the largest to the smallest figure above which only powers of ten are labelled."""
WIDE = 1e4
"""The same for an axis of a sweep; without noise the errors are those of rounding."""
PANELS = {
    "corner_rmse_m": "RMSE of corners [m]",
    "often_rmse_m": "RMSE of landmarks seen ten times [m]",
    "ate_m": "error of the path (ATE) [m]",
}
PANEL_IN = 4.6
MARKERS = "osD^vP*X<>"
USUAL, LONGEST = 0.04, 0.12
"""Length of a typical arrow and of the longest, as fractions of the extent of the picture."""
STEPS = (1.0, 2.0, 5.0)


def plot_comparison(rows: Sequence[tuple[str, Figures]], title: str) -> Figure:
    """Draw the errors of map and path, and the run time, of every method, from top to bottom."""
    walls = any(f.get("corner_rmse_m") for _, f in rows)
    panels = [
        *((key, PANELS[key]) for key in ("corner_rmse_m" if walls else "often_rmse_m", "ate_m")),
        ("relation_m", "error of checked relations [m]"),
        ("total_s", "processor time of the whole log [s]"),
    ]
    shown = [(key, name) for key, name in panels if any(f.get(key) for _, f in rows)] or panels[-1:]
    figure = blank(2.0 + 3.3 * len(shown), 1.5 + ROW_IN * len(rows))
    figure.suptitle(title, fontsize=10, parse_math=False)  # a log may be named with a $
    all_axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    for axes, (key, name) in zip(all_axes, shown, strict=True):
        _draw_errors(axes, rows, key)
        finish(axes, "", name, "")
    all_axes[0].set_yticks(range(len(rows)), [method for method, _ in rows])
    all_axes[0].set_ylim(len(rows) - 0.5, -0.5)
    return figure


def _draw_errors(axes: Axes, rows: Sequence[tuple[str, Figures]], key: str) -> None:
    """Draw one figure of every method as a dot, on a logarithmic scale."""
    axes.set_xscale("log")
    values = [f.get(key) for _, f in rows]
    known = np.array([value for value in values if value] or [1.0])
    least = known.min() / 2
    axes.set_xlim(least, 4 * known.max())
    write_in_full(axes.xaxis, (1, 2, 5) if known.max() < MANY * known.min() else (1,))
    for row, ((method, _), value) in enumerate(zip(rows, values, strict=True)):
        if not value:
            axes.text(least * 1.05, row, "no figure", va="center", fontsize=7, color=GREY)
            continue
        colour = BLUE if method.startswith(OURS) else ORANGE
        axes.plot(value, row, "o", color=colour, markersize=6)
        beside: dict[str, Any] = {"xytext": (7, 0), "textcoords": "offset points"}
        axes.annotate(f"{value:.3g}", (value, row), va="center", fontsize=7, **beside)


@dataclass(frozen=True, eq=False)
class SweepRow:
    """One experiment.

    `name`: common name of the experiments of one line. `at`: value of the varied parameter; None if
    none is numeric. `figures`: errors, None if not available.
    """

    name: str
    at: float | None
    figures: Figures


def plot_sweep(rows: Sequence[SweepRow], along: str) -> Figure:
    """Draw all experiments as dots over what `along` says, and a line of medians for each name."""
    names = list(dict.fromkeys(row.name for row in rows))
    if any(row.at is None for row in rows):
        medians = [(name, _medians([r for r in rows if r.name == name])) for name in names]
        return plot_comparison(medians, "medians over the seeds")
    shown = [key for key in PANELS if any(row.figures.get(key) for row in rows)] or ["ate_m"]
    figure = blank(PANEL_IN * len(shown), PANEL_IN)
    all_axes = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, key in zip(all_axes, shown, strict=True):
        for k, name in enumerate(names):
            _draw_line(axes, [row for row in rows if row.name == name], key, name, k)
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        write_in_full(axes.yaxis, (1, 2, 5) if high < WIDE * low else (1,))
        finish(axes, "", along, PANELS[key])
    legend_below(figure, 3, *all_axes)
    return figure


def _draw_line(axes: Axes, rows: Sequence[SweepRow], key: str, name: str, k: int) -> None:
    at = np.array([row.at for row in rows if row.figures.get(key)])
    value = np.array([row.figures[key] for row in rows if row.figures.get(key)])
    colour, marker = f"C{k % 10}", MARKERS[k % len(MARKERS)]
    axes.plot(at, value, marker, color=colour, markersize=3, alpha=0.35, markeredgewidth=0)
    places = np.unique(at)
    medians = [float(np.median(value[at == place])) for place in places]
    style: dict[str, Any] = {"color": colour, "markerfacecolor": "none", "markersize": 4 + k % 4}
    axes.plot(places, medians, f"{marker}-", linewidth=1, label=name, **style)


def _medians(rows: Sequence[SweepRow]) -> Figures:
    found: dict[str, float | None] = {}
    for key in PANELS:
        values = [value for row in rows if (value := row.figures.get(key)) is not None]
        found[key] = float(np.median(values)) if values else None
    return found


def shared_scale(overlays: Sequence[Overlay]) -> float:
    """Return the common factor by which the errors of all methods are enlarged: 1, 2, 5, 10, ..."""
    pairs = [each.errors_map for each in overlays if len(each.errors_map)]
    usual = [float(np.median(np.linalg.norm(each[:, 0] - each[:, 1], axis=1))) for each in pairs]
    extent = max((_extent(each.landmarks_map) for each in overlays), default=0.0)
    middle = float(np.median(usual)) if usual else 0.0
    wanted = USUAL * extent / middle if middle > 0 else 1.0
    power = 10.0 ** np.floor(np.log10(max(wanted, 1.0)))
    return float(max(step * power for step in STEPS if step * power <= max(wanted, 1.0)))


def plot_errors(result: Result, truth: Overlay, scale: float, title: str) -> Figure:
    """Draw the true landmarks, and an arrow to each mapped one.

    `truth`: in the frame of the map. `scale`: factor by which the arrows are enlarged; see
    `shared_scale`.
    """
    way = np.concatenate([result.poses[:, :3, 3], truth.path_map])
    true = truth.errors_map[:, 1]
    arrow = scale * (truth.errors_map[:, 0] - true)
    length, most = np.linalg.norm(arrow, axis=1), LONGEST * _extent(truth.landmarks_map)
    beyond = length > most
    arrow[beyond] *= (most / length[beyond])[:, None]
    sheet = Sheet(np.concatenate([truth.landmarks_map, true + arrow]), way, result.planar)
    style: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.003}
    for axes, pair in sheet.views:
        axes.plot(
            *truth.landmarks_map[:, pair].T, ".", color=GREY, markersize=3, label="true landmark"
        )
        if len(truth.path_map):
            path = broken_at_jumps(truth.path_map)[:, pair]
            axes.plot(*path.T, "--", color=GREY, linewidth=0.8, label="true path")
        if len(result.poses):
            path = broken_at_gaps(result.stamps_s, result.poses[:, :3, 3])[:, pair]
            axes.plot(*path.T, color=BLUE, linewidth=1.0, label="path of the robot")
        for of, colour, name in (
            (~beyond, ORANGE, f"error, x {scale:g}"),
            (beyond, RED, f"more than {most / scale:.2g} m"),
        ):
            if of.any():
                axes.quiver(*true[of][:, pair].T, *arrow[of][:, pair].T, color=colour, **style)
                axes.plot([], [], color=colour, label=name)
    return sheet.finish(title)


def _extent(places: Floats) -> float:
    return float(np.ptp(places, axis=0).max()) if len(places) else 0.0
