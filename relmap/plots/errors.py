"""Errors of the landmarks of a map, as enlarged arrows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from relmap.core.arrays import Floats
from relmap.evaluation.landmarks import Overlay
from relmap.io.results import Result
from relmap.plots.path import broken_at_gaps, broken_at_jumps
from relmap.plots.sheet import BLUE, GREY, ORANGE, RED, Sheet, to_png

USUAL, LONGEST = 0.04, 0.12
"""Length of a typical arrow and of the longest, as fractions of the extent of the picture."""
STEPS = (1.0, 2.0, 5.0)


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
    sheet = Sheet(truth.landmarks_map, way, result.planar)
    true = truth.errors_map[:, 1]
    arrow = scale * (truth.errors_map[:, 0] - true)
    length, most = np.linalg.norm(arrow, axis=1), LONGEST * _extent(truth.landmarks_map)
    beyond = length > most
    arrow[beyond] *= (most / length[beyond])[:, None]
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
    sheet.finish(title)
    return sheet.figure


def _extent(places: Floats) -> float:
    return float(np.ptp(places, axis=0).max()) if len(places) else 0.0


write_errors_png = to_png(plot_errors)
