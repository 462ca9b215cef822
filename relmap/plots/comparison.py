"""Methods side by side: errors and times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.plots.sheet import BLUE, GREY, ORANGE, blank, finish, to_png, write_in_full

Figures = Mapping[str, float | None]
OURS = "relmap"
"""Prefix of the names of relmap's own methods."""
ROW_IN = 0.34
MANY = 30.0
"""Ratio of the largest to the smallest figure above which only powers of ten are labelled."""


def plot_comparison(rows: Sequence[tuple[str, Figures]], title: str) -> Figure:
    """Draw the errors of map and path, and the run time, of every method.

    `rows`, sequence of (str, mapping): name and figures of each method, from top to bottom.
    """
    walls = any(f.get("corner_rmse_m") for _, f in rows)
    of_map = ("corner_rmse_m", "corners") if walls else ("often_rmse_m", "landmarks seen ten times")
    panels = [
        (of_map[0], f"RMSE of {of_map[1]} [m]"),
        ("ate_m", "error of the path (ATE) [m]"),
        ("relation_m", "error of checked relations [m]"),
        ("total_s", "processor time of the whole log [s]"),
    ]
    shown = [(key, name) for key, name in panels if any(f.get(key) for _, f in rows)] or panels[-1:]
    figure = blank(2.0 + 3.3 * len(shown), 1.5 + ROW_IN * len(rows))
    figure.suptitle(title, fontsize=10, parse_math=False)  # a log may be named with a $
    all_axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    for axes, (key, name) in zip(all_axes, shown, strict=True):
        _draw(axes, rows, key)
        finish(axes, "", name, "")
    all_axes[0].set_yticks(range(len(rows)), [method for method, _ in rows])
    all_axes[0].set_ylim(len(rows) - 0.5, -0.5)
    return figure


def _draw(axes: Axes, rows: Sequence[tuple[str, Figures]], key: str) -> None:
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
        axes.text(value * 1.2, row, f"{value:.3g}", va="center", fontsize=7)


write_comparison_png = to_png(plot_comparison)
