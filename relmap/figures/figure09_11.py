"""Figures 9 to 11: the point chart, sorted, and the group grown in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.figures.base import Outcome, Table, Watch, judged, unwatched
from relmap.figures.point_chart import ChartedRun, charted_run, shown_chart
from relmap.plots.chart import (
    FEWEST_MEMBERS,
    ChartPicture,
    chart_picture,
    paper_stops,
    plot_group,
    plot_sorted,
    plot_unsorted,
)

RIGHT, MOSTLY = 0.99, 0.9
LARGEST, NEARLY = 0.99, 0.9
COLUMNS = ("row", "landmark", "iteration", "in_seed_interval")


class ChartFigure:
    """Who was visible when."""

    name = "9"
    title = "the point chart"
    claim = "A chart tells for every landmark in which iterations it was visible."
    criterion = (
        f"without ids, {RIGHT:.0%} of the cells of the chart are as the simulator says; "
        f"partly: {MOSTLY:.0%}"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Chart a run and compare with what was truly visible."""
        return of_chart(shown_chart(quick), charted_run(quick))


class SortedChartFigure:
    """The chart sorted around a landmark."""

    name = "10"
    title = "the chart, sorted"
    claim = (
        "Sorted by the iterations shared with one landmark, those that share many stand high and "
        "those that were seen little or with gaps stand low."
    )
    criterion = "the shared iterations never rise from one row to the next"

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Sort the chart of figure 9."""
        return of_sorted(shown_chart(quick))


class GroupFigure:
    """The group grown down the chart."""

    name = "11"
    title = "a group grown in the chart"
    claim = (
        "Landmarks are added down the sorted chart, four at least, for as long as members times "
        "common interval grows; so the group has the largest such area."
    )
    criterion = (
        "over all landmarks that come and go in the run, the area at which the rule stops is on "
        f"average {LARGEST:.0%} of the largest there is down the chart; partly: {NEARLY:.0%}"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Grow the group of figure 9's landmark, and those of all others."""
        return of_groups(shown_chart(quick), all_charts(charted_run(quick), watch))


def of_chart(chart: ChartPicture, run: ChartedRun) -> Outcome:
    """Judge a chart by what was truly visible."""
    truly = run.truly_visible(chart)
    right = float(np.mean(truly == chart.visible))
    return Outcome(
        lambda: plot_unsorted(chart),
        Table(COLUMNS, visible_rows(chart, np.arange(len(chart.order)))),
        right,
        "share of the cells that are right",
        f"The chart around landmark {chart.seed} has {len(chart.order)} landmarks and "
        f"{chart.visible.sum()} observations over {chart.visible.shape[1]} iterations; "
        f"{right:.2%} of its cells are right.",
        judged(right >= RIGHT, right >= MOSTLY),
    )


def of_sorted(chart: ChartPicture) -> Outcome:
    """Judge a chart by its order."""
    shared = chart.common_interval
    falls = bool(np.all(np.diff(shared) <= 0))
    inside, outside = shared[: chart.members], shared[chart.members :]
    below = f", those below {np.median(outside):g}" if len(outside) else ""
    return Outcome(
        lambda: plot_sorted(chart),
        Table(COLUMNS, visible_rows(chart, chart.order)),
        float(np.median(inside)),
        "iterations shared with the seed by the median member of its group",
        f"Members of the group of landmark {chart.seed} share {np.median(inside):g} of its "
        f"{chart.seed_interval.sum()} iterations (median){below}. "
        f"The shared iterations {'never' if falls else 'do'} rise down the chart: it is sorted so.",
        judged(falls),
    )


def all_charts(run: ChartedRun, watch: Watch) -> list[ChartPicture]:
    """Return the chart of every landmark that comes and goes within the run and makes a group."""
    charts = []
    for seed, begin, end in watch(run.visits):
        try:
            charts.append(chart_picture(run.store, seed, begin, end))
        except RelmapError:  # it was not seen with three others
            continue
    return [chart for chart in charts if len(chart.order) >= FEWEST_MEMBERS]


def of_groups(shown: ChartPicture, charts: list[ChartPicture]) -> Outcome:
    """Judge the paper's rule by the groups of many landmarks."""
    seeds = []
    for chart in charts:
        stops = paper_stops(chart.area)
        seeds.append((chart.seed, stops, int(chart.area[stops - 1]),
                      chart.members, int(chart.area[chart.members - 1])))  # fmt: skip
    areas = np.array([(row[2], row[4]) for row in seeds], dtype=np.float64)
    share = float(np.mean(areas[:, 0] / areas[:, 1]))
    early = float(np.mean(areas[:, 0] < areas[:, 1]))
    numbered = zip(shown.landmarks[shown.order], shown.common_interval, shown.area, strict=True)
    rows = [(row, *values, int(row < shown.members)) for row, values in enumerate(numbered)]
    columns = ("seed", "rule_members", "rule_area", "largest_members", "largest_area")
    return Outcome(
        lambda: plot_group(shown),
        Table(("row", "landmark", "common_interval", "area", "member"), rows),
        share,
        "area at which the paper's rule stops over the largest",
        f"Landmark {shown.seed} grows a group of {shown.members} landmarks x "
        f"{shown.group_interval.sum()} iterations. Over {len(charts)} landmarks the paper's rule "
        f"reaches {share:.0%} of the largest area on average and stops too early in {early:.0%} of "
        "the charts; so relmap takes the largest area of the whole chart.",
        judged(share >= LARGEST, share >= NEARLY),
        {"-seeds.csv": Table(columns, list(seeds)).write},
    )


def visible_rows(chart: ChartPicture, order: NDArray[np.int64]) -> list[tuple[int, ...]]:
    """Return a line per observation in the chart, its rows in the order given."""
    row, column = np.nonzero(chart.visible[order])
    landmark, within = chart.landmarks[order][row], chart.seed_interval[column].astype(int)
    columns = np.column_stack([row, landmark, chart.begin + column, within])
    return [tuple(line) for line in columns.tolist()]
