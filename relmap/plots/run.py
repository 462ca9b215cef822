"""The picture of a run: the map from above and from the side, the path, the truth if known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import LandmarkMap
from relmap.evaluation.landmarks import Overlay
from relmap.io.results import Result
from relmap.plots.path import broken_at_gaps, broken_at_jumps
from relmap.plots.planes import draw_walls
from relmap.plots.sheet import BLUE, INK, RED, Sheet, first_of, note_empty

GROUP = "#7f7f7f"
ODOMETRY = "#8e44ad"
WEAK_COLOUR = "#e67e22"
WEAK = 2.0
"""Residual, relative to its expectation from noise, above which a place is marked."""
ROUNDING_M = 1e-9
"""Noise below which residuals are rounding errors, and no place is marked."""
MOST_LINKS = 6000
"""Maximum number of links between groups and members; with more, a subset of groups is drawn."""


def plot_run(
    result: Result,
    groups: Sequence[Ints] = (),
    truth: Overlay | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the map of a run from above and, where it is not planar, from the side.

    `groups`, sequence of (g,): labels of the landmarks of each group; drawn as links from its
    centre to its members. `title`: by default the counts.
    """
    positions = result.landmarks.position[result.mapped]
    places, way = positions, result.poses[:, :3, 3]
    if truth is not None:
        places = np.concatenate([places, truth.landmarks_map])
        way = np.concatenate([way, truth.path_map])
    sheet = Sheet(places, way, result.planar)
    for axes, pair in sheet.views:
        _draw_groups(axes, result, groups, pair)
        if truth is not None:
            _draw_truth(axes, truth, pair)
        _draw_path(axes, result, pair)
        _draw_weak_places(axes, result, pair)
        dots = _draw_landmarks(axes, result, pair)
    if dots is not None:
        sheet.add_colours(dots, "standard deviation of a landmark [m]")
    mapped, known = len(positions), len(result.landmarks.landmark)
    if not mapped:
        note_empty(sheet.views[0][0])
    which = first_of(len(result.submaps))
    return sheet.finish(title or f"{which}{mapped} of {known} landmarks mapped")


def _marker_area(n: int) -> float:
    """Return the area of each of n dots, points squared."""
    return float(np.clip(6000 / max(n, 1), 2.0, 28.0))


def _draw_landmarks(axes: Axes, result: Result, pair: list[int]) -> Any:
    """Draw the mapped landmarks; return the colour scale, if any."""
    table = result.landmarks
    area = _marker_area(int(result.mapped.sum()))
    static = result.mapped & (table.status != "dynamic")
    known = static & np.isfinite(table.sd) & (table.sd > 0)
    style: dict[str, Any] = {"s": area, "linewidths": 0, "zorder": 6}
    cross = style | {"c": "#d81b60", "marker": "x", "linewidths": 1.0, "s": area + 6}
    for of, label, how in (
        (static & ~known, "landmark", style | {"c": "black"}),
        (result.mapped & ~static, "dynamic landmark", cross),
    ):
        if of.any():
            axes.scatter(*table.position[of][:, pair].T, label=label, **how)
    if not known.any():
        return None
    sd = table.sd[known]
    norm = LogNorm(sd.min(), sd.max()) if sd.max() > 1.2 * sd.min() else None
    x, y = table.position[known][:, pair].T
    return axes.scatter(x, y, c=sd, norm=norm, label="landmark", **style)


def _draw_path(axes: Axes, result: Result, pair: list[int]) -> None:
    position = result.poses[:, :3, 3][:, pair]
    if not len(position):
        return
    whole = broken_at_gaps(result.stamps_s, position)
    axes.plot(*whole.T, color=BLUE, linewidth=1.4, zorder=7, label="path of the robot")
    alone = on_odometry_alone(result)
    if len(alone):
        steps = position[np.column_stack([alone - 1, alone])]
        lines: dict[str, Any] = {"colors": ODOMETRY, "linewidths": 2.2, "zorder": 7}
        label = "linked by odometry alone"
        axes.add_collection(LineCollection(list(steps), label=label, **lines))
    style: dict[str, Any] = {"color": BLUE, "markersize": 6, "zorder": 8, "linestyle": ""}
    axes.plot(*position[0], "o", label="start", **style)
    axes.plot(*position[-1], "s", label="end", **style)


def on_odometry_alone(result: Result) -> Ints:
    """Return the rows (k,) of poses that only odometry ties to the previous one, if known."""
    odometry = result.summary.get("odometry")
    if odometry is None or result.iterations is None:
        return np.empty(0, dtype=np.int64)
    stretches = [np.arange(a, b + 1) for a, b in odometry["tied_by_it_alone"]["stretches"]]
    alone = np.isin(result.iterations, np.concatenate([[-1], *stretches]))
    alone[1:] &= np.diff(result.iterations) == 1
    return np.flatnonzero(alone[1:]) + 1


