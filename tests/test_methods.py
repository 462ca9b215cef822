"""The methods that can be compared: their results on simulated worlds, and which agree."""

from __future__ import annotations

import importlib.util
import logging
from dataclasses import replace

import numpy as np
import pytest

from relmap.comparison.baselines.base import Setup
from relmap.comparison.baselines.frames import FrameToFrame
from relmap.comparison.compare import landmark_error_curve
from relmap.comparison.methods.registry import (
    METHODS,
    MethodInfo,
    check_method,
    find_method,
    fitting_methods,
)
from relmap.comparison.methods.running import ACCURACY, COST, PATH, MethodRun, run_method, setup_for
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog
from relmap.evaluation.metrics import align, rms
from relmap.evaluation.sources import Data, EightSource, log_of, truth_of
from relmap.evaluation.truth import Truth
from relmap.simulation import simulate_building
from tests.tables import poses_along

EIGHT = EightSource(iterations=150)
WITHOUT_A_MAP = ("kiss-icp", "small-gicp")
Landmarks = Data[ObservationLog]
OF_LANDMARKS = [method for method in METHODS if "landmarks" in method.logs]


def installed(method: MethodInfo) -> None:
    """Skip, and say what is missing, where a method cannot run here."""
    if method.missing:
        pytest.skip(method.missing)


@pytest.fixture(scope="module")
def eight() -> Landmarks:
    return EIGHT.load()


@pytest.fixture(scope="module")
def runs(eight: Landmarks) -> dict[str, MethodRun]:
    """All methods for landmarks that are installed, with known ids."""
    return {
        method.name: run_method(method, eight, "known")
        for method in OF_LANDMARKS
        if not method.missing
    }


@pytest.mark.parametrize("method", OF_LANDMARKS, ids=lambda method: method.name)
def test_every_figure_is_there(method: MethodInfo, runs: dict[str, MethodRun]) -> None:
    installed(method)
    figures = runs[method.name].figures
    assert set(figures) == {*ACCURACY, *PATH, *COST}
    assert len(runs[method.name].result.poses) == 150
    maps = method.name not in WITHOUT_A_MAP
    assert (figures["landmark_rmse_m"] is not None) == maps
    assert (figures["coverage"] == 1.0) == maps
    for name in ("ate_m", "rpe_m", "median_ms", "total_s"):
        assert (figures[name] or 0) > 0
    assert (figures["rpe_m"] or 9) < 0.12


@pytest.mark.parametrize("name", ["relmap-points", "ekf", "isam2", "gtsam-batch"])
def test_methods_that_use_all_observations_are_close_to_batch(
    name: str, runs: dict[str, MethodRun]
) -> None:
    """Four programs, three of them by others, and one limit."""
    installed(find_method(name))
    limit = runs["batch"].figures["landmark_rmse_m"]
    found = runs[name].figures["landmark_rmse_m"]
    assert found < 1.1 * limit


def test_accuracy_is_the_same_in_every_run(eight: Landmarks, runs: dict[str, MethodRun]) -> None:
    for name in ("relmap-points", "frame-to-frame", "frame-to-map", "ekf-mrpt", "ekf", "batch"):
        again = run_method(find_method(name), eight, "known")
        for figure in ACCURACY:
            assert again.figures[figure] == runs[name].figures[figure]
        mine, before = again.result.landmarks.position, runs[name].result.landmarks.position
        assert np.array_equal(mine, before, equal_nan=True)


def test_without_ids_the_paper_matches_worse(eight: Landmarks) -> None:
    ours = run_method(find_method("relmap-points"), eight, "nearest").figures
    papers = run_method(find_method("relmap-points-paper"), eight, "nearest").figures
    assert ours["purity"] == 1.0
    assert (papers["landmarks_per_true"] or 0) >= (ours["landmarks_per_true"] or 0)
    assert (papers["landmark_rmse_m"] or 0) > (ours["landmark_rmse_m"] or 9)


def test_walls() -> None:
    building = simulate_building(600, iterations=20)
    data = Data(log_of(building), truth_of(building))
    found = {
        name: run_method(find_method(name), data, "nearest").figures["corner_rmse_m"] or 9.0
        for name in ("relmap-planes", "relmap-planes-paper")
    }
    assert found["relmap-planes"] < found["relmap-planes-paper"] < 0.2


def test_frame_to_frame_is_exact_without_noise_and_bridges_a_gap() -> None:
    places = np.array([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 3.0], [4.0, 4, 4]])
    method = FrameToFrame(3)
    for k in range(6):
        points = places - [0.1 * k, 0, 0]
        some = slice(0, 1) if k == 3 else slice(None)
        method.update(points[some], np.arange(4)[some])
    assert np.allclose(method.map.positions, places, atol=1e-12)
    assert np.isnan(method.trajectory[3]).all()
    assert np.allclose(method.trajectory[5][:3, 3], [0.5, 0, 0])


