"""How near to the limit refinement comes, what it costs, and how sure the map is.

    python benchmarks/refinement.py [DATA]

Prints the table of all bars as markdown; times are processor times (set OMP_NUM_THREADS=1).  DATA
is a folder with the real data sets (mrpt-kf-slam, victoria-park); without it those rows are left
out.  The limit is batch least squares over all observations with the true ids, written
independently (relmap/evaluation/baselines/batch.py).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from relmap import PointMapper
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.comparison.baselines.known import least_squares_map
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.landmarks import LandmarkMap
from relmap.datasets import ObservationLog, open_log
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.evaluation import metrics
from relmap.evaluation.landmarks import identify
from relmap.evaluation.run import run_mapper
from relmap.simulation import FigureEight, simulate_figure_eight

SEEDS = range(10)
RUNS = range(50)
INTERVALS = ((1181, 1642), (4220, 4634))


@dataclass(frozen=True, eq=False)
class Measured:
    """One run: what it took, and what came of it."""

    mapper: PointMapper
    true_ids: Ints
    update_s: Floats
    refine_s: float
    sd_s: float
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
    live, live_ids = mapper.map.positions, true_ids(mapper, labels, log, known)
    began = process_time()
    mapper.refine()
    refined = process_time()
    _ = mapper.map
    ended = process_time()
    true = true_ids(mapper, labels, log, known)
    times_s = np.array(times), refined - began, ended - refined
    return Measured(mapper, true, *times_s, live, live_ids)


def true_ids(mapper: PointMapper, labels: list[Ints], log: ObservationLog, known: bool) -> Ints:
    """Return who the mapped landmarks (m,) are."""
    found = mapper.map.landmark_ids
    if known:
        return found
    of = mapper.landmarks_of(np.concatenate(labels))
    stands_for = dict(zip(*metrics.majority_ids(of, log.ids)[:2], strict=True))
    return np.array([stands_for[label] for label in found.tolist()])


def rmse(positions: Floats, truth: Floats) -> float:
    """Return the RMSE, metres, after rigid alignment."""
    R, t = fit_rigid(positions, truth)
    return float(np.sqrt(np.mean(np.sum((positions @ R.T + t - truth) ** 2, axis=1))))


def limit(world: FigureEight) -> float:
    """Return the RMSE of batch least squares with the true ids."""
    log = world.log
    batch = Batch(log.points_robot, log.iteration, log.ids)
    return rmse(batch_least_squares(batch, world.landmarks_map), world.landmarks_map)


def row(bar: str, found: str, asked: str) -> None:
    print(f"| {bar} | {found} | {asked} |", flush=True)


def accuracy() -> None:
    for density, sigma, known in (
        (25, 0.05, True),
        (25, 0.2, True),
        (100, 0.05, True),
        (100, 0.2, True),
        (25, 0.05, False),
        (25, 0.2, False),
    ):
        live, ratios, refined, shares = [], [], [], []
        for seed in SEEDS:
            world = simulate_figure_eight(density=density, sigma=sigma, seed=seed)
            run, best = measured(world.log, known), limit(world)
            truth = world.landmarks_map[run.true_ids]
            refined.append(rmse(run.mapper.map.positions, truth))
            live.append(rmse(run.live, world.landmarks_map[run.live_ids]))
            ratios.append(refined[-1] / best)
            shares.append(run.share)
        ids = "known ids" if known else "no ids"
        name = f"figure eight, density {density}, sigma {sigma}, {ids}, 10 seeds"
        row(
            f"{name}: RMSE / batch, median (worst)",
            f"{np.median(ratios):.4f} ({max(ratios):.4f})",
            "1.02" if known else "1.15",
        )
        row(
            f"{name}: RMSE refined, live [m]",
            f"{np.median(refined):.4f}, {np.median(live):.4f}",
            "",
        )
        row(f"{name}: time / mapping time, median", f"{np.median(shares):.3f}", "0.25")


def scaling() -> None:
    for density, iterations in ((25, 900), (25, 9000), (25, 90000), (100, 900), (100, 9000)):
        log = simulate_figure_eight(density=density, iterations=iterations).log
        run = measured(log, known=True)
        per_observation = 1e6 * run.refine_s / len(log.points_robot)
        row(
            f"density {density}, {iterations} iterations: refine [s], "
            "of mapping time, per observation [us], covariances [s]",
            f"{run.refine_s:.3f}, {run.share:.3f}, {per_observation:.2f}, {run.sd_s:.3f}",
            "0.25 of mapping; linear",
        )


def stalls() -> None:
    for iterations in (900, 3000):
        log = simulate_figure_eight(density=100, iterations=iterations, seed=1).log
        update_s = measured(log, known=True).update_s
        row(
            f"density 100, {iterations} iterations: longest update / median",
            f"{update_s.max() / np.median(update_s):.0f}",
            "50",
        )


def consistency() -> None:
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
        x, y, z = np.mean(ratios, axis=0)
        spread = np.std(ratios, axis=0).mean() / np.sqrt(len(RUNS))
        row(
            f"normalised error squared, 50 runs, sigma {sigma}, axes x, y, z (scatter of the mean)",
            f"{x:.2f}, {y:.2f}, {z:.2f} ({spread:.2f})",
            "0.8-1.25",
        )


def exactness() -> None:
    world = simulate_figure_eight(sigma=0.0)
    run = measured(world.log, known=True)
    error = rmse(run.mapper.map.positions, world.landmarks_map[run.true_ids])
    row("sigma 0: RMSE [m]", f"{error:.1e}", "1e-9")


def mrpt(data: Path) -> None:
    for name in ("kf-slam_demo", "kf-slam_6D_demo", "kf-slam_6D_demo_noncentered"):
        path = data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
        ids, positions, _ = read_ground_truth(path)
        run = measured(open_log(path), known=True)
        row_of = {label: place for place, label in enumerate(ids.tolist())}
        truth = positions[[row_of[label] for label in run.true_ids.tolist()]]
        asked = "0.0063" if "6D" in name else ""
        row(
            f"MRPT {name}: RMSE refined, live [m]",
            f"{rmse(run.mapper.map.positions, truth):.4f}, {rmse(run.live, truth):.4f}",
            asked,
        )


def victoria_park(data: Path) -> None:
    log = open_log(data / "victoria-park")
    for begin, end in INTERVALS:
        part = log.between(begin, end)
        reference = least_squares_map(part)
        result = run_mapper(PointMapper(), part, "nearest", refine=True).result
        found = identify(result, part)
        labels, majority, _ = metrics.majority_ids(found.landmark, found.true_id)
        table = result.landmarks
        rows = np.flatnonzero(result.mapped & np.isin(table.landmark, labels))
        ids = majority[np.searchsorted(labels, table.landmark[rows])]
        error = rmse_of(ids, table.position[rows, :2], reference)
        row(f"Victoria Park {begin}:{end}, no ids: RMSE of all tracks [m]", f"{error:.3f}", "")


def rmse_of(ids: Ints, positions: Floats, reference: LandmarkMap) -> float:
    """Return the RMSE, metres, of positions (n, 2) of what the reference knows."""
    there = np.isin(ids, reference.landmark_ids)
    at = np.searchsorted(reference.landmark_ids, ids[there])
    return rmse(positions[there], reference.positions[at, :2])


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path, help="folder of the real data sets")
    data = parser.parse_args().data
    measured(simulate_figure_eight(density=100, iterations=300).log, known=True)  # compiles
    print("| bar | found | asked |\n|---|---|---|")
    accuracy()
    exactness()
    consistency()
    stalls()
    if data is not None:
        mrpt(data)
        victoria_park(data)
    scaling()


if __name__ == "__main__":
    main()
