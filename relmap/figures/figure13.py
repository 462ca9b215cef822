"""Figure 13: the figure eight, and the map that closes over it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from relmap.core.arrays import Floats
from relmap.evaluation.evaluate import Evaluation, evaluate
from relmap.evaluation.landmarks import identify, match_landmarks
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import truth_of
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.plots.path import broken_at_gaps
from relmap.plots.sheet import BLUE, RED, SAND, blank, draw_limits, finish, legend_below, limits_of
from relmap.points.mapper import PointMapper
from relmap.simulation import simulate_figure_eight

SIGMA_M = 0.05
QUICK_DENSITY, DENSITY = 15.0, 25.0
COVERED = 0.95
ONCE = 1.1
STRETCH = 1.6
RIM_M = 10.0


@dataclass(frozen=True, eq=False)
class EightMap:
    """A map of the figure eight, transformed into the frame of the truth.

    `landmarks_map` (m, 3), `path_map` (k, 3), metres: as mapped; the path of the robot is NaN where
    unknown. `true_landmarks_map` (t, 3), `true_path_map` (p, 3), metres.
    """

    landmarks_map: Floats
    path_map: Floats
    true_landmarks_map: Floats
    true_path_map: Floats
    found: Evaluation

    @property
    def rmse_m(self) -> float:
        """RMSE of the landmarks, metres."""
        return self.found.landmark_rmse_m or 0.0


def _run(quick: bool, data: Path | None, watch: Watch) -> EightMap:
    world = simulate_figure_eight(QUICK_DENSITY if quick else DENSITY, sigma=SIGMA_M)
    mapper = PointMapper()
    result = run_mapper(
        mapper, world.log, "nearest", through=lambda scans: watch(list(scans)), refine=True
    ).result
    truth = truth_of(world)
    matched = match_landmarks(result, truth, identify(result, world.log))
    assert matched is not None
    R, t = matched.R, matched.t
    return EightMap(
        result.landmarks.position[result.mapped] @ R.T + t,
        broken_at_gaps(result.stamps_s, result.poses[:, :3, 3] @ R.T + t),
        world.landmarks_map,
        world.trajectory[:, :3, 3],
        evaluate(result, truth, world.log),
    )


def _judge(data: EightMap) -> Outcome:
    places = {
        "mapped landmark": data.landmarks_map,
        "path from the map": data.path_map[np.isfinite(data.path_map[:, 0])],
        "true landmark": data.true_landmarks_map,
        "true path": data.true_path_map,
    }
    rows = [(name, *point) for name, points in places.items() for point in points.tolist()]
    found, covered = data.found, data.found.coverage or 0.0
    per_true = found.landmarks_per_true or np.inf
    return Outcome(
        Table(("what", "x", "y", "z"), rows),
        data.rmse_m,
        f"{len(data.landmarks_map)} landmarks mapped without ids, {covered:.0%} of those seen "
        f"ten times, RMSE {data.rmse_m:.4f} m, {per_true:.3f} landmarks for each true one; the "
        f"path is {'-' if found.ate_m is None else format(found.ate_m, '.3f')} m off.",
        judged(data.rmse_m < SIGMA_M and covered >= COVERED, per_true <= ONCE),
    )


def _plot(data: EightMap) -> Figure:
    """Draw the eight in space, and beside it from above and from the side."""
    figure = blank(12.5, 6.0)
    grid = figure.add_gridspec(2, 3, width_ratios=[1.3, 0.06, 1.0], height_ratios=[1.6, 1.0])
    space: Any = figure.add_subplot(grid[:, 0], projection="3d")
    _draw(space, data, [0, 1, 2])
    low, high = limits_of(data.true_landmarks_map, data.true_path_map, RIM_M)
    space.set_box_aspect((high - low) * [1, 1, STRETCH], zoom=1.25)
    space.view_init(elev=28, azim=-62)
    names = {f"{axis}label": f"{axis} [m]" for axis in "xyz"}
    sides = zip("xyz", low, high, strict=True)
    space.set(**names, **{f"{axis}lim": (least, most) for axis, least, most in sides})
    for axis in (space.xaxis, space.yaxis, space.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    figure.suptitle(
        f"Figure 13: the eight, mapped without ids: {len(data.landmarks_map)} landmarks "
        f"for {len(data.true_landmarks_map)} true ones, RMSE {data.rmse_m:.2g} m",
        fontsize=11,
    )
    space.set_title(f"in space, z stretched {STRETCH} times", fontsize=10)
    for row, across, name in ((0, 1, "from above"), (1, 2, "from the side")):
        axes = figure.add_subplot(grid[row, 2])
        _draw(axes, data, [0, across])
        finish(axes, name, "x [m]", f"{'xyz'[across]} [m]")
        draw_limits(axes, (low[[0, across]], high[[0, across]]))
    legend_below(figure, 4, axes)
    return figure


def _draw(axes: Axes, data: EightMap, pair: list[int]) -> None:
    """Draw map and truth on the axes named by `pair`; three of them are a view in space."""
    places = (data.true_path_map, data.path_map, data.true_landmarks_map, data.landmarks_map)
    true_path, path, true, mapped = (place[:, pair].T for place in places)
    ring: dict[str, Any] = {"markerfacecolor": "none", "markeredgecolor": RED, "markersize": 5}
    axes.plot(*true_path, color=SAND, linewidth=2.5, label="true path")
    axes.plot(*path, color=BLUE, linewidth=1.0, label="path of the robot, from the map")
    axes.plot(*true, "o", markeredgewidth=0.7, label="true landmark", **ring)
    axes.plot(*mapped, ".", color="black", markersize=3.5, label="mapped landmark")


FIGURE = PaperFigure(
    name="13",
    title="the figure eight",
    claim=(
        "The robot climbs and descends along an eight, so that it is back where it was only after "
        "the whole loop; landmarks seen again there are merged, which closes the loop."
    ),
    criterion=(
        f"without ids the map is better than one observation (RMSE below sigma, {SIGMA_M} m) with "
        f"{COVERED:.0%} of the landmarks seen ten times, and it has at most {ONCE:g} landmarks for "
        "each true one; partly where one of the two holds"
    ),
    unit="RMSE of the landmarks in m",
    run=_run,
    judge=_judge,
    draw=_plot,
)