def _draw_groups(axes: Axes, result: Result, groups: Sequence[Ints], pair: list[int]) -> None:
    mapped, table = result.mapped, result.landmarks
    at = table.position[mapped][:, pair]
    place = dict(zip(table.landmark[mapped].tolist(), at, strict=True))
    links: list[Floats] = []
    every = max(1, math.ceil(sum(map(len, groups)) / MOST_LINKS))
    for group in groups[::every]:
        members = np.array([place[label] for label in group.tolist() if label in place])
        if len(members):
            middle = members.mean(axis=0)
            links.extend(np.array([middle, member]) for member in members)
    if links:
        alpha = float(np.clip(200 / len(links), 0.04, 0.35))
        style: dict[str, Any] = {"colors": GROUP, "linewidths": 0.6, "alpha": alpha, "zorder": 1}
        axes.add_collection(LineCollection(links, **style))
        label = "group, from its centre to its members"
        label += f" (one of {every} shown)" if every > 1 else ""
        axes.plot([], [], color=GROUP, linewidth=0.8, label=label)


def _draw_weak_places(axes: Axes, result: Result, pair: list[int]) -> None:
    """Mark the segments and merges with residuals much larger than noise explains."""
    for (label, places), marker in zip(weak_places(result).items(), "oD", strict=True):
        if len(places):
            x, y = places[:, pair].T
            style: dict[str, Any] = {"s": 130, "facecolors": "none", "edgecolors": WEAK_COLOUR}
            axes.scatter(x, y, marker=marker, linewidths=1.4, zorder=7, label=label, **style)


def weak_places(result: Result) -> dict[str, Floats]:
    """Return positions (n, 3) with residuals much larger than noise explains, by kind."""
    refinement = result.summary.get("refinement") or {}
    if refinement.get("noise_m", 1.0) < ROUNDING_M:
        refinement = {}
    segments, merges = (
        [place for place in refinement.get(kind, ()) if place["residual"] > WEAK]
        for kind in ("weakest_segments", "weakest_merges")
    )
    place_of = dict(zip(result.landmarks.landmark.tolist(), result.landmarks.position, strict=True))
    found = {
        "segment with large residuals": [[*place["middle"], 0.0][:3] for place in segments],
        "doubtful merge": [place_of[merge["landmark"]] for merge in merges],
    }
    return {kind: np.array(places).reshape(-1, 3) for kind, places in found.items()}


def _draw_truth(axes: Axes, truth: Overlay, pair: list[int]) -> None:
    area = _marker_area(len(truth.landmarks_map))
    rings: dict[str, Any] = {
        "s": 2.5 * area + min(12.0, area / 2),
        "facecolors": "none",
        "edgecolors": RED,
    }
    x, y = truth.landmarks_map[:, pair].T
    axes.scatter(x, y, linewidths=0.2 + area / 56, label="true landmark", zorder=5, **rings)
    lines = list(truth.errors_map[:, :, pair])
    axes.add_collection(LineCollection(lines, colors=RED, linewidths=0.7, zorder=5))
    if len(truth.path_map):
        path = broken_at_jumps(truth.path_map)[:, pair]
        axes.plot(*path.T, "--", color=RED, linewidth=0.8, zorder=2, label="true path")


def plot_localised(
    landmarks: LandmarkMap,
    planar: bool,
    scan: Ints,
    poses: Floats,
    n_scans: int,
    ends: Floats | None = None,
) -> Figure:
    """Draw a map and the localised scans; the path is interrupted at scans not found.

    `planar`: whether the view from above suffices; `scan` (k,), ascending: the localised scans of
    the log; `poses` (k, 4, 4): ``T_map_robot`` of these; `n_scans`: number of scans of the log;
    `ends` (w, 2, 2): walls of the map, drawn instead of the landmarks.
    """
    at, places, what = poses[:, :3, 3], landmarks.positions, f"{len(landmarks)} landmarks"
    if ends is not None:
        places, what = np.zeros((2 * len(ends), 3)), f"{len(ends)} walls"
        places[:, :2] = ends.reshape(-1, 2)
    sheet = Sheet(places, at, planar)
    for axes, pair in sheet.views:
        if ends is not None:
            draw_walls(axes, ends, colour=INK, width=0.8)
        else:
            axes.plot(*places[:, pair].T, ".", color=INK, markersize=4, label="landmark")
        path = broken_at_gaps(scan.astype(np.float64), at)[:, pair]
        style: dict[str, Any] = {"color": BLUE, "markersize": 2.5, "linewidth": 0.7}
        axes.plot(*path.T, ".-", label="localised scan", **style)
    return sheet.finish(f"{len(scan)} of {n_scans} scans localised in a map of {what}")
