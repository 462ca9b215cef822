"""relmap compared with other methods.

    OMP_NUM_THREADS=1 python benchmarks/comparison.py [--seeds 10]

The figure eight, density 25, sigma 0.05 m, known ids; landmark RMSE of the static landmarks after
rigid alignment, median over the seeds.  Times are processor time with one thread.
Methods of the extra `relmap[peers]` are left out, and named, if it is not installed.

Moving landmarks: *taken out* is the same log without their observations, so the ratio shows their
effect on the map, not that of fewer landmarks.  The second ratio is to a world in which all
landmarks are static, which are more.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from shared.runs import ids_of
from shared.tables import table
from speed import on_one_core

from relmap.comparison.methods.registry import METHODS, find_method
from relmap.comparison.methods.running import run_method
from relmap.datasets import ObservationLog
from relmap.evaluation.sources import Data, EightSource

MAPPING = [
    method.name
    for method in METHODS
    if "landmarks" in method.logs and method.name not in ("kiss-icp", "small-gicp")
]
MOVING = ("relmap-points", "relmap-points-live", "ekf-mrpt", "ekf", "frame-to-map")
SHARE = 0.4

World = Data[ObservationLog]
Figures = dict[str, float | None]


def installed() -> list[str]:
    missing = {name: find_method(name).missing for name in MAPPING}
    for name, what in missing.items():
        if what:
            print(f"{name} is left out: {what}")
    return [name for name in MAPPING if not missing[name]]


def worlds(seeds: int, **settings: Any) -> list[World]:
    return [EightSource(seed=seed, **settings).load() for seed in range(seeds)]


def measured(names: Sequence[str], data: list[World]) -> dict[str, list[Figures]]:
    """Return the figures of each method in each world."""
    found: dict[str, list[Figures]] = {name: [] for name in names}
    for world in data:
        for name in names:
            found[name].append(run_method(find_method(name), world, "known", 0.05).figures)
    return found


def median(runs: list[Figures], name: str) -> float:
    return float(np.median([run[name] for run in runs]))


def accuracy_and_time(names: list[str], seeds: int) -> None:
    for noise in ("gaussian", "uniform"):
        found = measured(names, worlds(seeds, noise=noise))
        ours, limit = found["relmap-points"], found["batch"]
        rows = []
        for name, runs in found.items():
            error, end = (median(runs, key) for key in ("landmark_rmse_m", "last_100_median_ms"))
            rows.append(
                [
                    name,
                    f"{error:.4f}",
                    f"{error / median(limit, 'landmark_rmse_m'):.3f}",
                    f"{error / median(ours, 'landmark_rmse_m'):.2f}",
                    f"{median(runs, 'matched'):.0f}",
                    f"{median(runs, 'ate_m'):.3f}",
                    f"{end:.3f}",
                    f"{end / median(ours, 'last_100_median_ms'):.3g}",
                    f"{median(runs, 'mean_ms'):.3f}",
                    f"{median(runs, 'total_s'):.2f}",
                ]
            )
        header = ["method", "RMSE [m]", "/ batch", "/ relmap", "landmarks", "ATE [m]"]
        header += ["last 100 iterations, median [ms]", "/ relmap", "mean [ms]", "whole log [s]"]
        table(f"{noise} noise, density 25, sigma 0.05, seeds 0-{seeds - 1}, medians", header, rows)


def without_moving(world: World) -> World:
    """Remove the observations of moving landmarks."""
    log, truth = world.log, world.truth
    assert truth is not None
    seen = np.isin(ids_of(log), truth.landmark_ids[truth.status == "static"])
    columns = ("points_robot", "iteration", "rows", "ids")
    kept = {name: getattr(log, name)[seen] for name in columns}
    return Data(replace(log, **kept), truth)


def moving(seeds: int) -> None:
    data = worlds(seeds, dynamic=SHARE)
    with_movers = measured(MOVING, data)
    taken_out = measured(MOVING, [without_moving(world) for world in data])
    none_moves = measured(MOVING, worlds(seeds))
    rows = []
    for name in MOVING:
        error, static, none = (
            median(found[name], "landmark_rmse_m") for found in (with_movers, taken_out, none_moves)
        )
        rows.append(
            [
                name,
                f"{error:.4f}",
                f"{static:.4f}",
                f"{error / static:.3f}",
                f"{none:.4f}",
                f"{error / none:.3f}",
                f"{median(with_movers[name], 'coverage'):.0%}",
            ]
        )
    header = ["method", f"{SHARE:.0%} moving [m]", "taken out [m]", "ratio"]
    header += ["none moves [m]", "ratio", "mapped"]
    table(f"moving landmarks, seeds 0-{seeds - 1}, medians", header, rows)


if __name__ == "__main__":
    on_one_core()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    arguments = parser.parse_args()
    accuracy_and_time(installed(), arguments.seeds)
    moving(arguments.seeds)
