"""Figure 4: of four midpoint pairs, the steadiest belongs to the static corners."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Wedge
from matplotlib.ticker import MaxNLocator

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.planes import PlaneMapper
from relmap.planes.scans.corners import deviations, midpoint_pairs
from relmap.planes.walls.history import PlaneHistory
from relmap.plots.sheet import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    RED,
    SAND,
    blank,
    draw_limits,
    finish,
    legend_below,
    limits_of,
)
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import simulate_building
from relmap.simulation.sensor import DEPTH_SENSOR

SENSOR = DEPTH_SENSOR
SIGMA_M = 0.02
QUICK_ITERATIONS = 60
OFTEN, MOSTLY = 0.95, 0.5
"""Fractions of pairs of walls for which the claim must hold, to be borne out and partly so."""
SIDES = ("right", "left")
SHORTEST = 12
"""Iterations of the shortest common interval that is tested."""
STEADY_M = 0.01
"""Deviations below this count as zero."""
SKEW = np.deg2rad(30.0)
"""Smallest angle between the walls shown: for nearly parallel ones a shift is undetermined."""
GREEN, BROWN, VIOLET = "#0b7a3b", "#8c564b", "#7b4fa3"
MARGIN_M = 0.8
RING: dict[str, Any] = {"linestyle": "", "markersize": 8, "markerfacecolor": "none", "zorder": 5.0}
PAIRS = ("first_wall", "second_wall", "iterations", "chosen_first", "chosen_second",
         "static_first", "static_second", "right")  # fmt: skip
SHIFTS = ("iteration", "first_end", "second_end", "dx", "dy", "deviation", "chosen")


@dataclass(frozen=True, eq=False)
class CornerTest:
    """Two walls over an interval in which each is seen with one static end and one cut one.

    `planes`: numbers of the two walls; `iterations` (k,); `ends` (2, k, 2, 2), robot frame, metres:
    right and left end of each wall as observed; `static`: the static end of each wall by its type
    in each scan: 0 right, 1 left.
    """

    planes: tuple[int, int]
    iterations: Ints
    ends: Floats
    static: tuple[int, int]

    @property
    def lengths(self) -> Floats:
        """Visible length of each wall in each iteration, (2, k), metres."""
        return np.asarray(np.linalg.norm(self.ends[:, :, 1] - self.ends[:, :, 0], axis=2))

    @property
    def sizes(self) -> Floats:
        """Size of each wall, fixed over the interval: the largest seen in it, (2,), metres."""
        return np.asarray(self.lengths.max(axis=1))

    @cached_property
    def offsets(self) -> Floats:
        """See `relmap.planes.scans.corners.midpoint_pairs`, (k, 2, 2, 2), metres."""
        return midpoint_pairs(self.ends[0], self.ends[1], *self.sizes.tolist())

    @property
    def deviation(self) -> Floats:
        """Standard deviation of each pair's offset over the interval, (2, 2), metres."""
        return deviations(self.offsets)

    @property
    def chosen(self) -> tuple[int, int]:
        """The ends whose pair has the lowest deviation."""
        i, j = np.unravel_index(np.argmin(self.deviation), (2, 2))
        return int(i), int(j)

    @property
    def skew(self) -> float:
        """How far from parallel the walls are, radians."""
        (x, y), (u, v) = np.moveaxis(self.ends[:, :, 1] - self.ends[:, :, 0], -1, 1)
        sines = np.abs(x * v - y * u) / (np.hypot(x, y) * np.hypot(u, v))
        return float(np.arcsin(np.clip(np.median(sines), 0, 1)))


def corner_tests(history: PlaneHistory) -> list[CornerTest]:
    """Return all pairs of walls of a run that are seen for long with one cut end each."""
    tests = []
    for (plane, side, rows), (other, other_side, other_rows) in combinations(_cut(history), 2):
        _, i, j = np.intersect1d(
            history.iteration[rows], history.iteration[other_rows], return_indices=True
        )
        if plane == other or len(i) < SHORTEST:
            continue
        ends = np.stack([history.ends[rows[i]], history.ends[other_rows[j]]])
        iterations = history.iteration[rows[i]]
        tests.append(CornerTest((plane, other), iterations, ends, (side, other_side)))
    return tests


