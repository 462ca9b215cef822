"""A sweep: errors over the varied parameter, with a line per method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.plots.comparison import Figures, plot_comparison
from relmap.plots.sheet import blank, finish, legend_below, to_png, write_in_full

PANELS = {
    "corner_rmse_m": "RMSE of corners [m]",
    "often_rmse_m": "RMSE of landmarks seen ten times [m]",
    "ate_m": "error of the path (ATE) [m]",
}
PANEL_IN = 4.6
MARKERS = "osD^vP*X<>"


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
    """Draw the errors of all experiments as dots, with a line of medians for each name.

    `along`: label of the varied parameter.
    """
    names = list(dict.fromkeys(row.name for row in rows))
    if any(row.at is None for row in rows):
        medians = [(name, _medians([r for r in rows if r.name == name])) for name in names]
        return plot_comparison(medians, "medians over the seeds")
    shown = [key for key in PANELS if any(row.figures.get(key) for row in rows)] or ["ate_m"]
    figure = blank(PANEL_IN * len(shown), PANEL_IN)
    all_axes = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, key in zip(all_axes, shown, strict=True):
        for k, name in enumerate(names):
            _draw(axes, [row for row in rows if row.name == name], key, name, k)
        axes.set_yscale("log")
        write_in_full(axes.yaxis)
        finish(axes, "", along, PANELS[key])
    legend_below(figure, 3 if max(map(len, names)) < 25 else 2, *all_axes)
    return figure


def _draw(axes: Axes, rows: Sequence[SweepRow], key: str, name: str, k: int) -> None:
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


write_sweep_png = to_png(plot_sweep)
