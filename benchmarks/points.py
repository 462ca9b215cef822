"""Accuracy and time of the point mapper: the figures of docs/benchmarks.md.

    python benchmarks/points.py [DATA]

DATA is a folder with the real data sets (mrpt-kf-slam); without it those rows are left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import perf_counter

import numpy as np

from relmap import PointMapper
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.comparison.baselines.frame_to_map import FrameToMap
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.landmarks import LandmarkMap
from relmap.datasets import ObservationLog, open_log
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.evaluation.metrics import majority_ids, purity
from relmap.simulation import FigureEight, simulate_figure_eight

SEEDS = range(10)


def rmse(result: LandmarkMap, true_ids: np.ndarray, ids: np.ndarray, truth: np.ndarray) -> float:
    """Return the landmark RMSE, metres, after rigid alignment; true_ids are the map's, (m,)."""
    row_of = {label: row for row, label in enumerate(ids.tolist())}
    there = truth[[row_of[label] for label in true_ids.tolist()]]
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


def coverage(mapped_ids: np.ndarray, log: ObservationLog) -> float:
    """Return the share of the landmarks seen ten times that are mapped."""
    ids, counts = np.unique(log.ids[log.ids >= 0], return_counts=True)
    return float(np.isin(ids[counts >= 10], mapped_ids).mean())


def known(log: ObservationLog, ids: np.ndarray, truth: np.ndarray) -> tuple[list[float], float]:
    """Return the RMSE chained, refined and of frame-to-map, and the share mapped."""
    mapper, baseline = PointMapper(), FrameToMap()
    run(mapper, log)
    run(baseline, log)
    result = mapper.map
    chained = rmse(result, result.landmark_ids, ids, truth)
    mapper.refine()
    refined = rmse(mapper.map, result.landmark_ids, ids, truth)
    theirs = rmse(baseline.map, baseline.map.landmark_ids, ids, truth)
    return [chained, refined, theirs], coverage(result.landmark_ids, log)


def batch(world: FigureEight) -> float:
    """Return the RMSE of batch least squares over all observations, with the true ids."""
    log = world.log
    observations = Batch(log.points_robot, log.iteration, log.ids)
    positions = batch_least_squares(observations, world.landmarks_map)
    result = LandmarkMap(world.landmark_ids, positions)
    return rmse(result, world.landmark_ids, world.landmark_ids, world.landmarks_map)


def header(*names: str) -> None:
    row(*names)
    row(*["---"] * len(names))


def row(*cells: object) -> None:
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def figure_eight() -> None:
    """Print the landmark RMSE over the seeds with known association."""
    print("\nFigure eight, sigma 0.05, known association, median landmark RMSE of 10 seeds [m]\n")
    header("density", "live", "refined", "frame-to-map", "batch", "mapped")
    for density in (25, 100):
        errors, shares, limits = [], [], []
        for seed in SEEDS:
            world = simulate_figure_eight(density=density, seed=seed)
            found, share = known(world.log, world.landmark_ids, world.landmarks_map)
            errors.append(found)
            shares.append(share)
            limits.append(batch(world))
        chained, refined, theirs = np.median(errors, axis=0)
        errors_m = (chained, refined, theirs, np.median(limits))
        row(density, *(f"{error:.4f}" for error in errors_m), f"{min(shares):.1%}")


def figure_eight_without_ids() -> None:
    """Print the figures of the figure eight without ids."""
    print("\nFigure eight, sigma 0.05, no ids, refined, seeds 0-4\n")
    names = ("RMSE, median [m]", "landmarks per true one, worst", "purity, worst")
    header("density", "loops", *names)
    for density, iterations in ((25, 900), (25, 1800), (100, 900), (100, 1800)):
        errors, per_true, purities = [], [], []
        for seed in range(5):
            world = simulate_figure_eight(density=density, iterations=iterations, seed=seed)
            mapper = PointMapper()
            labels = [mapper.update(scan.points_robot) for scan in world.log.scans()]
            mapper.finish()
            mapper.refine()
            landmarks = mapper.landmarks_of(np.concatenate(labels))
            stands_for = dict(zip(*majority_ids(landmarks, world.log.ids)[:2], strict=True))
            true = np.array([stands_for[label] for label in mapper.map.landmark_ids])
            errors.append(rmse(mapper.map, true, world.landmark_ids, world.landmarks_map))
            per_true.append(len(true) / len(np.unique(true)))
            purities.append(purity(landmarks, world.log.ids))
        figures = (f"{np.median(errors):.4f}", f"{max(per_true):.3f}", f"{min(purities):.5f}")
        row(density, iterations // 900, *figures)


def live_map() -> None:
    """Print the final error of the live map of the figure eight, relative to the refined one."""
    print("\nFigure eight, density 25, sigma 0.05, seeds 0-39: error before refinement / after\n")
    header("association", "last update, median (worst)", "finished, median (worst)")
    for association in ("known", "nearest"):
        found = np.array([behind(seed, association == "known") for seed in range(40)])
        typical, worst = np.median(found, axis=0), found.max(axis=0)
        row(association, *(f"{a:.2f} ({b:.2f})" for a, b in zip(typical, worst, strict=True)))


def behind(seed: int, known: bool) -> list[float]:
    """Return the RMSE after the last update and when finished, as multiples of the refined."""
    world, mapper = simulate_figure_eight(density=25, seed=seed), PointMapper()
    scans = world.log.scans()
    labels = [mapper.update(scan.points_robot, scan.ids if known else None) for scan in scans]
    errors = []
    for step in (None, mapper.finish, mapper.refine):
        if step is not None:
            step()
        of = mapper.landmarks_of(np.concatenate(labels))
        stands_for = dict(zip(*majority_ids(of, world.log.ids)[:2], strict=True))
        true = np.array([stands_for[label] for label in mapper.map.landmark_ids.tolist()])
        errors.append(rmse(mapper.map, true, world.landmark_ids, world.landmarks_map))
    return [error / errors[-1] for error in errors[:-1]]


def mrpt(data: Path) -> None:
    """Print the landmark RMSE on MRPT's logs."""
    print("\nMRPT landmark logs, known association, no odometry: landmark RMSE [m]\n")
    header("log", "live", "refined", "frame-to-map", "mapped")
    for name in ("kf-slam_demo", "kf-slam_6D_demo", "kf-slam_6D_demo_noncentered"):
        path = data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
        ids, positions, _ = read_ground_truth(path)
        (chained, refined, theirs), share = known(open_log(path), ids, positions)
        row(name, *(f"{error:.4f}" for error in (chained, refined, theirs)), f"{share:.1%}")


def constant_time() -> None:
    """Print the time of an iteration as the map grows."""
    log = simulate_figure_eight(density=100, iterations=3000).log
    run(PointMapper(), log.between(0, 100))
    times = run(PointMapper(), log)
    warm, last = np.median(times[20:120]), np.median(times[-100:])
    print("\nFigure eight, density 100, 3000 iterations, known association, after 20 of warm-up:")
    print(f"last 100 / first 100 iterations, median time: {last / warm:.2f}", flush=True)


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path, help="folder of the real data sets")
    data = parser.parse_args().data
    figure_eight()
    live_map()
    constant_time()
    if data is not None:
        mrpt(data)
    figure_eight_without_ids()


if __name__ == "__main__":
    main()