def test_setup_contains_noise_and_range(eight: Landmarks) -> None:
    assert setup_for(eight, 0.2).sigma_m == 0.2
    told = setup_for(eight)
    assert told.sigma_m == pytest.approx(0.05, rel=0.2)
    assert told.range_m == pytest.approx(80.0, abs=1.0)
    scans = [np.empty((0, 2)), np.array([[3.0, 4.0]])]
    late = ScanLog(2, np.arange(2.0), scans.__getitem__)
    assert setup_for(Data(late, None)).range_m == 5.0


def test_unidentified_observations_are_ignored(eight: Landmarks) -> None:
    ids = eight.log.ids.copy()
    ids[::7] = -1
    data = Data(replace(eight.log, ids=ids), eight.truth)
    for name in ("frame-to-map", "frame-to-frame", "ekf", "batch"):
        run = run_method(find_method(name), data, "known")
        assert len(run.result.tracks.row) == (ids >= 0).sum()
        assert (run.figures["landmark_rmse_m"] or 9) < 0.2


def test_error_curve_ends_at_the_rmse(eight: Landmarks, runs: dict[str, MethodRun]) -> None:
    assert eight.truth is not None
    info = find_method("frame-to-map")
    method = info.make(setup_for(eight))
    at, rmse = landmark_error_curve(method, eight.log, eight.truth, every=40)
    assert at.tolist() == [39, 79, 119, 149]
    assert rmse[-1] == pytest.approx(runs["frame-to-map"].figures["landmark_rmse_m"], rel=1e-9)


def test_peers_are_behind_one_extra() -> None:
    needed = {method.needs for method in METHODS if method.needs}
    assert needed == {"gtsam", "kiss_icp", "small_gicp"}
    absent = replace(METHODS[0], needs="surely_no_such_module")
    assert absent.missing == ("surely_no_such_module is not installed: pip install 'relmap[peers]'")
    present = [name for name in needed if importlib.util.find_spec(name)]
    assert {m.needs for m in METHODS if m.needs and not m.missing} == set(present)


def test_which_methods_accept_which_logs() -> None:
    with pytest.raises(RelmapError, match="did you mean frame-to-map"):
        find_method("frame-to-mop")
    with pytest.raises(RelmapError, match="cannot map a log of point scans"):
        check_method(find_method("ekf"), "scans", "nearest")
    with pytest.raises(RelmapError, match="needs known ids"):
        check_method(find_method("ekf"), "landmarks", "nearest")
    names = [method.name for method in fitting_methods("landmarks", "nearest")]
    assert names[:3] == ["relmap-points", "relmap-points-live", "relmap-points-paper"]
    assert "ekf" not in names


def test_error_of_what_was_seen_often(runs: dict[str, MethodRun], eight: Landmarks) -> None:
    """Of the same landmarks for every method, by plain alignment."""
    log, truth = eight.log, eight.truth
    often = np.flatnonzero(np.bincount(log.ids) >= 10)
    for name in ("frame-to-map", "batch"):
        table = runs[name].result.landmarks
        found = table.position[np.isin(table.landmark, often)]
        R, t = align(found, truth.landmarks_map[often])
        expected = rms(found @ R.T + t - truth.landmarks_map[often])
        assert runs[name].figures["often_rmse_m"] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", [method.name for method in OF_LANDMARKS])
def test_planar_worlds(name: str) -> None:
    """The figure eight seen from above: every method knows the plane too."""
    installed(find_method(name))
    rng = np.random.default_rng(4)
    places = rng.uniform(-20, 20, (25, 2))
    path = np.column_stack([0.3 * np.arange(60), np.zeros(60)])
    points = (places - path[:, None]).reshape(-1, 2) + rng.normal(0, 0.02, (1500, 2))
    ids, k = np.tile(np.arange(25), 60), np.repeat(np.arange(60), 25)
    log = ObservationLog(points, k, np.arange(1500), 0, 60, ids)
    poses = poses_along(*path.T)
    flat = np.column_stack([places, np.zeros(25)])
    truth = Truth(np.arange(25), flat, np.full(25, "static"), np.arange(60.0), poses)
    run = run_method(find_method(name), Data(log, truth), "known")
    if name in WITHOUT_A_MAP:
        assert run.figures["landmark_rmse_m"] is None
    else:
        assert run.figures["matched"] == 25
        assert (run.figures["landmark_rmse_m"] or 9) < 0.05
    assert (run.figures["rpe_m"] or 9) < 0.1
    assert np.allclose(run.result.poses[:, 2, 3], 0.0, atol=1e-6 if run.figures["matched"] else 1.0)


def test_what_a_method_says_of_its_warm_up_is_not_shown(
    eight: Landmarks, caplog: pytest.LogCaptureFixture
) -> None:
    info, made = find_method("relmap-points-live"), []

    def make(setup: Setup) -> object:
        made.append(setup)
        logging.getLogger("relmap.core").warning("made %d", len(made))
        return info.make(setup)

    run_method(replace(info, make=make), eight, "known")
    assert len(made) == 2
    assert caplog.messages == ["made 2"]
