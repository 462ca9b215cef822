"""The pictures of submaps of walls."""

from __future__ import annotations

import numpy as np

from relmap.planes.walls.files import DrawnSubmap
from relmap.plots.planes import plot_planes, plot_submaps
from tests.tables import poses_along, wall_table

NO_PLANES = wall_table(np.empty((0, 2, 2)))


def drawn_submap(weak: list[int]) -> DrawnSubmap:
    """A submap without walls, of ten scans along a line."""
    poses = poses_along(np.arange(10))
    points = np.array([[2.0, 1.0], [3.0, 1.0]])
    k, at = np.arange(10), np.array(weak, dtype=np.int64)
    return DrawnSubmap(k, k.astype(float), poses, NO_PLANES, points, np.array([2, 3]), at)


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
    said = "3 separate submaps, each in its own frame, 1 of a few scans not drawn"
    assert figure.get_suptitle() == said
    assert {(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes} == {("x [m]", "y [m]")}
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels.count("weak link") == labels.count("point of a scan") == 1


def test_path_among_walls_is_broken_where_it_leaps() -> None:
    poses = poses_along(0.1 * np.arange(40) + np.where(np.arange(40) < 20, 0.0, 15.0))
    axes = plot_planes(NO_PLANES, poses).axes[0]
    (line,) = (line for line in axes.get_lines() if line.get_label() == "path of the robot")
    assert np.flatnonzero(np.isnan(np.asarray(line.get_xdata()))).tolist() == [20]


def test_one_far_point_does_not_widen_the_panel_of_a_submap() -> None:
    far = drawn_submap([])
    far.points[1] = 9000.0, 0.0
    panels = plot_submaps([far, drawn_submap([])], 2).axes
    assert len(panels) == 2
    for axes in panels:
        assert np.ptp(axes.get_xlim()) < 12
