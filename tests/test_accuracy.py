"""The figures that the documents promise, on simulated and on real data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap import PointMapper
from relmap.comparison.baselines.batch import least_squares_map
from relmap.comparison.baselines.frames import frame_to_map
from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import LandmarkMap
from relmap.datasets import ObservationLog, open_log
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.datasets.victoria_park import read_reference_map
from relmap.simulation import simulate_figure_eight
from tests.worlds import aligned_rmse, driven, purity_of, stands_for, without_ids


def rmse(result: LandmarkMap, ids: Ints, truth: Floats) -> float:
    row_of = {label: row for row, label in enumerate(ids.tolist())}
    rows = [row_of[label] for label in result.landmark_ids.tolist()]
    return aligned_rmse(result.positions, truth[rows])


def share_mapped(mapper: PointMapper, log: ObservationLog) -> float:
    """Return the fraction of the landmarks seen ten times that are mapped."""
    ids, counts = np.unique(log.ids[log.ids >= 0], return_counts=True)
    return float(np.isin(ids[counts >= 10], mapper.map.landmark_ids).mean())


@pytest.mark.parametrize(("density", "iterations"), [(25, 450), (100, 900)])
def test_chained_groups_are_no_worse_than_frame_to_map(density: float, iterations: int) -> None:
    world = simulate_figure_eight(density=density, iterations=iterations, seed=0)
    mapper = driven(world.log)
    assert share_mapped(mapper, world.log) >= 0.97
    truth = (world.landmark_ids, world.landmarks_map)
    assert rmse(mapper.map, *truth) <= rmse(frame_to_map(world.log).map, *truth)


@pytest.mark.parametrize("noise", ["gaussian", "uniform"])
def test_the_eight_is_exact_without_noise(noise: str) -> None:
    world = simulate_figure_eight(noise=noise, sigma=0.0, iterations=1000)  # type: ignore[arg-type]
    mapper = driven(world.log)
    assert len(mapper.map.landmark_ids) == len(world.landmark_ids)
    assert rmse(mapper.map, world.landmark_ids, world.landmarks_map) < 1e-9


@pytest.mark.parametrize("name", ["kf-slam_demo", "kf-slam_6D_demo", "kf-slam_6D_demo_noncentered"])
def test_mrpt_logs_are_mapped_to_a_centimetre(shared_data: Path, name: str) -> None:
    path = shared_data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
    log = open_log(path)
    mapper = driven(log)
    ids, positions, _ = read_ground_truth(path)
    assert share_mapped(mapper, log) >= 0.97
    assert rmse(mapper.map, ids, positions) <= 0.012


@pytest.mark.parametrize(
    ("density", "iterations", "least"), [(25, 900, 0.9995), (200, 200, 0.9995), (1000, 80, 0.999)]
)
def test_tracks_are_pure_without_ids(density: float, iterations: int, least: float) -> None:
    log = simulate_figure_eight(density=density, iterations=iterations, seed=0).log
    mapper, landmarks = map_without_ids(log)
    assert purity_of(landmarks, log.ids) >= least
    id_of = stands_for(landmarks, log.ids)
    mapped = [id_of[label] for label in mapper.map.landmark_ids]
    ids, counts = np.unique(log.ids, return_counts=True)
    assert np.isin(ids[counts >= 10], mapped).mean() >= 0.97


def test_static_tracks_are_pure_among_moving_landmarks() -> None:
    world = simulate_figure_eight(dynamic=0.4, iterations=450, seed=0)
    log = world.log
    _, landmarks = map_without_ids(log)
    static = world.status[log.ids] == "static"
    assert purity_of(landmarks[static], log.ids[static]) >= 0.995


@pytest.mark.parametrize("dynamic", [0.4, 0.65])
def test_moving_landmarks_are_detected(dynamic: float) -> None:
    world = simulate_figure_eight(density=100, iterations=450, dynamic=dynamic, seed=0)
    mapper = driven(world.log)
    table = mapper.landmarks
    often = table.observations >= 30
    found = table.status[often] == "dynamic"
    true = world.status[table.landmark[often]] == "dynamic"
    assert (found & true).sum() >= 0.97 * found.sum()
    assert (found & true).sum() >= 0.97 * true.sum()


@pytest.mark.parametrize("name", ["kf-slam_6D_demo", "kf-slam_6D_demo_noncentered"])
def test_mrpt_logs_are_tracked_without_ids(shared_data: Path, name: str) -> None:
    path = shared_data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
    log = open_log(path)
    mapper, landmarks = map_without_ids(log)
    assert purity_of(landmarks, log.ids) >= 0.999
    ids, positions, _ = read_ground_truth(path)
    assert often_seen_rmse(mapper, landmarks, log, ids, positions) <= 0.03


@pytest.mark.parametrize(("begin", "end", "most_m"), [(1181, 1642, 0.20), (4220, 4634, 0.35)])
def test_victoria_park_is_mapped_without_ids(
    shared_data: Path, begin: int, end: int, most_m: float
) -> None:
    log = open_log(shared_data / "victoria-park").between(begin, end)
    mapper, landmarks = map_without_ids(log)
    assert purity_of(landmarks, log.ids) >= 0.999
    id_of = stands_for(landmarks, log.ids)
    mapped = np.array([id_of.get(label, -1) for label in mapper.map.landmark_ids])
    ids, counts = np.unique(log.ids[log.ids >= 0], return_counts=True)
    assert np.isin(ids[counts >= 10], mapped).mean() >= 0.95
    # The published estimate, of the whole log and with odometry, is the better reference:
    # unweighted least squares over the interval itself deviates from it by more than the map does.
    reference = read_reference_map(shared_data / "victoria-park")
    found = rmse_against(reference, mapped, mapper.map.positions)
    batch = least_squares_map(log)
    assert found <= most_m
    assert found <= rmse_against(reference, batch.landmark_ids, batch.positions)


def rmse_against(reference: tuple[Ints, Floats], ids: Ints, positions: Floats) -> float:
    """Return the RMSE of planar positions of landmarks, by ids, from a reference, aligned."""
    known = np.isin(ids, reference[0])
    there = reference[1][np.searchsorted(reference[0], ids[known])]
    return aligned_rmse(positions[known][:, :2], there[:, :2])


def test_a_stretch_of_victoria_park_reports_its_submaps(shared_data: Path) -> None:
    log = open_log(shared_data / "victoria-park").between(4549, 4849)
    mapper, landmarks = map_without_ids(log)
    assert purity_of(landmarks, log.ids) >= 0.999
    table, submaps = mapper.landmarks, mapper.submaps
    assert table.observations.sum() == len(log.points_robot)
    assert len(submaps) > 1
    for number, submap in enumerate(submaps):
        np.testing.assert_array_equal(table.landmark[table.submap == number], submap.landmark_ids)
    assert np.isfinite(np.concatenate([submap.positions for submap in submaps])).all()
    assert (np.diff([len(submap.landmark_ids) for submap in submaps]) <= 0).all()


def map_without_ids(log: ObservationLog) -> tuple[PointMapper, Ints]:
    """Map and refine without ids; return the mapper and the landmark of every observation."""
    mapper, labels = without_ids(log)
    mapper.refine()
    return mapper, mapper.landmarks_of(labels)


def often_seen_rmse(
    mapper: PointMapper, landmarks: Ints, log: ObservationLog, ids: Ints, truth: Floats
) -> float:
    """Return the RMSE of the mapped tracks seen ten times, against those they stand for."""
    table, id_of = mapper.landmarks, stands_for(landmarks, log.ids)
    often = (table.level > 0) & (table.observations >= 10)
    true = np.array([id_of[label] for label in table.landmark[often]])
    return rmse(LandmarkMap(true, table.position[often]), ids, truth)
