"""Accuracy and time of the point mapper: the figures of the README.

    python benchmarks/points.py [DATA]

DATA is a folder with the real data sets (mrpt-kf-slam); without it those rows are left out.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

from relmap import PointMapper
from relmap.core.alignment import fit_rigid
from relmap.core.landmarks import LandmarkMap
from relmap.datasets import ObservationLog, open_log
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.evaluation.baselines import FrameToMap
from relmap.simulation import simulate_figure_eight


def rmse(result: LandmarkMap, ids: np.ndarray, truth: np.ndarray) -> float:
    """Return the landmark RMSE, metres, after rigid alignment."""
    row_of = {label: row for row, label in enumerate(ids.tolist())}
    there = truth[[row_of[label] for label in result.landmark_ids.tolist()]]
    R, t = fit_rigid(result.positions, there)
    return float(np.sqrt(np.mean(np.sum((result.positions @ R.T + t - there) ** 2, axis=1))))


def run(mapper: PointMapper | FrameToMap, log: ObservationLog) -> np.ndarray:
    """Map a log with known association; return the time of each iteration, milliseconds."""
    times = []
    for scan in log.scans():
        begin = perf_counter()
        mapper.update(scan.points_robot, scan.ids)
        times.append(perf_counter() - begin)
    if isinstance(mapper, PointMapper):
        mapper.finish()
    return 1e3 * np.array(times)


def coverage(result: LandmarkMap, log: ObservationLog) -> float:
    """Return the share of the landmarks seen ten times that are mapped."""
    ids, counts = np.unique(log.ids[log.ids >= 0], return_counts=True)
    return float(np.isin(ids[counts >= 10], result.landmark_ids).mean())


def figure_eight() -> None:
    """Print the landmark RMSE over ten seeds beside that of frame-to-map averaging."""
    print("figure eight, sigma 0.05, known association, seeds 0-9: landmark RMSE [m]")
    for density in (25, 100):
        errors, shares = [], []
        for seed in range(10):
            world = simulate_figure_eight(density=density, seed=seed)
            mapper, baseline = PointMapper(), FrameToMap()
            run(mapper, world.log)
            run(baseline, world.log)
            truth = (world.landmark_ids, world.landmarks_map)
            errors.append([rmse(mapper.map, *truth), rmse(baseline.map, *truth)])
            shares.append(coverage(mapper.map, world.log))
        ours, theirs = np.median(errors, axis=0)
        low, high = np.min(errors, axis=0)[0], np.max(errors, axis=0)[0]
        print(
            f"  density {density}: relmap median {ours:.4f} ({low:.4f} to {high:.4f}), "
            f"frame-to-map median {theirs:.4f}, coverage at least {min(shares):.3f}"
        )


def mrpt(data: Path) -> None:
    """Print the landmark RMSE on MRPT's logs."""
    print("MRPT landmark logs, known association, no odometry: landmark RMSE [m]")
    for name in ("kf-slam_demo", "kf-slam_6D_demo", "kf-slam_6D_demo_noncentered"):
        path = data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
        log = open_log(path)
        ids, positions, _ = read_ground_truth(path)
        mapper, baseline = PointMapper(), FrameToMap()
        run(mapper, log)
        run(baseline, log)
        print(
            f"  {name}: relmap {rmse(mapper.map, ids, positions):.4f}, "
            f"frame-to-map {rmse(baseline.map, ids, positions):.4f}, "
            f"coverage {coverage(mapper.map, log):.3f}"
        )


def constant_time() -> None:
    """Print how the time of an iteration changes while the map grows."""
    log = simulate_figure_eight(density=100, iterations=3000).log
    run(PointMapper(), log.between(0, 100))
    times = run(PointMapper(), log)
    warm, last = np.median(times[20:120]), np.median(times[-100:])
    print("figure eight, density 100, 3000 iterations, known association, beyond 20 of warm-up")
    print(f"  last 100 / first 100 iterations, median time: {last / warm:.2f}")


if __name__ == "__main__":
    figure_eight()
    constant_time()
    if len(sys.argv) > 1:
        mrpt(Path(sys.argv[1]))
