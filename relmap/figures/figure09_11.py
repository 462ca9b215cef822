"""Figures 9 to 11: the point chart, sorted, and the group grown in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from relmap.core.arrays import Ints
from relmap.core.errors import RelmapError
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.figures.point_chart import (
    ChartedRun,
    ChartPicture,
    chart_picture,
    charted_run,
    paper_stops,
    shown_chart,
)
from relmap.plots.sheet import BLUE, ORANGE, RED, blank, finish

RIGHT, MOSTLY = 0.99, 0.9
LARGEST, NEARLY = 0.99, 0.9
NOT_SEEN, SEEN, SEED, SEED_INTERVAL, AREA = "#ffffff", "#5f6670", "#d9822b", "#fbe9cf", BLUE


def _judge_chart(data: tuple[ChartPicture, ChartedRun]) -> Outcome:
    chart, run = data
    right = float(np.mean(run.truly_visible(chart) == chart.visible))
    return Outcome(
        _cells(chart, np.argsort(chart.landmarks)),
        right,
        f"The chart around landmark {chart.seed} has {len(chart.landmarks)} landmarks and "
        f"{chart.visible.sum()} observations over {chart.visible.shape[1]} iterations; "
        f"{right:.2%} of its cells are right.",
        judged(right >= RIGHT, right >= MOSTLY),
    )


def _judge_sorted(chart: ChartPicture) -> Outcome:
    shared = chart.common_interval
    falls = bool(np.all(np.diff(shared) <= 0))
    inside, outside = shared[: chart.members], shared[chart.members :]
    below = f", those below {np.median(outside):g}" if len(outside) else ""
    return Outcome(
        _cells(chart, np.arange(len(shared))),
        float(np.median(inside)),
        f"Members of the group of landmark {chart.seed} share {np.median(inside):g} of its "
        f"{chart.visible[0].sum()} iterations (median){below}. "
        f"The number of shared ones {'never' if falls else 'sometimes'} rises down the chart.",
        judged(falls),
    )


def _run_groups(quick: bool, data: Path | None, watch: Watch) -> list[ChartPicture]:
    """Return the displayed chart, and those of all landmarks that come, go and form a group."""
    run, charts = charted_run(quick), [shown_chart(quick)]
    for seed, begin, end in watch(run.visits):
        try:
            charts.append(chart_picture(run.store, seed, begin, end))
        except RelmapError:  # it was not seen with three others
            continue
    return charts


def _judge_groups(charts: list[ChartPicture]) -> Outcome:
    shown, charts = charts[0], charts[1:]
    sizes = [(paper_stops(chart.area), chart.members) for chart in charts]
    seeds = [
        (chart.seed, stop, int(chart.area[stop - 1]), members, int(chart.area[members - 1]))
        for chart, (stop, members) in zip(charts, sizes, strict=True)
    ]
    areas = np.array([(row[2], row[4]) for row in seeds], dtype=np.float64)
    share = float(np.mean(areas[:, 0] / areas[:, 1]))
    early = float(np.mean(areas[:, 0] < areas[:, 1]))
    numbered = zip(shown.landmarks, shown.common_interval, shown.area, strict=True)
    rows = [(row, *values, int(row < shown.members)) for row, values in enumerate(numbered)]
    columns = ("seed", "rule_members", "rule_area", "largest_members", "largest_area")
    return Outcome(
        Table(("row", "landmark", "common_interval", "area", "member"), rows),
        share,
        f"Landmark {shown.seed} grows a group of {shown.members} landmarks x "
        f"{shown.group_interval.sum()} iterations. Over {len(charts)} landmarks the paper's rule "
        f"reaches {share:.0%} of the largest area on average and stops too early in {early:.0%} of "
        "the charts; so relmap takes the largest area of the whole chart.",
        judged(share >= LARGEST, share >= NEARLY),
        {"-seeds.csv": Table(columns, seeds).write},
    )


def _cells(chart: ChartPicture, order: Ints) -> Table:
    """Return a row per observation in the chart, with its rows in the given order."""
    row, column = np.nonzero(chart.visible[order])
    within = chart.visible[0, column].astype(int)
    columns = [row, chart.landmarks[order][row], chart.begin + column, within]
    return Table(
        ("row", "landmark", "iteration", "in_seed_interval"), np.column_stack(columns).tolist()
    )


def _plot_unsorted(data: tuple[ChartPicture, ChartedRun]) -> Figure:
    """Draw which landmark was visible when, in the order of numbers (Fig. 9)."""
    chart, _ = data
    order = np.argsort(chart.landmarks)
    cells = chart.visible.astype(int)
    cells[0] *= 2
    figure = _blank(chart, 8.0)
    title = f"Figure 9: the point chart around landmark {chart.seed}, in order of first sight"
    _draw(figure.subplots(), chart, cells[order], order, title)
    _legend(figure, chart)
    return figure


def _plot_sorted(chart: ChartPicture) -> Figure:
    """Draw the chart sorted by common interval, that of the seed shaded (Fig. 10)."""
    figure = _blank(chart, 8.0)
    axes = figure.subplots()
    title = f"Figure 10: sorted by the iterations shared with landmark {chart.seed}"
    rows = np.arange(len(chart.landmarks))
    _draw(axes, chart, _sorted_cells(chart), rows, title)
    beside = axes.secondary_yaxis("right")
    beside.set_yticks(rows, chart.common_interval.tolist(), fontsize=7)
    beside.tick_params(length=0)
    beside.set_ylabel(f"iterations in common with landmark {chart.seed}")
    _legend(figure, chart, {"its observation interval": SEED_INTERVAL})
    return figure


def _plot_group(charts: list[ChartPicture]) -> Figure:
    """Draw the group grown down the sorted chart, and how its area changes (Fig. 11)."""
    chart = charts[0]
    figure = _blank(chart, 9.6)
    axes, beside = figure.subplots(1, 2, sharey=True, width_ratios=[3.0, 1.0])
    cells = _sorted_cells(chart)
    cells[: chart.members, chart.group_interval] = 4
    iterations = int(chart.group_interval.sum())
    group = f"{chart.members} members x {iterations} iterations"
    title = f"Figure 11: the group of landmark {chart.seed}: {group}"
    _draw(axes, chart, cells, np.arange(len(cells)), title)
    _draw_area(beside, chart)
    of_group = {"its observation interval": SEED_INTERVAL, "members x common interval": AREA}
    _legend(figure, chart, of_group)
    return figure


def _blank(chart: ChartPicture, width_in: float) -> Figure:
    return blank(width_in, 1.5 + 0.14 * max(len(chart.landmarks), 15))


def _sorted_cells(chart: ChartPicture) -> Ints:
    """Return the colour index of each cell (n, i)."""
    cells = np.where(chart.visible, 1, np.where(chart.visible[0], 3, 0))
    cells[0, chart.visible[0]] = 2
    return cells


def _draw(axes: Axes, chart: ChartPicture, cells: Ints, rows: Ints, title: str) -> None:
    n, i = cells.shape
    colours = ListedColormap([NOT_SEEN, SEEN, SEED, SEED_INTERVAL, AREA])
    columns = chart.begin - 0.5 + np.arange(i + 1)
    axes.pcolormesh(columns, np.arange(n + 1) - 0.5, cells, cmap=colours, vmin=0, vmax=4)
    finish(axes, title, "iteration", "landmark")
    axes.hlines(np.arange(1, n) - 0.5, columns[0], columns[-1], color="white", linewidth=0.8)
    axes.grid(visible=False)
    axes.set_yticks(np.arange(n), chart.landmarks[rows].tolist(), fontsize=7)
    axes.get_yticklabels()[rows.tolist().index(0)].set(color=ORANGE, fontweight="bold")
    axes.invert_yaxis()


def _draw_area(axes: Axes, chart: ChartPicture) -> None:
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


def _legend(figure: Figure, chart: ChartPicture, more: dict[str, str] | None = None) -> None:
    named = {"visible": SEEN, f"landmark {chart.seed}, the seed": SEED} | (more or {})
    patches = [Patch(facecolor=c, edgecolor="#b9b9b9", label=name) for name, c in named.items()]
    style: dict[str, Any] = {"ncols": 4, "frameon": False, "fontsize": 9}
    figure.legend(handles=patches, loc="outside lower center", **style)


CHART = PaperFigure(
    name="9",
    title="the point chart",
    claim="A chart shows for every landmark in which iterations it was visible.",
    criterion=(
        f"without ids, {RIGHT:.0%} of the cells of the chart agree with the simulation; "
        f"partly: {MOSTLY:.0%}"
    ),
    unit="share of the cells that are right",
    run=lambda quick, data, watch: (shown_chart(quick), charted_run(quick)),
    judge=_judge_chart,
    draw=_plot_unsorted,
)
SORTED = PaperFigure(
    name="10",
    title="the chart, sorted",
    claim=(
        "Sorted by the number of iterations shared with one landmark, those that share many are at "
        "the top, and those that were seen rarely or with gaps at the bottom."
    ),
    criterion="the number of shared iterations never rises from one row to the next",
    unit="iterations shared with the seed by the median member of its group",
    run=lambda quick, data, watch: shown_chart(quick),
    judge=_judge_sorted,
    draw=_plot_sorted,
)
GROUP = PaperFigure(
    name="11",
    title="a group grown in the chart",
    claim=(
        "Landmarks are added down the sorted chart, four at least, for as long as members "
        "times common interval grows; so the group has the largest such area."
    ),
    criterion=(
        "over all landmarks that come and go in the run, the area at which the rule stops is "
        f"on average {LARGEST:.0%} of the largest there is down the chart; partly: {NEARLY:.0%}"
    ),
    unit="area at which the paper's rule stops over the largest",
    run=_run_groups,
    judge=_judge_groups,
    draw=_plot_group,
)
FIGURES = (CHART, SORTED, GROUP)
