"""Regression gate, `make bench`: ratios compared with a committed baseline.

    python benchmarks/gate.py [--update]

Each figure is a ratio, comparable between machines, with the direction in which it is better and
its tolerance relative to `gate_baseline.json`.  Accuracy is the same in every run; times are
processor time, the best of several runs.  The exit code is 1 if a figure is worse than allowed.
--update writes a new baseline.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from relmap.comparison.methods.registry import find_method
from relmap.comparison.methods.running import run_method
from relmap.evaluation.feeding import Association
from relmap.evaluation.sources import BuildingSource, EightSource, Source
from relmap.simulation import WorldSpec, simulate_world

BASELINE = Path(__file__).with_name("gate_baseline.json")
SEEDS = range(5)
REPEATS = 3
ACCURATE, TIMED = 0.03, 0.35
"""Relative tolerances of accuracy and time."""
WORLDS = (
    "streets",
    "corridor",
    "line",
    "clumps",
    "columns",
    "stairs",
    "missed-spurious",
    "turns-40",
)
"""Worlds of `worlds.py`."""
OURS, LIVE, EKF, PLAIN = "relmap-points", "relmap-points-live", "ekf-mrpt", "frame-to-map"


@dataclass(frozen=True)
class Metric:
    """A figure, the direction in which it is better, and how much worse it may be."""

    name: str
    better: str  # "lower" or "higher"
    tolerance: float
    measure: Callable[[], float]


def figure(method: str, source: Source, name: str, association: Association = "known") -> float:
    value = run_method(find_method(method), source.load(), association).figures[name]
    return float("nan") if value is None else value


def errors(method: str, sources: Iterable[Source]) -> np.ndarray:
    return np.array([figure(method, source, "landmark_rmse_m") for source in sources])


def eights(**settings: Any) -> list[EightSource]:
    return [EightSource(seed=seed, **settings) for seed in SEEDS]


def error_ratio(method: str, other: str) -> float:
    """Return the median over the seeds of the error of one method over that of another."""
    return float(np.median(errors(method, eights()) / errors(other, eights())))


def moving_ratio() -> float:
    """Return the median error with 40 % moving landmarks over that with none."""
    moving = np.median(errors(OURS, eights(dynamic=0.4)))
    return float(moving / np.median(errors(OURS, eights())))


def worst_without_ids(name: str, worst: Callable[[list[float]], float]) -> float:
    return worst([figure(OURS, s, name, "nearest") for s in eights()])


def time_ratio(method: str, other: str, name: str) -> float:
    """Return the time of one method over that of another, each the best of some runs."""
    source = EightSource()
    times = [[figure(m, source, name) for m in (method, other)] for _ in range(REPEATS)]
    mine, its = np.min(times, axis=0)
    return float(mine / its)


def growth() -> float:
    """Return the time of the last 100 iterations over that of all, at density 100."""
    source = EightSource(density=100.0, iterations=1800)
    data = source.load()
    runs = [run_method(find_method(OURS), data, "known") for _ in range(REPEATS)]
    last, whole = "last_100_median_ms", "median_ms"
    return min((run.figures[last] or np.nan) / (run.figures[whole] or np.nan) for run in runs)


def corner_ratio() -> float:
    """Return the corner error of the refined walls over that of the paper's recipe."""
    source = BuildingSource(iterations=80)
    pair = [
        figure(method, source, "corner_rmse_m", "nearest")
        for method in ("relmap-planes", "relmap-planes-paper")
    ]
    return pair[0] / pair[1]


@cache
def worlds() -> list[dict[str, float]]:
    """Return the figures of worlds that are hard to associate, mapped without ids."""
    from worlds import WORLDS as SPECS
    from worlds import judge

    settings: dict[str, Any] = SPECS
    specs = [WorldSpec(**settings[name], seed=0) for name in WORLDS]
    return [judge(simulate_world(spec), with_covariances=False) for spec in specs]


