"""Refinement: accuracy relative to the limit, time, and consistency of the covariances.

    OMP_NUM_THREADS=1 python benchmarks/refinement.py

Maps the figure eight and prints four tables in markdown; times are processor times. The limit is
batch least squares over all observations with the true ids, written independently
(relmap/comparison/baselines/batch.py).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from time import process_time

import numpy as np
from shared.runs import limit, rmse, true_ids
from shared.tables import header, row

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.datasets import ObservationLog
from relmap.simulation import simulate_figure_eight

SEEDS = range(10)
RUNS = range(50)


@dataclass(frozen=True, eq=False)
class Measured:
    """Time and result of one run."""

    mapper: PointMapper
    true_ids: Ints
    update_s: Floats
    refine_s: float
    live: Floats
    live_ids: Ints

    @property
    def share(self) -> float:
        """Time of refinement as a share of that of mapping."""
        return self.refine_s / float(self.update_s.sum())


def measured(log: ObservationLog, known: bool) -> Measured:
    """Map and refine a log, with its ids or without."""
    mapper, times, labels = PointMapper(), [], []
    for scan in log.scans():
        began = process_time()
        labels.append(mapper.update(scan.points_robot, scan.ids if known else None))
        times.append(process_time() - began)
    mapper.finish()
    live, live_ids = mapper.map.positions, true_ids(mapper, labels, log)
    began = process_time()
    mapper.refine()
    refine_s = process_time() - began
    true = true_ids(mapper, labels, log)
    return Measured(mapper, true, np.array(times), refine_s, live, live_ids)


def accuracy() -> None:
    header("data", "refined / batch", "refined [m]", "live [m]", "refining / mapping time")
    for known, density, sigma in (
        (True, 25, 0.05),
        (True, 25, 0.2),
        (True, 100, 0.05),
        (True, 100, 0.2),
        (False, 25, 0.05),
        (False, 25, 0.2),
    ):
        runs = np.array([figures_of(density, sigma, seed, known) for seed in SEEDS])
        ratio, refined, live, share = np.median(runs, axis=0)
        row(
            f"density {density}, sigma {sigma}, {'known' if known else 'no'} ids",
            f"{ratio:.4f} ({runs[:, 0].max():.4f})",
            f"{refined:.4f}",
            f"{live:.4f}",
            f"{share:.2f}",
        )


def figures_of(density: float, sigma: float, seed: int, known: bool) -> list[float]:
    """Return the RMSE, refined, relative to batch and in metres, that before, and the time."""
    world = simulate_figure_eight(density=density, sigma=sigma, seed=seed)
    run, truth = measured(world.log, known), world.landmarks_map
    refined = rmse(run.mapper.map.positions, truth[run.true_ids])
    return [refined / limit(world), refined, rmse(run.live, truth[run.live_ids]), run.share]


def scaling() -> None:
    """Print the time of refinement over the length of the run."""
    print()
    header("density", "iterations", "refine / map", "per observation [us]")
    for density, iterations in ((25, 900), (25, 9000), (25, 90000), (100, 900), (100, 9000)):
        log = simulate_figure_eight(density=density, iterations=iterations).log
        run = measured(log, known=True)
        us = 1e6 * run.refine_s / len(log.points_robot)
        row(str(density), str(iterations), f"{run.share:.2f}", f"{us:.2f}")


def stalls() -> None:
    """Print the time of the slowest update at density 100."""
    print()
    header("iterations", "slowest update / median")
    for iterations in (900, 3000):
        log = simulate_figure_eight(density=100, iterations=iterations, seed=1).log
        update_s = measured(log, known=True).update_s
        row(str(iterations), f"{update_s.max() / np.median(update_s):.0f}")


def consistency() -> None:
    """Print the squares of the errors over the variances that the map reports; 1 is right."""
    print()
    header("sigma [m]", "x", "y", "z", "standard error")
    for sigma in (0.05, 0.2):
        ratios = []
        for seed in RUNS:
            world = simulate_figure_eight(sigma=sigma, seed=100 + seed)
            run = measured(world.log, known=True)
            start = world.trajectory[0]
            truth = (world.landmarks_map[run.true_ids] - start[:3, 3]) @ start[:3, :3]
            error = run.mapper.map.positions - truth
            variance = np.diagonal(run.mapper.map.covariances, axis1=1, axis2=2)
            ratios.append(np.mean(error**2 / variance, axis=0))
        spread = np.std(ratios, axis=0).mean() / np.sqrt(len(RUNS))
        row(f"{sigma}", *(f"{mean:.2f}" for mean in np.mean(ratios, axis=0)), f"{spread:.2f}")


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.parse_args()
    measured(simulate_figure_eight(density=100, iterations=300).log, known=True)  # compiles
    accuracy()
    consistency()
    stalls()
    scaling()


if __name__ == "__main__":
    main()