def _cut(history: PlaneHistory) -> Iterator[tuple[int, int, Ints]]:
    """Yield wall, static end and rows of each run of scans that show a wall with only that end."""
    for plane in np.unique(history.plane).tolist():
        rows = np.flatnonzero(history.plane == plane)
        static = history.corner[rows] >= 0
        side = np.where(static.sum(axis=1) == 1, static.argmax(axis=1), -1)
        breaks = (np.diff(side) != 0) | (np.diff(history.iteration[rows]) != 1)
        for run in np.split(np.arange(len(rows)), np.flatnonzero(breaks) + 1):
            if side[run[0]] >= 0 and len(run) >= SHORTEST:
                yield plane, int(side[run[0]]), rows[run]


def _run(quick: bool, data: Path | None, watch: Watch) -> list[CornerTest]:
    building = simulate_building(sigma=SIGMA_M, iterations=QUICK_ITERATIONS if quick else None)
    segmenter = PlaneSegmenter(view_rad=SENSOR.view_rad, range_m=SENSOR.range_m)
    mapper = PlaneMapper(segmenter=segmenter)
    for scan in watch(building.scans):
        mapper.update(scan.points)
    return corner_tests(mapper.history)


def _judge(tests: list[CornerTest]) -> Outcome:
    shown = _clearest(tests)
    shifts = [
        (int(k), SIDES[i], SIDES[j], float(dx), float(dy),
         float(shown.deviation[i, j]), int((i, j) == shown.chosen))
        for i, j in np.ndindex(2, 2)
        for k, (dx, dy) in zip(shown.iterations, shown.offsets[:, i, j], strict=True)
    ]  # fmt: skip
    pairs = [
        (*test.planes, len(test.iterations), *map(SIDES.__getitem__, (*test.chosen, *test.static)),
         int(test.chosen == test.static))
        for test in tests
    ]  # fmt: skip
    share = float(np.mean([test.chosen == test.static for test in tests]))
    return Outcome(
        Table(SHIFTS, shifts),
        share,
        f"In {share:.0%} of {len(tests)} pairs of walls that show one real and one cut end each, "
        "the lowest deviation is that of the real corners.",
        judged(share >= OFTEN, share >= MOSTLY),
        {"-pairs.csv": Table(PAIRS, pairs).write},
    )


def _clearest(tests: list[CornerTest]) -> CornerTest:
    """Return the pair of walls, not parallel, whose second lowest deviation stands out most."""

    def clearness(test: CornerTest) -> float:
        lowest, second = np.sort(test.deviation, axis=None)[:2]
        return float(second / max(lowest, STEADY_M))

    possible = [test for test in tests if test.skew > SKEW]
    if not possible:
        raise RelmapError(
            f"no two walls are seen with one cut end each for {SHORTEST} scans: map a longer run"
        )
    return max(possible, key=clearness)


def _plot(tests: list[CornerTest]) -> Figure:
    """Draw a scan with its midpoints, the four pairs and their shifts, in the paper's colours."""
    test = _clearest(tests)
    figure = blank(14.0, 4.8)
    seen, pairs, shifts = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.15])
    k = _shown(test)
    ends, size = test.ends[:, k], test.sizes[:, None]
    along = (ends[:, 1] - ends[:, 0]) / test.lengths[:, k, None]
    midpoints = np.stack([ends[:, 0] + size / 2 * along, ends[:, 1] - size / 2 * along], axis=1)
    far = ends[[0, 1], test.static] + np.array([[1.0], [-1.0]])[list(test.static)] * size * along
    half = np.rad2deg(SENSOR.view_rad / 2)
    for axes in (seen, pairs):
        axes.add_patch(Wedge((0, 0), SENSOR.range_m, -half, half, color=SAND, alpha=0.45, zorder=0))
        axes.plot(0, 0, ">", color=INK, markersize=9, zorder=4)
        _draw_walls(axes, test, ends, far)
        axes.plot(*midpoints.reshape(-1, 2).T, "o", color=RED, label="estimated midpoint", **RING)
        places = np.concatenate([np.zeros((1, 2)), *ends, *midpoints, far])
        draw_limits(axes, limits_of(places, places, MARGIN_M))
    seen.plot(*ends.reshape(-1, 2).T, "o", color=BLUE, label="observed corner point", **RING)
    seen.plot([], [], ">", color=INK, label="robot and its field of view")
    seen.plot([], [], "--", color=INK, label="size, fixed over the interval")
    of = f"iteration {test.iterations[k]}: midpoints from either end"
    finish(seen, of, "x, robot frame [m]", "y, robot frame [m]")
    _draw_pairs(pairs, test, midpoints)
    _draw_shifts(shifts, test)
    legend_below(figure, 4, seen, pairs)
    figure.suptitle(
        f"Figure 4: the static corners of walls {test.planes[0]} and {test.planes[1]}, "
        f"seen together in iterations {test.iterations[0]} to {test.iterations[-1]}"
    )
    return figure


