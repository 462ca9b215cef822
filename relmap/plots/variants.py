"""Maps of planes and of points from the same scans, side by side over the true walls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.core.arrays import Floats
from relmap.evaluation.surface_points import METHODS, SurfacePoints, VariantRun, map_of
from relmap.evaluation.truth import Truth
from relmap.io.results import Result
from relmap.planes.walls.files import PlaneResult
from relmap.plots.path import broken_at_gaps, fit_to_truth
from relmap.plots.planes import WALL, draw_true_walls, draw_walls
from relmap.plots.sheet import GREY, blank, draw_limits, finish, limits_of, note_empty


@dataclass(frozen=True, eq=False)
class PlacedMap:
    """A map in the frame of the truth, metres.

    `shapes` (m, 2, 2) or (m, 2): mapped walls, or mapped points from above; `path` (k, 2): NaN if
    unknown.
    """

    run: VariantRun
    shapes: Floats
    path: Floats

    @property
    def said(self) -> str:
        """Summary of its quality."""
        run, what = self.run, "corner" if self.run.method == "planes" else "point"
        covered = f"{run.coverage:.0%} of the {what}s mapped"
        if run.map_rmse_m is None:
            return covered
        in_sigma = f" = {run.map_rmse_m / run.sigma:.2f} sigma" if run.sigma > 0 else ""
        return f"{what} RMSE {run.map_rmse_m:.3f} m{in_sigma}, {covered}"


@dataclass(frozen=True, eq=False)
class BothMaps:
    """The maps of planes and of points over the true walls (w, 2, 2)."""

    planes: PlacedMap
    points: PlacedMap
    true_walls: Floats


def plot_both(maps: BothMaps, title: str) -> Figure:
    """Draw the map of planes, and that of points, over the true walls."""
    limits = limits_of(maps.true_walls.reshape(-1, 2), np.empty((0, 2)), 1.0)
    width, height = limits[1] - limits[0]
    scale = min(6.2 / width, 7.0 / height)
    figure = blank(2 * scale * width + 1.6, scale * height + 1.9)
    planes, points = figure.subplots(1, 2, sharey=True)
    for axes, each in ((planes, maps.planes), (points, maps.points)):
        draw_true_walls(axes, maps.true_walls)
        draw_limits(axes, limits)
        if axes is planes or len(each.shapes):
            axes.plot(*each.path.T, color=GREY, linewidth=0.9, zorder=2, label="path from the map")
    draw_walls(planes, maps.planes.shapes)
    finish(planes, f"planes: {maps.planes.said}", "x [m]", "y [m]")
    _draw_points(points, maps.points.shapes)
    finish(points, f"points: {maps.points.said}", "x [m]", "")
    style: dict[str, Any] = {"fontsize": 8, "frameon": False, "bbox_to_anchor": (0.5, -0.1)}
    for axes in (planes, points):
        axes.legend(ncols=4, loc="upper center", **style)
    figure.suptitle(title)
    return figure


def both_maps(seen: SurfacePoints) -> BothMaps:
    """Map the same scans as planes, and as points without ids."""
    truth = seen.walls_truth
    planes, points = (_placed(*map_of(method, seen), truth) for method in METHODS[:2])
    return BothMaps(planes, points, truth.ends)


def _placed(result: Result, run: VariantRun, truth: Truth) -> PlacedMap:
    """Transform a map into the frame of the truth."""
    if isinstance(result, PlaneResult):
        shapes = result.planes.ends[result.planes.status == "static"]
    else:
        shapes = result.landmarks.position[result.mapped, :2]
    motion = fit_to_truth(result.stamps_s, result.poses, truth)
    if motion is None:
        return PlacedMap(run, shapes, np.empty((0, 2)))
    R, t = motion
    path = broken_at_gaps(result.stamps_s, result.poses[:, :2, 3] @ R.T + t)
    return PlacedMap(run, shapes @ R.T + t, path)


def _draw_points(axes: Axes, points: Floats) -> None:
    if len(points):
        axes.plot(*points.T, ".", color=WALL, markersize=1.5, label="mapped point")
        return
    note_empty(axes, "no map: no point is observed\noften enough to be mapped")
