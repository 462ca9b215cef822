"""Accuracy of maps of walls: simulated buildings, and real laser logs.

    python benchmarks/planes.py [DATA] [--seeds 5] [--only simulated|logs]

prints tables in markdown; DATA is a folder of the real data sets.  `laser.py` measures all laser
logs, including those whose scans are too far apart for one map.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from shared.tables import header, row, table

from relmap import PlaneMapper
from relmap.core.geometry.alignment import fit_rigid
from relmap.datasets import open_scans
from relmap.datasets.scans import ScanLog
from relmap.evaluation import metrics
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.feeding import Fed, feed
from relmap.evaluation.judged_path import relation_errors
from relmap.evaluation.run import result_of
from relmap.evaluation.sources import log_of, truth_of
from relmap.evaluation.truth import Truth, relations_by_clocks
from relmap.planes.pairwise import pairwise_map
from relmap.planes.walls.files import PlaneResult
from relmap.planes.walls.table import PlaneTable
from relmap.simulation import simulate_building

SIGMAS = (0.0, 0.05, 0.1, 0.2)
LOGS = (
    ("freiburg-079", "carmen-laser2d/freiburg-079-corrected.log.gz", (0, 300)),
    ("freiburg-079", "carmen-laser2d/freiburg-079-corrected.log.gz", (0, 800)),
    ("freiburg-079", "carmen-laser2d/freiburg-079-corrected.log.gz", (1600, 2400)),
    ("freiburg-079", "carmen-laser2d/freiburg-079-corrected.log.gz", None),
    ("MRPT simul", "mrpt-sim-laser2d/simul.scans.csv.gz", None),
)
RELATIONS = {"freiburg-079": "carmen-laser2d/fr079.relations"}


@dataclass(frozen=True)
class Figures:
    """Figures of one simulated run: metres, milliseconds of processor time."""

    chained: float
    refined: float
    literal: float
    mapped: float
    false: float
    ate: float
    update_ms: float
    refine_ms: float
    """For 700 iterations."""


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--worlds", nargs="*", default=["building", "panels"])
    parser.add_argument("--sigmas", nargs="*", type=float, default=SIGMAS)
    parser.add_argument("--only", choices=("simulated", "logs"), help="print one table only")
    arguments = parser.parse_args()
    _simulated("building", 0.1, 1000)  # compiles
    if arguments.only in (None, "simulated"):
        _print_simulated(arguments.worlds, arguments.sigmas, arguments.seeds)
    if arguments.data is not None and arguments.only in (None, "logs"):
        _print_logs(arguments.data)


def _print_simulated(worlds: list[str], sigmas: list[float], seeds: int) -> None:
    """Print every run, then the median and the worst of each kind."""
    columns = ["chained [m]", "refined [m]", "literal recipe [m]", "mapped", "false corners"]
    columns += ["ATE [m]", "update [ms]", "refine, 700 iterations [ms]"]
    header("world", "sigma [m]", "seed", *columns)
    found: dict[tuple[str, float], list[Figures]] = {}
    for world in worlds:
        for sigma in sigmas:
            for seed in range(seeds):
                figures = _simulated(world, sigma, seed)
                found.setdefault((world, sigma), []).append(figures)
                row(world, sigma, seed, *_cells([figures]))
    rows = [[*kind, *_cells(runs)] for kind, runs in found.items()]
    table(f"Median (worst) of {seeds} seeds:", ["world", "sigma [m]", *columns], rows)


def _cells(runs: list[Figures]) -> list[str]:
    cells = []
    for name, digits in (
        ("chained", ".3g"),
        ("refined", ".3g"),
        ("literal", ".3g"),
        ("mapped", ".1%"),
        ("false", ".0f"),
        ("ate", ".3g"),
        ("update_ms", ".2f"),
        ("refine_ms", ".0f"),
    ):
        values = [float(getattr(run, name)) for run in runs]
        cell = format(float(np.median(values)), digits)
        if len(runs) > 1:
            worst = min(values) if name == "mapped" else max(values)
            cell += f" ({format(worst, digits)})"
        cells.append(cell)
    return cells


def _simulated(world: Any, sigma: float, seed: int) -> Figures:
    building = simulate_building(sigma=sigma, seed=seed, world=world, sample_ends=sigma == 0.0)
    log, truth = log_of(building), truth_of(building)
    mapper = PlaneMapper()
    result, fed = _mapped(mapper, log)
    chained = evaluate(result, truth)
    literal = _literal(mapper, result.planes, truth)
    began = process_time()
    mapper.refine()
    refine_ms = 1e3 * (process_time() - began) * 700 / len(log)
    known = np.isfinite(mapper.trajectory[:, 0, 0])
    poses, stamps_s = mapper.trajectory[known], log.stamps_s[known]
    found = replace(result, poses=poses, stamps_s=stamps_s, planes=mapper.planes)
    refined = evaluate(found, truth)
    return Figures(
        chained.corner_rmse_m or np.nan,
        refined.corner_rmse_m or np.nan,
        literal,
        refined.coverage or 0.0,
        refined.counts["false_corners"],
        refined.ate_m or np.nan,
        1e3 * float(np.median(fed.durations_s[:, 1])),
        refine_ms,
    )


def _mapped(mapper: PlaneMapper, log: ScanLog, refine: bool = False) -> tuple[PlaneResult, Fed]:
    """Map a log; return the result, and processor times."""
    fed = feed(mapper, log, "nearest", refine, clock=process_time)
    result = result_of(mapper, log, fed.labels, "nearest", log.first_iteration)
    assert isinstance(result, PlaneResult)
    return result, fed


def _literal(mapper: PlaneMapper, planes: PlaneTable, truth: Truth) -> float:
    """Return the corner RMSE of the paper's literal recipe, from the same observations.

    The association is that of the mapper: its corners are compared.
    """
    history = mapper.history
    ends = pairwise_map(history, int(history.plane.max()) + 1)
    at, end = np.nonzero(planes.corner >= 0)
    mapped = np.isfinite(mapper.trajectory[:, 0, 0])
    R, t = fit_rigid(mapper.trajectory[mapped, :2, 3], truth.poses[mapped, :2, 3])
    own = planes.ends[at, end] @ R.T + t
    apart = np.linalg.norm(truth.ends[:, end].swapaxes(0, 1) - own[:, None], axis=2)
    wall = apart.argmin(axis=1)
    placed = ends[planes.plane[at], end]
    known = np.isfinite(placed[:, 0])
    return metrics.aligned_rmse(placed[known], truth.ends[wall, end][known]) or 0.0


def _print_logs(data: Path) -> None:
    print()
    header(
        *("log", "scans", "ATE [m]", "poses", "relations [m]", "relations [deg]"),
        *("walls", "update [ms]", "segment [ms]", "refine [s]"),
    )
    for name, path, interval in LOGS:
        log = open_scans(data / path)
        part = log if interval is None else log.between(*interval)
        scans = "all" if interval is None else f"{interval[0]}:{interval[1]}"
        row(name, scans, *_logged(*_mapped(PlaneMapper(), part, refine=True), part, data, name))


def _logged(result: PlaneResult, fed: Fed, log: ScanLog, data: Path, name: str) -> list[str]:
    assert log.poses is not None
    mine, other = metrics.match_stamps(result.stamps_s, log.stamps_s)
    ate = metrics.ate(result.poses[mine], log.poses[other], planar=True)
    found = ["", ""]
    if name in RELATIONS:
        relations = relations_by_clocks(data / RELATIONS[name])
        errors = relation_errors(result.stamps_s, result.poses, relations)
        if errors is not None:
            found = [f"{errors.shift_m:.3f}", f"{np.rad2deg(errors.turn_rad):.2f}"]
    segment_ms, update_ms = 1e3 * np.median(fed.durations_s, axis=0)
    cells = [f"{ate:.3f}", f"{len(result.poses) / len(log):.1%}", *found]
    cells += [f"{(result.planes.status == 'static').sum()}", f"{update_ms:.2f}"]
    return [*cells, f"{segment_ms:.2f}", f"{fed.refine_s:.1f}"]


if __name__ == "__main__":
    main()