def _shown(test: CornerTest) -> int:
    """Return the iteration in which midpoints and ends of both walls lie farthest apart."""
    seen, size = test.lengths, test.sizes[:, None]
    return int(np.minimum(abs(size - seen), abs(size / 2 - seen)).min(axis=0).argmax())


def _draw_walls(axes: Axes, test: CornerTest, walls: Floats, far: Floats) -> None:
    """Draw walls (2, 2, 2) as observed, dashed up to where their sizes reach, (2, 2)."""
    for plane, fixed, ends, end in zip(test.planes, test.static, walls, far, strict=True):
        axes.plot(*np.stack([ends[fixed], end]).T, "--", color=INK, linewidth=1, zorder=2)
        axes.plot(*ends.T, color=INK, linewidth=2.5, zorder=2)
        x, y = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        at = ends.mean(axis=0) + 0.45 * np.array([y, -x])
        axes.annotate(str(plane), at, ha="center", va="center", color=INK)


def _colours(test: CornerTest) -> dict[tuple[int, int], str]:
    others = iter((ORANGE, BROWN, VIOLET))
    return {(i, j): GREEN if (i, j) == test.chosen else next(others) for i, j in np.ndindex(2, 2)}


def _named(pair: tuple[int, int]) -> str:
    return f"{SIDES[pair[0]]}–{SIDES[pair[1]]}"


def _draw_pairs(axes: Axes, test: CornerTest, midpoints: Floats) -> None:
    for (i, j), colour in _colours(test).items():
        width = 3.0 if (i, j) == test.chosen else 1.2
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": width}
        arrow |= {"shrinkA": 4, "shrinkB": 4}
        axes.annotate("", midpoints[1, j], midpoints[0, i], arrowprops=arrow, zorder=6)
        axes.plot([], [], color=colour, linewidth=width, label=f"from the ends {_named((i, j))}")
    finish(axes, "the four midpoint pairs", "x, robot frame [m]", "y, robot frame [m]")


def _draw_shifts(axes: Axes, test: CornerTest) -> None:
    """Draw the deviation of each pair's offset from its mean in each iteration."""
    off = np.linalg.norm(test.offsets - test.offsets.mean(axis=0), axis=3)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    for (i, j), colour in _colours(test).items():
        chosen = (i, j) == test.chosen
        metres = test.deviation[i, j]
        length = f"{metres:.0e} m" if metres < 1e-6 else f"{metres:.3f} m"
        label = f"{_named((i, j))}: {length}" + (", static" if chosen else "")
        style: dict[str, Any] = {"color": colour, "linewidth": 2.5 if chosen else 1.2}
        axes.plot(test.iterations, off[:, i, j], ".-", label=label, **style)
    axes.axhline(0, color=GREY, linewidth=0.8)
    right = "as" if test.chosen == test.static else "unlike what"
    title = f"lowest deviation: {_named(test.chosen)}, {right} the end types say"
    finish(axes, title, "iteration", "offset of the pair from its mean [m]")
    axes.legend(fontsize=8, title="standard deviation", title_fontsize=8, loc="best")


FIGURE = PaperFigure(
    name="4",
    title="which corners of partly seen walls are real",
    unit="share of the pairs of walls with the static corners chosen",
    claim=(
        "Of the four pairs of midpoints estimated from either end of two partly seen walls, the "
        "one whose distance deviates least over time belongs to the static corners."
    ),
    criterion=(
        f"the pair of lowest deviation is that of the static corners, by the types of the ends, "
        f"for {OFTEN:.0%} of the pairs of walls; partly for {MOSTLY:.0%}"
    ),
    run=_run,
    judge=_judge,
    draw=_plot,
)
