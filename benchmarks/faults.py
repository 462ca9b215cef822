"""Effect of faults of the world and of the sensor on the map.

    python benchmarks/faults.py [--seeds N] [--density D ...]

The figure eight with sigma 0.05 is mapped without a fault and with each fault, with known ids and
without ids; medians and worst of the seeds.  The figure is the RMSE of the refined landmarks that
the fault does not affect, after rigid alignment: landmarks reported twice, and landmarks seen only
during a temporary fault, are left out.  The ratio is to the RMSE of the same landmarks without a
fault; the aim is 1.2.  "Limit" is the same ratio for the log without its wrong observations, as if
all were recognised: a fault also removes observations.  "Covered" is the fraction of the landmarks
seen ten times that are mapped, "rejected" the number of useless iterations that the mapper rejects,
of how many, and the number of others.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from shared import log_faults as faults
from shared.runs import ids_of, mapped, rmse, true_ids
from shared.tables import table
from speed import on_one_core

from relmap.core.arrays import Floats
from relmap.datasets import ObservationLog
from relmap.simulation import FigureEight, simulate_figure_eight

AT, COUNT = 450, 10
"""First iteration of temporary faults, and their duration in iterations."""
OUTLIERS, MISSED, GHOSTS, TWICE = 0.05, 0.1, 0.05, 0.05
SIGMA_M = 0.05
OFTEN = 10


@dataclass(frozen=True, eq=False)
class Fault:
    """A log with a fault, its useless iterations, and the affected landmarks."""

    log: ObservationLog
    useless: np.ndarray
    concerned: np.ndarray


Make = Callable[[ObservationLog, np.random.Generator], Fault]
NONE = np.empty(0, dtype=np.int64)


def plain(make: Callable[[ObservationLog, np.random.Generator], ObservationLog]) -> Make:
    return lambda log, rng: Fault(make(log, rng), NONE, NONE)


def twice(log: ObservationLog, rng: np.random.Generator) -> Fault:
    ids = np.unique(ids_of(log))
    doubled = rng.choice(ids, round(TWICE * len(ids)), replace=False)
    return Fault(faults.duplicated_landmarks(log, doubled, SIGMA_M, rng), NONE, doubled)


def mirrored(log: ObservationLog, rng: np.random.Generator) -> Fault:
    return Fault(faults.mirrored_scan(log, AT), np.array([AT]), NONE)


def together(log: ObservationLog, rng: np.random.Generator) -> Fault:
    """Apply all faults, the temporary ones 100 iterations apart."""
    made = faults.big_step(log, 750, COUNT)
    made = faults.time_backwards(made, 650, COUNT)
    made = faults.few_landmarks(made, 350, COUNT)
    made = faults.lost_scans(made, 250, COUNT)
    made = faults.mirrored_scan(made, AT)
    doubled = twice(made, rng)
    made = faults.missed_detections(doubled.log, MISSED, rng)
    made = faults.ghosts(made, GHOSTS, rng)
    made = faults.gross_outliers(made, OUTLIERS, rng)
    return Fault(made, np.array([AT]), doubled.concerned)


FAULTS: dict[str, Make] = {
    "5 % gross outliers": plain(lambda log, rng: faults.gross_outliers(log, OUTLIERS, rng)),
    "10 % missed": plain(lambda log, rng: faults.missed_detections(log, MISSED, rng)),
    "5 % ghosts": plain(lambda log, rng: faults.ghosts(log, GHOSTS, rng)),
    "5 % reported twice": twice,
    "a scan mirrored": mirrored,
    "ten scans lost": plain(lambda log, rng: faults.lost_scans(log, AT, COUNT)),
    "ten scans of two": plain(lambda log, rng: faults.few_landmarks(log, AT, COUNT)),
    "a step ten times as far": plain(lambda log, rng: faults.big_step(log, AT, COUNT)),
    "ten scans backwards": plain(lambda log, rng: faults.time_backwards(log, AT, COUNT)),
    "all together": together,
}


@dataclass(frozen=True, eq=False)
class Mapped:
    """A result: positions and true ids of the mapped landmarks, submaps and rejected iterations."""

    positions: np.ndarray
    true_ids: np.ndarray
    submaps: int
    rejected: np.ndarray


def outcome(log: ObservationLog, known: bool) -> Mapped:
    mapper, labels = mapped(log, known)
    true = true_ids(mapper, labels, log)
    return Mapped(mapper.map.positions, true, len(mapper.submaps), mapper.rejected)


def error(result: Mapped, world: FigureEight, ids: np.ndarray) -> float:
    """Return the RMSE, metres, of the landmarks with some ids, after rigid alignment of them."""
    chosen = np.isin(result.true_ids, ids)
    return rmse(result.positions[chosen], world.landmarks_map[result.true_ids[chosen]])


def what_is_right(log: ObservationLog, true: ObservationLog) -> ObservationLog:
    """Return the observations of a log that are also, with the same id, in the true one."""
    whole = [np.column_stack([ids_of(one), one.points_robot]) for one in (true, log)]
    there = {row.tobytes() for row in whole[0]}
    right = np.array([row.tobytes() in there for row in whole[1]])
    parts = log.points_robot[right], log.iteration[right], log.rows[right]
    return ObservationLog(*parts, log.first_iteration, log.end_iteration, ids_of(log)[right])


def loss(world: FigureEight, sound: Mapped, make: Make, known: bool, seed: int) -> list[float]:
    """Return RMSE, ratio, limit, coverage, submaps, and iterations rejected, useless, wrong."""
    fault = make(world.log, np.random.default_rng([seed, 1]))
    result = outcome(fault.log, known)
    right = what_is_right(fault.log, world.log)
    limit = result if len(ids_of(right)) == len(ids_of(fault.log)) else outcome(right, known)
    ids, counts = np.unique(ids_of(fault.log), return_counts=True)
    due = ids[(counts >= OFTEN) & (ids < len(world.landmark_ids))]
    due = np.setdiff1d(due, fault.concerned)
    both = due[np.isin(due, result.true_ids) & np.isin(due, sound.true_ids)]
    off, before = error(result, world, both), error(sound, world, both)
    best = error(limit, world, both[np.isin(both, limit.true_ids)])
    found = np.isin(result.rejected, fault.useless).sum()
    covered = np.isin(due, result.true_ids).mean()
    named = [found, len(fault.useless), len(result.rejected) - found]
    return [off, off / before, best / before, covered, result.submaps, *named]


def compare(density: float, known: bool, seeds: range) -> dict[str, Floats]:
    """Return the figures (seeds, 8) of each fault; see `loss`."""
    found: dict[str, list[list[float]]] = {name: [] for name in FAULTS}
    for seed in seeds:
        world = simulate_figure_eight(density=density, sigma=SIGMA_M, seed=seed)
        sound = outcome(world.log, known)
        for name, make in FAULTS.items():
            found[name].append(loss(world, sound, make, known, seed))
    return {name: np.array(figures) for name, figures in found.items()}


def ratio_cell(figures: Floats) -> str:
    """Return the median ratio, the worst, and the median of the limit."""
    ratio, limit = figures[:, 1], figures[:, 2]
    return f"{np.median(ratio):.2f} ({ratio.max():.2f}) / {np.median(limit):.2f}"


def found_cell(figures: Floats) -> str:
    """Return the least coverage, the maximum number of submaps, and the rejected iterations."""
    covered, submaps = figures[:, 3].min(), figures[:, 4].max()
    right, useless, wrong = figures[:, 5:].sum(axis=0)
    rejected = f"{right:.0f} of {useless:.0f}, {wrong:.0f} others"
    return f"{covered:.3f}; {submaps:.0f}; {rejected}"


def main(densities: list[float], seeds: range) -> None:
    """Print the table of errors, and that of coverage and rejected iterations."""
    of = {
        f"density {density:g}, {'known' if known else 'no'} ids": compare(density, known, seeds)
        for density in densities
        for known in (True, False)
    }
    for title, cell in (
        ("RMSE / RMSE without the fault, median (worst) / limit", ratio_cell),
        ("Least covered; most submaps; rejected", found_cell),
    ):
        rows = [[name, *(cell(found[name]) for found in of.values())] for name in FAULTS]
        table(title, ["fault", *of], rows)


if __name__ == "__main__":
    on_one_core()
    parser = argparse.ArgumentParser(description="Measure the effect of faults on the map.")
    parser.add_argument("--first", type=int, default=10, help="first seed; 0 to 2 chose settings")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--density", type=float, nargs="+", default=[25.0, 100.0])
    arguments = parser.parse_args()
    main(arguments.density, range(arguments.first, arguments.first + arguments.seeds))
