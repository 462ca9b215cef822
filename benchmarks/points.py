"""Accuracy and time of the point mapper: the figures of docs/benchmarks.md.

    python benchmarks/points.py [DATA]

DATA is a folder with the real data sets (mrpt-kf-slam); without it those rows are left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from shared.runs import ids_of, limit, mapped, rmse, true_ids
from shared.tables import header, row

from relmap import PointMapper
from relmap.comparison.baselines.frames import FrameToMap
from relmap.core.arrays import positions_of
from relmap.datasets import ObservationLog, open_log
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.evaluation.metrics import purity
from relmap.simulation import simulate_figure_eight

SEEDS = range(10)


def run(mapper: PointMapper | FrameToMap, log: ObservationLog) -> None:
    """Map a log with known association."""
    for scan in log.scans():
        mapper.update(scan.points_robot, scan.ids)
    mapper.finish()


def coverage(mapped_ids: np.ndarray, log: ObservationLog) -> float:
    """Return the share of the landmarks seen ten times that are mapped."""
    ids, counts = np.unique(ids_of(log), return_counts=True)
    return float(np.isin(ids[(counts >= 10) & (ids >= 0)], mapped_ids).mean())


def known(log: ObservationLog, ids: np.ndarray, truth: np.ndarray) -> tuple[list[float], float]:
    """Return the RMSE chained, refined and of frame-to-map, and the share mapped."""
    mapper, baseline = PointMapper(), FrameToMap(log.points_robot.shape[1])
    run(mapper, log)
    run(baseline, log)
    maps = [mapper.map]
    mapper.refine()
    maps += [mapper.map, baseline.map]
    errors = [rmse(each.positions, truth[positions_of(ids, each.landmark_ids)]) for each in maps]
    return errors, coverage(mapper.map.landmark_ids, log)


def figure_eight() -> None:
    """Print the landmark RMSE over the seeds with known association."""
    print("\nFigure eight, sigma 0.05, known association, median landmark RMSE of 10 seeds [m]\n")
    header("density", "live [m]", "refined [m]", "frame-to-map [m]", "batch [m]", "mapped")
    for density in (25, 100):
        errors, shares, limits = [], [], []
        for seed in SEEDS:
            world = simulate_figure_eight(density=density, seed=seed)
            found, share = known(world.log, world.landmark_ids, world.landmarks_map)
            errors.append(found)
            shares.append(share)
            limits.append(limit(world))
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
            mapper, labels = mapped(world.log, known=False)
            true = true_ids(mapper, labels, world.log)
            errors.append(rmse(mapper.map.positions, world.landmarks_map[true]))
            per_true.append(len(true) / len(np.unique(true)))
            landmarks = mapper.landmarks_of(np.concatenate(labels))
            purities.append(purity(landmarks, ids_of(world.log)) or 0.0)
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
        true = true_ids(mapper, labels, world.log)
        errors.append(rmse(mapper.map.positions, world.landmarks_map[true]))
    return [error / errors[-1] for error in errors[:-1]]


def mrpt(data: Path) -> None:
    """Print the landmark RMSE on MRPT's logs."""
    print("\nMRPT landmark logs, known association, no odometry: landmark RMSE [m]\n")
    header("log", "live [m]", "refined [m]", "frame-to-map [m]", "mapped")
    for name in ("kf-slam_demo", "kf-slam_6D_demo", "kf-slam_6D_demo_noncentered"):
        path = data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
        ids, positions, _ = read_ground_truth(path)
        (chained, refined, theirs), share = known(open_log(path), ids, positions)
        row(name, *(f"{error:.4f}" for error in (chained, refined, theirs)), f"{share:.1%}")


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path, help="folder of the real data sets")
    data = parser.parse_args().data
    figure_eight()
    live_map()
    if data is not None:
        mrpt(data)
    figure_eight_without_ids()


if __name__ == "__main__":
    main()
