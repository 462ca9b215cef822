"""The pictures of the paper's figures 9 to 16, from tiny data."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from relmap.core.errors import RelmapError
from relmap.figures import figure09_11, figure12, figure13, figure14_15, figure16
from relmap.figures.figure12 import Comparisons
from relmap.figures.figure14_15 import LoopTiming, fit_n_log_n
from relmap.figures.point_chart import ChartedRun, ChartPicture, chart_picture, paper_stops
from relmap.plots.sheet import write_png
from tests import tinyfigures as tiny
from tests.tinyfigures import SEEN

DRAWN: dict[str, Callable[[], Figure]] = {
    "9": lambda: figure09_11.CHART.draw((tiny.chart(), ChartedRun(tiny.log(), tiny.store()))),
    "10": lambda: figure09_11.SORTED.draw(tiny.chart()),
    "11": lambda: figure09_11.GROUP.draw([tiny.chart()]),
    "12": lambda: figure12.FIGURE.draw(tiny.comparisons()),
    "13": lambda: figure13.FIGURE.draw(tiny.eight()),
    "14": lambda: figure14_15.LOOP.draw(tiny.loop()),
    "15": lambda: figure14_15.VISIBLE.draw(tiny.densities()),
    "16": lambda: figure16.FIGURE.draw(tiny.errors(mine=(0.02, 0.01), theirs=(0.04, 0.05))),
}


def texts(figure: Figure) -> str:
    titles = [axes.get_title() for axes in figure.axes]
    return "\n".join([figure.get_suptitle(), *titles])


def legends(figure: Figure) -> set[str]:
    found = [axes.get_legend() for axes in figure.axes]
    return {
        text.get_text()
        for legend in [*figure.legends, *found]
        if legend is not None
        for text in legend.get_texts()
    }


@pytest.mark.parametrize("number", DRAWN)
def test_every_figure_says_which_it_is_and_names_its_axes(number: str) -> None:
    figure = DRAWN[number]()
    assert f"Figure {number}:" in texts(figure)
    assert legends(figure)
    last: Axes = figure.axes[-1]
    assert last.get_xlabel()


@pytest.mark.parametrize("number", DRAWN)
def test_same_data_same_bytes_whatever_the_style(tmp_path: Path, number: str) -> None:
    write_png(tmp_path / "a.png", DRAWN[number])
    with mpl.rc_context({"axes.facecolor": "black", "savefig.dpi": 50}):
        write_png(tmp_path / "b.png", DRAWN[number])
    content = (tmp_path / "a.png").read_bytes()
    assert content == (tmp_path / "b.png").read_bytes()
    with Image.open(io.BytesIO(content)) as image:
        assert set(image.info) <= {"dpi"}
        assert 300 < min(image.size) <= max(image.size) < 3000


# The point chart.


def test_chart_holds_landmarks_seen_with_the_seed_in_the_window() -> None:
    chart = tiny.chart()
    assert sorted(chart.landmarks.tolist()) == [0, 1, 2, 3, 4, 6]  # 5 is never seen together with 2
    for landmark, row in zip(chart.landmarks.tolist(), chart.visible, strict=True):
        assert np.flatnonzero(row).tolist() == SEEN[landmark]
    assert chart.seed == 2


def test_chart_is_sorted_by_common_interval_and_grouped_by_area() -> None:
    chart = tiny.chart()
    assert chart.landmarks.tolist() == [2, 6, 1, 3, 4, 0]
    assert chart.common_interval.tolist() == [6, 6, 5, 5, 5, 3]
    assert chart.area.tolist() == [6, 12, 15, 16, 20, 12]
    assert chart.members == 5
    assert np.flatnonzero(chart.group_interval).tolist() == [2, 3, 4, 5]


def test_chart_may_begin_anywhere() -> None:
    chart = chart_picture(tiny.store(), 2, 1, 7)
    assert chart.visible.shape == (6, 6)
    assert chart.visible[0].all()


def test_no_group_is_an_error_that_says_so() -> None:
    with pytest.raises(RelmapError, match="landmark 5 makes no group in iterations 0 to 7"):
        chart_picture(tiny.store(), 5, 0, 8)


@pytest.mark.parametrize(
    ("area", "members"),
    [
        ([9, 12, 15, 16, 20, 12], 5),
        ([9, 12, 15, 16, 16, 30], 4),
        ([9, 5, 4, 5, 6, 7], 6),
        ([9, 5, 4, 5], 4),
    ],
)
def test_the_papers_rule_stops_at_the_first_that_adds_nothing(
    area: list[int], members: int
) -> None:
    assert paper_stops(np.array(area)) == members


def test_group_picture_shows_where_the_papers_rule_differs() -> None:
    assert "the paper's rule stops" not in legends(figure09_11.GROUP.draw([tiny.chart()]))
    dips = ChartPicture(0, np.arange(6), np.eye(6, 9, dtype=bool), 6)
    assert "the paper's rule stops" in legends(figure09_11.GROUP.draw([dips]))


# What the curves say.


def test_comparisons_say_how_far_they_stay_within_n_log_n() -> None:
    data = tiny.comparisons()
    assert data.within_n_log_n == 2
    assert "up to 40 % dynamic; beyond" in texts(figure12.FIGURE.draw(data))
    every = Comparisons(data.n, data.dynamic, data.comparisons * 0, data.right)
    assert "up to 70 % dynamic" in texts(figure12.FIGURE.draw(every))
    none = Comparisons(data.n, data.dynamic, data.comparisons * 9, data.right)
    assert "more than n log₂ n for every share" in texts(figure12.FIGURE.draw(none))


def test_a_flat_loop_is_called_flat_and_another_is_not() -> None:
    data = tiny.loop()
    assert data.said.startswith("flat: ")
    assert "median time x 1.00 (per visible landmark x 1.00)" in data.said
    slower = data.time_ms * np.linspace(1, 2, 80)
    grows = LoopTiming(slower, data.visible, data.landmarks, data.true_landmarks)
    assert grows.said.startswith("not flat: ")
    at_the_end = np.where(np.arange(80) % 10 == 0, np.where(np.arange(80) > 50, 50.0, 5.0), 1.0)
    spikes = LoopTiming(at_the_end, data.visible, data.landmarks, data.true_landmarks)
    assert spikes.said.startswith("flat in the median, not in the mean: ")


def test_growth_beyond_n_log_n_is_called_so() -> None:
    assert tiny.densities().said.startswith("within n log n: from 160 to 640 visible")
    assert tiny.densities(power=2).said.startswith("more than n log n")


def test_fit_finds_what_is_there() -> None:
    data = tiny.densities()
    assert fit_n_log_n(data.visible, data.median_ms) == pytest.approx((0.2, 1e-4))


def test_running_median_follows_and_ignores_spikes() -> None:
    lines = {line.get_label(): line for line in DRAWN["14"]().axes[0].get_lines()}
    smooth = np.asarray(lines["running median, 51 iterations"].get_ydata())
    assert smooth.tolist() == [1.0] * 80


def test_errors_of_methods_have_a_panel_for_each_noise() -> None:
    figure = figure16.FIGURE.draw(tiny.errors(mine=(0.02, 0.01), theirs=(0.04, 0.05)))
    assert [axes.get_title() for axes in figure.axes] == [
        "Gaussian noise (median of 3 seeds, each seed thinly)",
        "flat noise (median of 3 seeds, each seed thinly)",
    ]
    assert "theirs: 0.0500 m at the end" in legends(figure)
    thick = [line for line in figure.axes[1].get_lines() if line.get_linewidth() == 2]
    assert [np.asarray(line.get_ydata()).tolist() for line in thick] == [[0.5, 0.01], [0.5, 0.05]]