def worst_world(name: str, worst: Callable[[Iterable[float]], float], of: str = "") -> float:
    """Return the worst figure of all worlds, divided by another one of the world if given."""
    return worst(found[name] / (found[of] if of else 1.0) for found in worlds())


FIGURES: dict[str, tuple[Any, ...]] = {
    "landmark error, refined over batch": ("lower", ACCURATE, error_ratio, OURS, "batch"),
    "landmark error, live over batch": ("lower", ACCURATE, error_ratio, LIVE, "batch"),
    "landmark error, EKF as MRPT ships it over refined": (
        "higher", ACCURATE, error_ratio, EKF, OURS
    ),
    "landmark error, refined, 40 % moving over none": ("lower", ACCURATE, moving_ratio),
    "purity without ids, worst seed": ("higher", 0.001, worst_without_ids, "purity", min),
    "landmarks per true one without ids, worst seed": (
        "lower", ACCURATE, worst_without_ids, "landmarks_per_true", max
    ),
    "worlds without ids, error over batch, worst submap": (
        "lower", 0.1, worst_world, "worst", max
    ),
    "worlds without ids, purity over the limit, worst": (
        "higher", 0.005, worst_world, "purity", min, "oracle"
    ),
    "worlds without ids, landmarks mapped, worst": ("higher", 0.02, worst_world, "mapped", min),
    "corner error, refined over the paper's recipe": ("lower", 0.2, corner_ratio),
    "time of an iteration, median, relmap over frame-to-map": (
        "lower", TIMED, time_ratio, OURS, PLAIN, "median_ms"
    ),
    "time of the log, relmap over frame-to-map": (
        "lower", TIMED, time_ratio, OURS, PLAIN, "total_s"
    ),
    "time of the last 100 iterations, EKF over relmap": (
        "higher", TIMED, time_ratio, EKF, OURS, "last_100_median_ms"
    ),
    "time of an iteration, last 100 over all, density 100": ("lower", TIMED, growth),
}  # fmt: skip
"""The direction and tolerance of each figure, and what measures it of which arguments."""
METRICS = tuple(
    Metric(name, better, tolerance, partial(measure, *given))
    for name, (better, tolerance, measure, *given) in FIGURES.items()
)


def is_worse(value: float, baseline: float, better: str, tolerance: float) -> bool:
    """Return whether a figure is worse than the baseline by more than the tolerance."""
    if not np.isfinite(value):
        return True
    if better == "lower":
        return value > baseline * (1 + tolerance)
    return value < baseline * (1 - tolerance)


def gate(measured: dict[str, float], baseline: dict[str, dict[str, Any]]) -> list[str]:
    """Print every figure beside its baseline; return the names of those that got worse."""
    print(f"{'figure':58}  {'found':>8}  {'baseline':>8}  better   may be worse by")
    worse = []
    for name, value in measured.items():
        if name not in baseline:
            print(f"{name:58}  {value:8.4g}  {'-':>8}  (no baseline: run with --update)")
            worse.append(name)
            continue
        known = baseline[name]
        bad = is_worse(value, known["value"], known["better"], known["tolerance"])
        print(
            f"{name:58}  {value:8.4g}  {known['value']:8.4g}  {known['better']:7}  "
            f"{100 * known['tolerance']:.3g} %{'   WORSE' if bad else ''}"
        )
        if bad:
            worse.append(name)
    return worse


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--update", action="store_true", help="write a new baseline")
    update = parser.parse_args().update
    measured = {metric.name: metric.measure() for metric in METRICS}
    if update:
        baseline = {
            metric.name: {
                "value": float(f"{measured[metric.name]:.5g}"),
                "better": metric.better,
                "tolerance": metric.tolerance,
            }
            for metric in METRICS
        }
        BASELINE.write_text(json.dumps(baseline, indent=2) + "\n")
    worse = gate(measured, json.loads(BASELINE.read_text()))
    if worse:
        print(f"worse than the baseline: {'; '.join(worse)}", file=sys.stderr)
    return 1 if worse else 0


if __name__ == "__main__":
    raise SystemExit(main())
