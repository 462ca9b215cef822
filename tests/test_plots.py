"""The picture of a run: what is in it, and that the same run gives the same bytes."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from matplotlib.text import Text
from PIL import Image

from relmap.core.landmarks import LandmarkMap, LandmarkTable
from relmap.evaluation.landmarks import Overlay
from relmap.io.results import Result, Tracks
from relmap.planes.files import DrawnSubmap
from relmap.planes.table import PlaneTable
from relmap.plots.comparison import plot_comparison
from relmap.plots.errors import plot_errors, shared_scale
from relmap.plots.localised import plot_localised
from relmap.plots.path import broken_at_gaps, broken_at_jumps
from relmap.plots.planes import plot_planes, plot_submaps
from relmap.plots.run import plot_run, write_map_png
from relmap.plots.sheet import limits_of
from relmap.plots.sweep import SweepRow, plot_sweep, write_sweep_png


def make_result(n: int, planar: bool = False, dynamic: int = 0) -> Result:
    rng = np.random.default_rng(0)
    position = rng.uniform(-50, 50, (n, 3)) * [1, 1, 0 if planar else 0.2]
    status = np.where(np.arange(n) < dynamic, "dynamic", "static")
    numbers = np.arange(n)
    table = LandmarkTable(
        numbers,
        position,
        rng.uniform(0.01, 0.1, n),
        numbers + 1,
        numbers,
        numbers,
        numbers + 1,
        status,
        np.zeros(n, np.int64),
        np.full(n, -1),
    )
    poses = np.tile(np.eye(4), (20, 1, 1))
    poses[:, 0, 3] = np.linspace(-40, 40, 20)
    nothing = np.empty(0, np.int64)
    summary = {"dimensions": 2 if planar else 3}
    tracks = Tracks(nothing, nothing, nothing)
    return Result(table, tracks, np.linspace(0, 19, 20), poses, summary)


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


def test_title() -> None:
    assert plot_run(make_result(3)).axes[0].get_title() == "3 of 3 landmarks mapped"
    assert plot_run(make_result(3), title="mine").axes[0].get_title() == "mine"


def test_only_a_part_of_very_many_groups_is_shown() -> None:
    result = make_result(100)
    figure = plot_run(result, [np.arange(100)] * 600)
    assert "group, from its centre to its members (one of 10 shown)" in labels(figure)


@pytest.mark.parametrize("n", [0, 1, 2, 7400])
def test_any_number_of_landmarks(tmp_path: Path, n: int) -> None:
    result = make_result(n)
    write_map_png(tmp_path / "map.png", result, truth=make_truth(result))
    with Image.open(tmp_path / "map.png") as image:
        assert min(image.size) > 500
        assert max(image.size) < 3000


def test_nothing_at_all_is_still_a_picture(tmp_path: Path) -> None:
    result = make_result(0)
    empty = Result(result.landmarks, result.tracks, np.empty(0), np.empty((0, 4, 4)), {})
    write_map_png(tmp_path / "map.png", empty)
    assert (tmp_path / "map.png").stat().st_size > 0


@pytest.mark.parametrize("sd", [np.nan, 0.0, 0.5])
def test_landmarks_of_one_sd_or_none(tmp_path: Path, sd: float) -> None:
    result = make_result(5)
    result.landmarks.sd[:] = sd
    write_map_png(tmp_path / "map.png", result)


def test_same_run_same_bytes_whatever_the_style(tmp_path: Path) -> None:
    result = make_result(10)
    write_map_png(tmp_path / "a.png", result)
    with mpl.rc_context({"axes.facecolor": "black", "savefig.dpi": 50}):
        write_map_png(tmp_path / "b.png", result)
        assert mpl.rcParams["axes.facecolor"] == "black"
    content = (tmp_path / "a.png").read_bytes()
    assert content == (tmp_path / "b.png").read_bytes()
    with Image.open(io.BytesIO(content)) as image:
        assert set(image.info) <= {"dpi"}


def test_no_state_of_pyplot_is_touched(tmp_path: Path) -> None:
    before = "matplotlib.pyplot" in sys.modules
    write_map_png(tmp_path / "a.png", make_result(3))
    assert ("matplotlib.pyplot" in sys.modules) == before


def test_a_path_is_not_drawn_where_it_is_not_known() -> None:
    position = np.arange(12.0).reshape(6, 2)
    drawn = broken_at_gaps(np.array([0.0, 1.0, 2.0, 9.0, 10.0, 11.0]), position)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(drawn[:, 0])), [3])
    np.testing.assert_array_equal(drawn[~np.isnan(drawn[:, 0])], position)
    np.testing.assert_array_equal(broken_at_gaps(np.arange(6.0), position), position)
    assert broken_at_gaps(np.empty(0), np.empty((0, 2))).shape == (0, 2)


def test_one_far_landmark_does_not_ruin_the_axes() -> None:
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


def no_planes() -> PlaneTable:
    none, pairs = np.empty(0, np.int64), np.empty((0, 2))
    ends = np.empty((0, 2, 2))
    corners = np.empty((0, 2), np.int64)
    return PlaneTable(none, ends, pairs, pairs, corners, none, none, none, np.empty(0, "U7"))


def drawn_submap(weak: list[int]) -> DrawnSubmap:
    """A submap without walls, of ten scans along a line."""
    poses = np.tile(np.eye(4), (10, 1, 1))
    poses[:, 0, 3] = np.arange(10)
    points = np.array([[2.0, 1.0], [3.0, 1.0]])
    k, at = np.arange(10), np.array(weak, dtype=np.int64)
    return DrawnSubmap(k, k.astype(float), poses, no_planes(), points, np.array([2, 3]), at)


def test_a_floor_plan_shows_points_start_end_and_weak_links() -> None:
    axes = plot_submaps([drawn_submap([4, 7])], 1).axes[0]
    lines = {str(line.get_label()): line.get_xydata() for line in axes.get_lines()}
    np.testing.assert_array_equal(lines["start"], [[0.0, 0.0]])
    np.testing.assert_array_equal(lines["end"], [[9.0, 0.0]])
    np.testing.assert_array_equal(lines["weak link"], [[3.5, 0.0], [6.5, 0.0]])
    assert any(np.array_equal(each, [[2.0, 1.0], [3.0, 1.0]]) for each in lines.values())
    without = plot_submaps([drawn_submap([])], 1).axes[0]
    assert "weak link" not in [line.get_label() for line in without.get_lines()]


def test_each_submap_has_its_own_panel() -> None:
    figure = plot_submaps([drawn_submap([]), drawn_submap([2])], 3)
    assert [axes.get_title().partition(":")[0] for axes in figure.axes] == ["map", "submap 1"]
    assert figure.get_suptitle() == "3 separate submaps, 1 of a few scans not drawn"
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels.count("weak link") == 1


def test_path_among_walls_is_broken_where_it_leaps() -> None:
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, 0, 3] = 0.1 * np.arange(40) + np.where(np.arange(40) < 20, 0.0, 15.0)
    axes = plot_planes(no_planes(), poses).axes[0]
    (line,) = (line for line in axes.get_lines() if line.get_label() == "path of the robot")
    assert np.flatnonzero(np.isnan(np.asarray(line.get_xdata()))).tolist() == [20]


def test_figures_of_a_comparison_are_dots() -> None:
    rows: list[tuple[str, dict[str, float | None]]]
    rows = [("relmap-points", {"ate_m": 0.1, "total_s": 2.0}), ("batch", {"ate_m": None})]
    figure = plot_comparison(rows, "two methods")
    assert not any(axes.patches for axes in figure.axes)
    (dot,) = figure.axes[0].get_lines()
    assert np.asarray(dot.get_xdata()).tolist() == [0.1]
    assert "no figure" in [text.get_text() for text in figure.axes[0].texts]


@pytest.mark.parametrize("name", ["a$\\q$ b", "x_{1}^$\\frac$", "%s{}\\n", "<b>&\"'"])
def test_names_are_shown_as_they_are_whatever_is_in_them(name: str) -> None:
    figures: dict[str, float | None] = {"ate_m": 0.1}
    for figure in (
        plot_comparison([("batch", figures)], name),
        plot_run(make_result(3), title=name),
    ):
        figure.savefig(io.BytesIO(), format="png")
        titles = [text for text in figure.findobj(Text) if text.get_text() == name]
        assert len(titles) == 1
        assert not titles[0].get_parse_math()


def test_axes_of_a_comparison_have_numbers_however_near_its_figures_are() -> None:
    for values in ((1.91, 1.95), (0.0146, 0.0984), (0.003, 0.15)):
        rows: list[tuple[str, dict[str, float | None]]]
        rows = [(f"method {value}", {"ate_m": value}) for value in values]
        axes = plot_comparison(rows, "two methods").axes[0]
        low, high = axes.get_xlim()
        shown = [at for at in axes.get_xticks() if low <= at <= high]
        assert shown
        written = [axes.xaxis.get_major_formatter()(at) for at in shown]
        assert [float(text) for text in written] == pytest.approx(shown)


def sweep_rows(numbers: bool) -> list[SweepRow]:
    return [
        SweepRow(name, at if numbers else None, {"ate_m": factor * at * (1 + 0.1 * seed)})
        for name, factor in (("relmap", 1.0), ("batch", 2.0))
        for at in (0.1, 0.2, 0.4)
        for seed in (-1, 0, 1)
    ]


def test_a_sweep_is_a_line_of_medians_for_each_method() -> None:
    axes, *others = plot_sweep(sweep_rows(True), "noise [m]").axes
    assert others == []
    assert axes.get_xlabel() == "noise [m]"
    lines = {str(line.get_label()): np.array(line.get_data()).T for line in axes.get_lines()}
    np.testing.assert_allclose(lines["relmap"], [[0.1, 0.1], [0.2, 0.2], [0.4, 0.4]])
    np.testing.assert_allclose(lines["batch"], [[0.1, 0.2], [0.2, 0.4], [0.4, 0.8]])


def test_a_sweep_without_numbers_is_a_comparison_of_medians() -> None:
    axes = plot_sweep(sweep_rows(False), "").axes[0]
    dots = [float(np.asarray(line.get_xdata())[0]) for line in axes.get_lines()]
    assert dots == [0.2, 0.4]


@pytest.mark.parametrize("figures", [{}, {"ate_m": None}])
def test_an_empty_sweep_is_still_a_picture(
    tmp_path: Path, figures: dict[str, float | None]
) -> None:
    write_sweep_png(tmp_path / "a.png", [SweepRow("relmap", 0.1, figures)], "noise [m]")
    write_sweep_png(tmp_path / "b.png", [SweepRow("relmap", None, figures)], "")


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


def errors_of(off_m: float) -> Overlay:
    true = np.random.default_rng(0).uniform(-5, 5, (20, 3))
    pairs = np.stack([true + np.array([off_m, 0.0, 0.0]), true], axis=1)
    return Overlay(true, np.empty((0, 3)), pairs)


def test_errors_are_enlarged_alike_and_far_ones_cut() -> None:
    near, far = errors_of(0.01), errors_of(3.0)
    scale = shared_scale([near, near, far])
    assert scale == 20.0
    result = make_result(20, True)
    for overlay, label in ((near, "error, x 20"), (far, "more than 0.06 m")):
        (axes,) = plot_errors(result, overlay, scale, "a").axes
        (quiver,) = (c for c in axes.collections if isinstance(c, Quiver))
        lengths = np.hypot(quiver.U, quiver.V)
        assert lengths.max() < 0.13 * np.ptp(overlay.landmarks_map, axis=0).max()
        assert label in [line.get_label() for line in axes.get_lines()]
    np.testing.assert_allclose(lengths, lengths[0])


def test_without_errors_nothing_is_enlarged() -> None:
    nothing = Overlay(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2, 3)))
    assert shared_scale([]) == shared_scale([nothing]) == 1.0
    assert shared_scale([errors_of(0.0)]) == 1.0
    for planar in (True, False):
        plot_errors(make_result(3, planar), nothing, 1.0, "a").draw_without_rendering()


def test_one_far_point_does_not_ruin_the_panel_of_a_submap() -> None:
    far = drawn_submap([])
    far.points[1] = 9000.0, 0.0
    for axes in plot_submaps([far, drawn_submap([])], 2).axes:
        assert np.ptp(axes.get_xlim()) < 12
