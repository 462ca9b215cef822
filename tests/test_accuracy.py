"""The figures that the README promises, on simulated and on real data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from relmap import PointMapper
from relmap.core.landmarks import LandmarkMap
from relmap.datasets import ObservationLog, open_log
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.evaluation.baselines import FrameToMap
from relmap.simulation import simulate_figure_eight
from tests.worlds import aligned_rmse

SEEDS = range(10)


def map_log(log: ObservationLog, *, known: bool = True) -> PointMapper:
    mapper = PointMapper()
    for scan in log.scans():
        mapper.update(scan.points_robot, scan.ids if known else None)
    mapper.finish()
    return mapper


def frame_to_map(log: ObservationLog) -> FrameToMap:
    baseline = FrameToMap()
    for scan in log.scans():
        assert scan.ids is not None
        baseline.update(scan.points_robot, scan.ids)
    return baseline


def rmse(result: LandmarkMap, ids: NDArray[np.int64], truth: NDArray[np.float64]) -> float:
    row_of = {label: row for row, label in enumerate(ids.tolist())}
    rows = [row_of[label] for label in result.landmark_ids.tolist()]
    return aligned_rmse(result.positions, truth[rows])


def share_mapped(mapper: PointMapper, log: ObservationLog) -> float:
    """Return the share of the landmarks seen ten times that are mapped."""
    assert log.ids is not None
    ids, counts = np.unique(log.ids[log.ids >= 0], return_counts=True)
    return float(np.isin(ids[counts >= 10], mapper.map.landmark_ids).mean())


@pytest.mark.parametrize("density", [25, 100])
def test_chained_groups_are_no_worse_than_frame_to_map(density: float) -> None:
    ours, theirs = [], []
    for seed in SEEDS:
        world = simulate_figure_eight(density=density, seed=seed)
        mapper = map_log(world.log)
        assert share_mapped(mapper, world.log) >= 0.97
        truth = (world.landmark_ids, world.landmarks_map)
        ours.append(rmse(mapper.map, *truth))
        theirs.append(rmse(frame_to_map(world.log).map, *truth))
    assert np.median(ours) <= np.median(theirs)


@pytest.mark.parametrize("noise", ["gaussian", "uniform"])
def test_the_eight_is_exact_without_noise(noise: str) -> None:
    world = simulate_figure_eight(noise=noise, sigma=0.0, iterations=1000)  # type: ignore[arg-type]
    mapper = map_log(world.log)
    assert len(mapper.map.landmark_ids) == len(world.landmark_ids)
    assert rmse(mapper.map, world.landmark_ids, world.landmarks_map) < 1e-9


@pytest.mark.parametrize("name", ["kf-slam_demo", "kf-slam_6D_demo", "kf-slam_6D_demo_noncentered"])
def test_mrpt_logs_are_mapped_to_a_centimetre(shared_data: Path, name: str) -> None:
    path = shared_data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
    log = open_log(path)
    mapper = map_log(log)
    ids, positions, _ = read_ground_truth(path)
    assert share_mapped(mapper, log) >= 0.97
    assert rmse(mapper.map, ids, positions) <= 0.012


@pytest.mark.parametrize(("begin", "end"), [(1181, 1642), (4220, 4634)])
def test_victoria_park_runs_and_tells_what_it_could_not_map(
    shared_data: Path, begin: int, end: int
) -> None:
    log = open_log(shared_data / "victoria-park").between(begin, end)
    mapper = map_log(log, known=False)
    table = mapper.landmarks
    assert table.observations.sum() == len(log.points_robot)
    assert set(table.status) <= {"static", "dynamic", "unmapped"}
    assert np.isfinite(mapper.map.positions).all()
    assert len(mapper.trajectory) == end - begin
