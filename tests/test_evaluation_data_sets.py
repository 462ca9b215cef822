"""The truth given by the data sets, and the least-squares reference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from relmap import PointMapper, RelmapError
from relmap.comparison.baselines.batch import least_squares_map
from relmap.datasets import ObservationLog, open_log
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.landmarks import overlay
from relmap.evaluation.run import run_mapper
from relmap.evaluation.truth import read_truth
from relmap.figures.figure17 import FIGURE, compare_with_reference
from relmap.io.results import Result
from relmap.plots.sheet import write_png
from relmap.simulation import simulate_figure_eight
from tests.worlds import aligned_rmse

CIRCLE = "LANDMARK_C {} {} 0.9 0.001 0 0.001 {}\n"
STEP = "STEP image 0 -0.1 0 0 0 0 0 0 0\n"


def mapped(log: ObservationLog) -> Result:
    return run_mapper(PointMapper(), log, "nearest").result


def planar_log(sigma: float = 0.0, iterations: int = 40) -> ObservationLog:
    """A robot drives straight on past trees and sees all of them; the last has no id."""
    rng = np.random.default_rng(0)
    trees = rng.uniform([0, -20], [40, 20], (8, 2))
    seen = [trees - [0.2 * k, 0] + sigma * rng.standard_normal((8, 2)) for k in range(iterations)]
    return ObservationLog.of_scans(seen, [np.array([0, 1, 2, 3, 4, 5, 6, -1])] * iterations)


def test_truth_of_slsjf(tmp_path: Path) -> None:
    beacons = np.array([[3, 1, 2], [4, 5, 6]], dtype=np.uint16)
    savemat(tmp_path / "store_beaconsTrue.mat", {"store_beaconsTrue": beacons})
    savemat(tmp_path / "store_robotTrue.mat", {"store_robotTrue": np.eye(3)})
    truth = read_truth(tmp_path)
    assert truth.landmark_ids.tolist() == [3, 4]
    assert truth.landmarks_map.tolist() == [[1, 2, 0], [5, 6, 0]]
    assert truth.stamps_s.tolist() == [0, 1, 2]
    assert set(truth.status) == {"static"}
    beacons[1, 0] = 3
    savemat(tmp_path / "store_beaconsTrue.mat", {"store_beaconsTrue": beacons})
    with pytest.raises(RelmapError, match="landmark 3 occurs twice"):
        read_truth(tmp_path / "store_beaconsTrue.mat")


def test_circles_have_ids_but_no_places(tmp_path: Path) -> None:
    places = [(0, -1), (1, -2), (-1, -3), (2, -4), (0.5, -2.5)]
    circles = "".join(CIRCLE.format(x, y, k - 1) for k, (x, y) in enumerate(places))
    (tmp_path / "map.circles").write_text((STEP + circles) * 20)
    log = open_log(tmp_path)
    truth, result = read_truth(tmp_path), mapped(log)
    assert truth.landmark_ids.tolist() == [0, 1, 2, 3]
    evaluation = evaluate(result, truth, log)
    assert (evaluation.purity, evaluation.coverage) == (1, 1)
    assert evaluation.landmark_rmse_m is evaluation.ate_m is evaluation.rpe_m is None
    drawn = overlay(result, truth, log)
    assert len(drawn.landmarks_map) == len(drawn.errors_map) == 0


@pytest.mark.parametrize("name", ["victoria-park", "slsjf-sim-8240", "dlr-circles"])
def test_folders_of_the_data_sets(shared_data: Path, name: str) -> None:
    truth = read_truth(shared_data / name)
    log = open_log(shared_data / name)
    assert np.isin(log.ids[log.ids >= 0], truth.landmark_ids).all()
    placed = np.isfinite(truth.landmarks_map).all()
    assert placed == (name != "dlr-circles")
    assert len(truth.poses) == len(truth.stamps_s) == (8241 if name == "slsjf-sim-8240" else 0)


def test_reference_is_exact_without_noise() -> None:
    world = simulate_figure_eight(density=15, iterations=60, sigma=0.0)
    found = least_squares_map(world.log)
    assert aligned_rmse(found.positions, world.landmarks_map[found.landmark_ids]) < 1e-9


def test_reference_leaves_out_undetermined_poses() -> None:
    log = planar_log(sigma=0.1)
    assert log.ids is not None
    only_one = replace(log, ids=np.where((log.iteration == 7) & (log.ids != 2), -1, log.ids))
    nothing = replace(log, ids=np.where(log.iteration == 7, -1, log.ids))
    assert np.array_equal(
        least_squares_map(only_one).positions, least_squares_map(nothing).positions
    )
    assert least_squares_map(log).landmark_ids.tolist() == list(range(7))
    with pytest.raises(RelmapError, match="the log has no ids"):
        least_squares_map(replace(log, ids=None))
    with pytest.raises(RelmapError, match="too few landmarks are identified"):
        least_squares_map(replace(log, ids=np.minimum(log.ids, 0) - 1))


def test_figure_of_two_stretches(tmp_path: Path) -> None:
    log = planar_log(sigma=0.05)
    panels = []
    for begin, end in ((0, 25), (20, 40)):
        part = log.between(begin, end)
        panels.append(compare_with_reference(mapped(part), part))
    assert panels[0].title.splitlines()[0] == "scans 0 to 24"
    assert panels[1].title.endswith("over 7 trees\n7 of the 7 trees seen 10 times are mapped")
    assert panels[0].often.all()
    assert [len(panel.trees_map) for panel in panels] == [8, 8]
    figure = FIGURE.draw(panels)
    assert [axes.get_aspect() for axes in figure.axes] == [1, 1]
    assert len(figure.legends[0].get_texts()) == 4
    files = [tmp_path / "a.png", tmp_path / "b.png"]
    for file in files:
        write_png(file, lambda: FIGURE.draw(panels))
    assert files[0].read_bytes() == files[1].read_bytes() != b""
    with pytest.raises(RelmapError, match="the log has no ids"):
        compare_with_reference(mapped(log), replace(log, ids=None))


def test_reference_lies_on_the_map_of_the_trees() -> None:
    log = planar_log()
    panel = compare_with_reference(mapped(log), log)
    gaps = panel.trees_map[:, None] - panel.reference_map
    assert np.linalg.norm(gaps, axis=2).min(axis=0).max() < 1e-9
