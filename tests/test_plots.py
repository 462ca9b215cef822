"""The picture of a run: its content, and that the same run gives the same bytes."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from relmap.core.landmarks import LandmarkMap, Submap
from relmap.evaluation.landmarks import Overlay
from relmap.io.results import Result
from relmap.plots.path import broken_at_gaps, broken_at_jumps
from relmap.plots.run import plot_localised, plot_run
from relmap.plots.sheet import Sheet, limits_of, write_png
from tests.somerun import make_result


def make_truth(result: Result) -> Overlay:
    position = result.landmarks.position
    return Overlay(position + 0.1, result.poses[:, :3, 3], np.stack([position, position + 0.1], 1))


def labels(figure: Figure) -> set[str]:
    return {text.get_text() for legend in figure.legends for text in legend.get_texts()}


def test_two_views_in_space_and_one_in_the_plane() -> None:
    for planar, axes in ((True, {"y [m]"}), (False, {"y [m]", "z [m]"})):
        figure = plot_run(make_result(10, planar))
        assert {each.get_ylabel() for each in figure.axes} >= axes
        assert len(figure.axes) == len(axes) + 1  # the colour bar


def test_axes_have_one_scale() -> None:
    figure = plot_run(make_result(30))
    figure.draw_without_rendering()
    width, height = figure.get_size_inches()
    scales = []
    for axes in figure.axes[:2]:
        box = axes.get_position()
        scales += [
            box.width * width / np.ptp(axes.get_xlim()),
            box.height * height / np.ptp(axes.get_ylim()),
        ]
    assert scales == pytest.approx([scales[0]] * 4)


def test_everything_is_named_in_the_legend() -> None:
    result = make_result(10, dynamic=3)
    figure = plot_run(result, [np.arange(5), np.arange(4, 10)], make_truth(result))
    assert labels(figure) == {
        "landmark",
        "dynamic landmark",
        "true landmark",
        "true path",
        "path of the robot",
        "start",
        "end",
        "group, from its centre to its members",
    }


def test_the_legend_of_a_narrow_picture_is_not_cut_off() -> None:
    tower = np.array([[0.0, 0, 0], [1, 1, 9], [0, 1, 18]])
    sheet = Sheet(tower, tower, planar=False)
    names = "group, from its centre to its members|path of the robot|start|end"
    for name in f"{names}|segment with large residuals|doubtful merge|landmark".split("|"):
        sheet.views[0][0].plot([0, 1], [0, 1], label=name)
    figure = sheet.finish("tower")
    box = figure.legends[0].get_window_extent()
    assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1


def test_title() -> None:
    assert plot_run(make_result(3)).axes[0].get_title() == "3 of 3 landmarks mapped"
    assert plot_run(make_result(3), title="mine").axes[0].get_title() == "mine"
    part = Submap(np.arange(3), np.zeros((3, 3)), 0, 9)
    title = plot_run(replace(make_result(3), submaps=(part, part))).axes[0].get_title()
    assert title == "the first of 2 submaps: 3 of 3 landmarks mapped"


@pytest.mark.parametrize("size", [(31, 20), (30, 18), (20, 40), (5, 3)])
def test_the_title_is_not_cut_off(size: tuple[float, float]) -> None:
    corners = np.array([[0.0, 0, 0], [*size, 0]])
    sheet = Sheet(corners, corners, planar=True)
    for name in "abcde":
        sheet.views[0][0].plot([0], [0], label=name)
    sheet.finish("title")
    sheet.figure.savefig(io.BytesIO())
    title = sheet.views[0][0].title.get_window_extent()
    assert title.y1 <= sheet.figure.bbox.y1


@pytest.mark.parametrize("wide", [0.0, 0.2, 0.35, 1.0])
def test_the_label_of_the_colours_of_a_flat_picture_is_not_cut_off(wide: float) -> None:
    result = make_result(9, planar=True)
    table = replace(result.landmarks, position=result.landmarks.position * [1, wide, 0])
    figure = plot_run(replace(result, landmarks=table))
    (bar,) = (axes for axes in figure.axes if "deviation" in axes.get_ylabel())
    box = bar.yaxis.label.get_window_extent()
    assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1


def test_only_a_part_of_very_many_groups_is_shown() -> None:
    result = make_result(100)
    figure = plot_run(result, [np.arange(100)] * 600)
    assert "group, from its centre to its members (one of 10 shown)" in labels(figure)


@pytest.mark.parametrize("n", [0, 1, 2, 7400])
def test_any_number_of_landmarks(tmp_path: Path, n: int) -> None:
    result = make_result(n)
    write_png(tmp_path / "map.png", plot_run, result, truth=make_truth(result))
    with Image.open(tmp_path / "map.png") as image:
        assert min(image.size) > 500
        assert max(image.size) < 3000


def test_nothing_at_all_is_still_a_picture(tmp_path: Path) -> None:
    result = make_result(0)
    empty = Result(result.landmarks, result.tracks, np.empty(0), np.empty((0, 4, 4)), {})
    write_png(tmp_path / "map.png", plot_run, empty)
    assert (tmp_path / "map.png").stat().st_size > 0
    noted = [text.get_text() for text in plot_run(empty).axes[0].texts]
    assert noted == ["nothing is mapped"]
    assert not plot_run(make_result(5)).axes[0].texts


@pytest.mark.parametrize("sd", [np.nan, 0.0, 0.5])
def test_landmarks_of_one_sd_or_none(tmp_path: Path, sd: float) -> None:
    result = make_result(5)
    result.landmarks.sd[:] = sd
    write_png(tmp_path / "map.png", plot_run, result)


def test_same_run_same_bytes_whatever_the_style(tmp_path: Path) -> None:
    result = make_result(10)
    write_png(tmp_path / "a.png", plot_run, result)
    with mpl.rc_context({"axes.facecolor": "black", "savefig.dpi": 50}):
        write_png(tmp_path / "b.png", plot_run, result)
        assert mpl.rcParams["axes.facecolor"] == "black"
    content = (tmp_path / "a.png").read_bytes()
    assert content == (tmp_path / "b.png").read_bytes()
    with Image.open(io.BytesIO(content)) as image:
        assert set(image.info) <= {"dpi"}


def test_no_state_of_pyplot_is_touched(tmp_path: Path) -> None:
    before = "matplotlib.pyplot" in sys.modules
    write_png(tmp_path / "a.png", plot_run, make_result(3))
    assert ("matplotlib.pyplot" in sys.modules) == before


def test_a_path_is_not_drawn_where_it_is_not_known() -> None:
    position = np.arange(12.0).reshape(6, 2)
    drawn = broken_at_gaps(np.array([0.0, 1.0, 2.0, 9.0, 10.0, 11.0]), position)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(drawn[:, 0])), [3])
    np.testing.assert_array_equal(drawn[~np.isnan(drawn[:, 0])], position)
    np.testing.assert_array_equal(broken_at_gaps(np.arange(6.0), position), position)
    assert broken_at_gaps(np.empty(0), np.empty((0, 2))).shape == (0, 2)


def test_one_far_landmark_does_not_widen_the_axes() -> None:
    result = make_result(200)
    before = plot_run(result).axes[0]
    assert before.get_title() == "200 of 200 landmarks mapped"
    result.landmarks.position[7] = [9000.0, 0.0, 0.0]
    axes = plot_run(result).axes[0]
    assert np.ptp(axes.get_xlim()) < 1.1 * np.ptp(before.get_xlim())
    assert axes.get_title() == "200 of 200 landmarks mapped (1 far outside not shown)"


def test_limits_hold_all_of_the_way_and_all_that_is_near() -> None:
    rng = np.random.default_rng(1)
    places, way = rng.normal(0.0, 1.0, (500, 2)), np.array([[0.0, 0.0], [np.nan] * 2, [30.0, 0.0]])
    low, high = limits_of(places, way, 0.5)
    np.testing.assert_allclose(low, places.min(axis=0) - 0.5)
    assert high.tolist() == [30.5, places[:, 1].max() + 0.5]
    along = np.concatenate([places, [[32.0, 1.0], [500.0, 0.0]]])  # seen at the way's end, and far
    assert limits_of(along, way)[1][0] == 32.0
    assert limits_of(places[:0], way[:0])[1].tolist() == [1.0, 1.0]


def test_a_path_is_not_drawn_through_a_leap() -> None:
    stands, goes = np.zeros((60, 2)), np.column_stack([0.1 * np.arange(40), np.zeros(40)])
    path = np.concatenate([stands, goes, goes + np.array([20.0, 0.0])])
    drawn = broken_at_jumps(path)
    assert np.flatnonzero(np.isnan(drawn[:, 0])).tolist() == [100]
    for whole in (stands, goes, goes[:2], goes[:1], goes[:0]):
        assert broken_at_jumps(whole) is whole or np.isfinite(broken_at_jumps(whole)).all()


@pytest.mark.parametrize("planar", [True, False])
def test_scans_that_were_found_are_drawn_in_the_map(planar: bool) -> None:
    result = make_result(20, planar)
    landmarks = LandmarkMap(np.arange(20), result.landmarks.position)
    scan = np.array([0, 1, 2, 3, 9, 10, 11, 12])
    figure = plot_localised(landmarks, planar, scan, result.poses[: len(scan)], 20)
    assert len(figure.axes) == (1 if planar else 2)
    assert figure.axes[0].get_title() == "8 of 20 scans localised in a map of 20 landmarks"
    (path,) = (line for line in figure.axes[0].get_lines() if "localised" in str(line.get_label()))
    assert np.flatnonzero(np.isnan(np.asarray(path.get_xdata()))).tolist() == [4]
    plot_localised(landmarks, planar, scan[:0], result.poses[:0], 20).draw_without_rendering()
