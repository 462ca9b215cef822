"""The point chart as it was seen, as it is sorted, and the group grown in it (Figs 9 to 11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.core.grouping.chart import PointChart
from relmap.core.grouping.growth import grow_group
from relmap.core.state.store import ObservationStore
from relmap.plots.paper import BLUE, ORANGE, RED, blank, finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FEWEST_MEMBERS = 4
"""Landmarks that a group must have, as in section III."""
NOT_SEEN, SEEN, SEED, SEED_INTERVAL, AREA = "#ffffff", "#5f6670", "#d9822b", "#fbe9cf", BLUE


@dataclass(frozen=True, eq=False)
class ChartPicture:
    """A window of the point chart around a seed, and the group grown in it.

    Attributes
    ----------
    seed : int
    begin : int
        First iteration of the window.
    landmarks : (n,) int64, ascending
        All that were visible together with the seed, and the seed.
    visible : (n, i) bool
        One column for each iteration of the window.
    order : (n,) int64
        Rows sorted by the interval they have in common with the seed.
    members : int
        The group is the first so many of `order`.
    """

    seed: int
    begin: int
    landmarks: NDArray[np.int64]
    visible: NDArray[np.bool_]
    order: NDArray[np.int64]
    members: int

    @property
    def seed_interval(self) -> NDArray[np.bool_]:
        """In which iterations of the window the seed was visible; (i,)."""
        return np.asarray(self.visible[self.order[0]])

    @property
    def common_interval(self) -> NDArray[np.int64]:
        """Iterations that each landmark has in common with the seed, in sorted order; (n,)."""
        return np.asarray((self.visible & self.seed_interval).sum(axis=1)[self.order])

    @property
    def group_interval(self) -> NDArray[np.bool_]:
        """In which iterations all members of the group were visible; (i,)."""
        return np.asarray(self.visible[self.order[: self.members]].all(axis=0))

    @property
    def area(self) -> NDArray[np.int64]:
        """Members x common interval of the first 1, 2, ... landmarks in sorted order; (n,)."""
        together = np.logical_and.accumulate(self.visible[self.order], axis=0)
        return np.asarray(np.arange(1, len(together) + 1) * together.sum(axis=1))


def chart_picture(store: ObservationStore, seed: int, begin: int, end: int) -> ChartPicture:
    """Chart the iterations `begin` to `end` around a seed, and grow its group as a map begins.

    Raises
    ------
    RelmapError
        Where the seed was not seen with enough others to be grouped.
    """
    chart = PointChart.around(seed, store, begin, end)
    n = len(chart.landmarks)
    rows, unmapped = np.arange(n), np.zeros(n)
    group = grow_group(chart, rows, unmapped, FEWEST_MEMBERS, 0) if n else None
    if group is None:
        raise RelmapError(f"landmark {seed} makes no group in iterations {begin} to {end - 1}")
    by_number = np.argsort(chart.landmarks)
    landmarks, iterations = store.seen(begin, end)
    charted = np.isin(landmarks, chart.landmarks)
    visible = np.zeros((n, end - begin), dtype=bool)
    row = np.searchsorted(chart.landmarks[by_number], landmarks[charted])
    visible[row, iterations[charted] - begin] = True
    order = np.argsort(by_number)[chart.sorted_by_common_interval(rows, unmapped)]
    return ChartPicture(
        seed, begin, chart.landmarks[by_number], visible, order, members=len(group.rows)
    )


def plot_unsorted(chart: ChartPicture) -> Figure:
    """Draw which landmark was visible when, in the order of their numbers (Fig. 9)."""
    figure = blank(8.0, _height_in(chart))
    axes = figure.subplots()
    cells = chart.visible.astype(int)
    cells[chart.landmarks == chart.seed] *= 2
    title = f"Figure 9: the point chart around landmark {chart.seed}, in order of first sight"
    _draw(axes, chart, cells, np.arange(len(cells)), title)
    _legend(figure, {"visible": SEEN, f"landmark {chart.seed}, the seed": SEED})
    return figure


def plot_sorted(chart: ChartPicture) -> Figure:
    """Draw the chart sorted by common interval, that of the seed shaded (Fig. 10)."""
    figure = blank(8.0, _height_in(chart))
    axes = figure.subplots()
    title = f"Figure 10: sorted by the iterations shared with landmark {chart.seed}"
    _draw(axes, chart, _sorted_cells(chart), chart.order, title)
    _name_common_intervals(axes, chart)
    named = {
        "visible": SEEN,
        f"landmark {chart.seed}, the seed": SEED,
        "its observation interval": SEED_INTERVAL,
    }
    _legend(figure, named)
    return figure


def plot_group(chart: ChartPicture) -> Figure:
    """Draw the group grown down the sorted chart, and how its area changes (Fig. 11)."""
    figure = blank(9.6, _height_in(chart))
    axes, beside = figure.subplots(1, 2, sharey=True, width_ratios=[3.0, 1.0])
    cells = _sorted_cells(chart)
    in_group = np.zeros_like(cells, dtype=bool)
    in_group[: chart.members] = chart.group_interval
    cells[in_group] = 4
    iterations = int(chart.group_interval.sum())
    title = (
        f"Figure 11: the group of landmark {chart.seed}: {chart.members} members "
        f"x {iterations} iterations"
    )
    _draw(axes, chart, cells, chart.order, title)
    _draw_area(beside, chart)
    named = {
        "visible": SEEN,
        f"landmark {chart.seed}, the seed": SEED,
        "its observation interval": SEED_INTERVAL,
        "members x common interval": AREA,
    }
    _legend(figure, named)
    return figure


def _height_in(chart: ChartPicture) -> float:
    return 1.5 + 0.14 * max(len(chart.landmarks), 15)


def _sorted_cells(chart: ChartPicture) -> NDArray[np.int64]:
    """Return what to paint in each cell (n, i): an index of the colours above."""
    cells = np.where(chart.visible[chart.order], 1, np.where(chart.seed_interval, 3, 0))
    cells[0, chart.seed_interval] = 2
    return cells


def _draw(
    axes: Axes,
    chart: ChartPicture,
    cells: NDArray[np.int64],
    rows: NDArray[np.int64],
    title: str,
) -> None:
    from matplotlib.colors import ListedColormap

    n, i = cells.shape
    colours = ListedColormap([NOT_SEEN, SEEN, SEED, SEED_INTERVAL, AREA])
    columns = chart.begin - 0.5 + np.arange(i + 1)
    axes.pcolormesh(columns, np.arange(n + 1) - 0.5, cells, cmap=colours, vmin=0, vmax=4)
    finish(axes, title, "iteration", "landmark")
    axes.hlines(np.arange(1, n) - 0.5, columns[0], columns[-1], color="white", linewidth=0.8)
    axes.grid(visible=False)
    axes.set_yticks(np.arange(n), chart.landmarks[rows].tolist(), fontsize=7)
    seed_row = int(np.flatnonzero(chart.landmarks[rows] == chart.seed)[0])
    axes.get_yticklabels()[seed_row].set(color=ORANGE, fontweight="bold")
    axes.invert_yaxis()


def _name_common_intervals(axes: Axes, chart: ChartPicture) -> None:
    """Write the common interval of each landmark to the right of its row."""
    beside = axes.secondary_yaxis("right")
    beside.set_yticks(np.arange(len(chart.order)), chart.common_interval.tolist(), fontsize=7)
    beside.tick_params(length=0)
    beside.set_ylabel(f"iterations in common with landmark {chart.seed}")


def _draw_area(axes: Axes, chart: ChartPicture) -> None:
    """Draw how the area changes as one landmark after the other is added."""
    n = np.arange(len(chart.area))
    axes.plot(chart.area, n, "o-", color=BLUE, markersize=3, linewidth=1.0)
    last, first_dip = chart.members - 1, paper_stops(chart.area) - 1
    axes.axhspan(-0.5, last + 0.5, color=BLUE, alpha=0.1, linewidth=0)
    axes.plot(chart.area[last], last, "o", color=BLUE, markersize=8, label="largest: taken")
    if first_dip != last:
        hollow: dict[str, Any] = {"markersize": 8, "markerfacecolor": "none", "linestyle": ""}
        label = "the paper's rule stops"
        axes.plot(chart.area[first_dip], first_dip, "s", color=RED, label=label, **hollow)
    finish(axes, "area as members are added", "members x iterations", "")
    axes.set_xlim(left=0)
    axes.tick_params(axis="y", length=0)
    axes.legend(fontsize=8, loc="lower right")


def paper_stops(area: NDArray[np.int64]) -> int:
    """Return how many members the paper's rule takes: up to the first that adds no area.

    Parameters
    ----------
    area : (n,) int64
        Members x common interval of the first 1, 2, ... landmarks.
    """
    falls = np.flatnonzero(np.diff(area[FEWEST_MEMBERS - 1 :]) <= 0)
    return int(falls[0]) + FEWEST_MEMBERS if len(falls) else len(area)


def _legend(figure: Figure, named: dict[str, str]) -> None:
    from matplotlib.patches import Patch

    patches = [Patch(facecolor=c, edgecolor="#b9b9b9", label=name) for name, c in named.items()]
    style: dict[str, Any] = {"ncols": 4, "frameon": False, "fontsize": 9}
    figure.legend(handles=patches, loc="outside lower center", **style)
