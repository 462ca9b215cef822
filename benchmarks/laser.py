"""Maps of laser logs without odometry: real logs, harder variants, simulated worlds.

    OMP_NUM_THREADS=1 python benchmarks/laser.py DATA [--log NAME] [--scans A:B] [--seeds 2]

prints two tables in markdown, of real and of simulated logs; DATA is a folder of the real data
sets. Each log is mapped whole, with default settings. Errors are against the poses of the log;
scans without a pose are left out. Times are processor time.

  right        share of the scans in submaps of at least ten whose own ATE is at most 0.3 m
  wrong steps  consecutive scans of one submap whose relative pose is off by more than 0.3 m or
               10 degrees; disputed: with the poses of the map a tenth more points match those
               of the previous scan than with the poses of the log, which may be wrong
  unlisted, listed
               the other wrong steps that are not in `weak_links`, and right ones that are
  relations, at scans
               errors of all relations checked by hand, and of those whose ends lie within 0.03 s of
               a scan: the path is interpolated to the others
  found, true, doubled
               shares of the length of walls: of the true ones over 0.5 m that were seen and are
               mapped; of the mapped ones over 0.5 m that are true; and that are mapped twice
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from shared.judging import judged, judged_cells
from shared.log_faults import composed

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.datasets import open_scans
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import Fed, feed
from relmap.evaluation.judged_path import AT_SCANS_S, relation_errors
from relmap.evaluation.sources import log_of, truth_of
from relmap.evaluation.truth import Truth, relations_by_clocks
from relmap.evaluation.walls import judge_walls, match_corners
from relmap.simulation import simulate_building
from relmap.simulation.sensor import Sensor

CARMEN = "carmen-laser2d"
LOGS = {
    "freiburg-079": f"{CARMEN}/freiburg-079-corrected.log.gz",
    "fr079": f"{CARMEN}/fr079.log.gz",
    "mit-cscail": f"{CARMEN}/mit-cscail.log.gz",
    "belgioioso": f"{CARMEN}/belgioioso-corrected.log.gz",
    "csail": f"{CARMEN}/csail-corrected.log.gz",
    "edmonton": f"{CARMEN}/edmonton-corrected.log.gz",
    "fhw": f"{CARMEN}/fhw-corrected.log.gz",
    "freiburg-101": f"{CARMEN}/freiburg-101-corrected.log.gz",
    "orebro": f"{CARMEN}/orebro-corrected.log.gz",
    "mrpt-simul": "mrpt-sim-laser2d/simul.scans.csv.gz",
}
VARIED, SHORT = "freiburg-079", "range-8"
"""The log that is changed in all ways, and the change of all logs."""
RELATIONS, CHECKED = f"{CARMEN}/fr079.relations", ("freiburg-079", "fr079")
"""Relations checked by hand, and the logs of the same run."""
LOST = 0.1
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
COLUMNS = (
    "log | scans | submaps | largest | right | ATE of the largest [m] | worst ATE [m] "
    "| wrong steps | disputed | unlisted | listed | relations [m] | [deg] | at scans [m] | [deg] "
    "| found | true | doubled | scan, median [ms] | mean [ms] | refine [s] | all [s]"
)
LEFT_OUT = {
    "real": ("found", "true"),
    "simulated": ("disputed", "relations [m]", "at scans [m]", "[deg]"),
}
"""Columns left out of a table: only simulated walls are known, and simulated poses are exact."""


def main() -> None:
    """Print the tables of real logs and of simulated ones."""
    varied = [f"{VARIED}/{name}" for name in VARIANTS] + [f"{name}/{SHORT}" for name in LOGS]
    names = ", ".join([*LOGS, *varied, *(f"sim/{name}/SEED" for name in WORLDS)])
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], epilog=names)
    parser.add_argument("data", type=Path)
    parser.add_argument("--log", action="append", help="a log, or a pattern; all by default")
    parser.add_argument("--scans", default="0:1000000", help="a part of each log: A:B")
    parser.add_argument("--seeds", type=int, default=2, help="of simulated logs, from 0")
    arguments = parser.parse_args()
    begin, end = map(int, arguments.scans.split(":"))
    orebro = open_scans(arguments.data / LOGS["orebro"])
    _row("", orebro.between(0, 30), Truth(), arguments.data)  # compiles
    for kind in LEFT_OUT:
        header = _cells(kind, COLUMNS)
        print(f"\n| {header} |\n" + "|---" * (header.count("|") + 1) + "|")
        for name, load in _sources(arguments.data, arguments.seeds):
            chosen = any(fnmatch(name, one) for one in arguments.log or ["*"])
            if chosen and name.startswith("sim/") == (kind == "simulated"):
                log, truth = load()
                row = _row(name, log.between(begin, end), truth, arguments.data)
                print(f"| {_cells(kind, f'{name} | {row}')} |", flush=True)


def _cells(kind: str, row: str) -> str:
    """Return a row without the columns that a table does not have."""
    cells = zip(COLUMNS.split("|"), row.split("|"), strict=True)
    return " | ".join(cell.strip() for name, cell in cells if name.strip() not in LEFT_OUT[kind])


Load = Callable[[], tuple[ScanLog, Truth]]
Change = Callable[[ScanLog], ScanLog]


def _sources(data: Path, seeds: int) -> Iterator[tuple[str, Load]]:
    """Yield the name of each log, and what loads it."""
    for name, file in LOGS.items():
        variants = VARIANTS if name == VARIED else {SHORT: VARIANTS[SHORT]}
        yield name, partial(_loaded, data / file)
        for own, change in variants.items():
            yield f"{name}/{own}", partial(_loaded, data / file, change)
    for name, options in WORLDS.items():
        for seed in range(seeds):
            yield f"sim/{name}/{seed}", partial(simulated, seed, options)


def _loaded(file: Path, change: Change | None = None) -> tuple[ScanLog, Truth]:
    log = open_scans(file)
    return change(log) if change else log, Truth()


def simulated(seed: int, options: dict[str, Any]) -> tuple[ScanLog, Truth]:
    """Return the log of a laser in a simulated world, and the truth about its walls."""
    building = simulate_building(seed=seed, **(LASER | options))
    return log_of(building), truth_of(building)


def _with_points(log: ScanLog, change: Callable[[Floats], Floats]) -> ScanLog:
    """Return a log with the points of each scan changed."""
    scans = [change(scan.points_robot) for scan in log.scans()]
    return ScanLog(2, log.stamps_s, scans.__getitem__, log.poses, sensor=log.sensor)


def _every_beam(every: int, log: ScanLog) -> ScanLog:
    """Return a log with every so many-th beam."""

    def thinned(points: Floats) -> Floats:
        bearing = np.arctan2(points[:, 1], points[:, 0])
        beam = np.rint((bearing - bearing.min()) / np.median(np.abs(np.diff(bearing))))
        return np.asarray(points[beam % every == 0])

    return _with_points(log, thinned)


def _lost(log: ScanLog) -> ScanLog:
    rng = np.random.default_rng(0)
    return _with_points(log, lambda points: points[rng.uniform(size=len(points)) >= LOST])


def _noisy(sigma_m: float, log: ScanLog) -> ScanLog:
    """Return a log with more noise in its ranges."""
    rng = np.random.default_rng(0)
    at = np.array([log.sensor.x_m, log.sensor.y_m])

    def noisy(points: Floats) -> Floats:
        range_m = np.linalg.norm(points - at, axis=1, keepdims=True)
        return np.asarray(points + (points - at) / range_m * rng.normal(0, sigma_m, range_m.shape))

    return _with_points(log, noisy)


def _short(range_m: float, log: ScanLog) -> ScanLog:
    """Return a log as of a laser that sees less far."""
    at = np.array([log.sensor.x_m, log.sensor.y_m])
    near = _with_points(log, lambda points: points[np.hypot(*(points - at).T) <= range_m])
    return replace(near, sensor=replace(log.sensor, range_m=range_m))


def _mirrored(log: ScanLog) -> ScanLog:
    assert log.poses is not None
    view = replace(log.sensor, y_m=-log.sensor.y_m, yaw_rad=-log.sensor.yaw_rad)
    other = _with_points(log, lambda points: points[::-1] * [1, -1])
    return replace(other, poses=MIRROR @ log.poses @ MIRROR, sensor=view)


def every_scan(step: int, log: ScanLog) -> ScanLog:
    """Return a log with every so many-th scan; backwards where the step is negative."""
    assert log.poses is not None
    rows = np.arange(len(log))[::step]
    stamps_s = log.stamps_s[rows]
    odometry = None if log.odometry is None or step < 0 else composed(log.odometry, rows)
    return replace(
        log,
        points_of=lambda index: log.points_of(int(rows[index])),
        poses=log.poses[rows],
        odometry=odometry,
        stamps_s=stamps_s if step > 0 else stamps_s[0] - stamps_s,
    )


VARIANTS: dict[str, Change] = {
    "beams-2": lambda log: _every_beam(2, log),
    "lost": _lost,
    "mirrored": _mirrored,
    "reversed": lambda log: every_scan(-1, log),
    "scans-2": lambda log: every_scan(2, log),
    "scans-3": lambda log: every_scan(3, log),
    "scans-5": lambda log: every_scan(5, log),
    "scans-8": lambda log: every_scan(8, log),
    "noise-1": lambda log: _noisy(0.01, log),
    "noise-3": lambda log: _noisy(0.03, log),
    "noise-5": lambda log: _noisy(0.05, log),
    SHORT: lambda log: _short(8.0, log),
}
"""Every 2nd beam, 10 % of the beams lost, mirrored, from the end to the beginning, every so
many-th scan, so many centimetres of range noise more (standard deviation), and range in metres."""


LASER: dict[str, Any] = {"points": 361, "sigma": 0.01, "sampling": "laser", "step_m": 0.1}
WORLDS: dict[str, dict[str, Any]] = {
    "building": {},
    "oblique": {"world": "oblique"},
    "glass": {"world": "glass"},
    "furniture": {"world": "furniture"},
    "twin-rooms": {"world": "twin-rooms"},
    "corridor": {"world": "corridor"},
    "bare-corridor": {"world": "bare-corridor"},
    "curved": {"world": "curved"},
    "people-5": {"people": 5},
    "people-15": {"people": 15},
    "clutter": {"clutter": 0.2},
    "doors": {"moving": 4},
    "panels": {"world": "panels", "moving": 4},
    "noise-3": {"sigma": 0.03},
    "noise-5": {"sigma": 0.05},
    "beams-90": {"points": 90},
    "beams-1081": {"points": 1081, "sensor": Sensor(8.0, np.deg2rad(270.0))},
    "step-50": {"step_m": 0.5},
    "step-100": {"step_m": 1.0},
    "twin-rooms-50": {"world": "twin-rooms", "step_m": 0.5},
    "corridor-50": {"world": "corridor", "step_m": 0.5},
}
"""Arguments of `simulate_building`, beside those of a usual laser: steps of 50 and 100 cm, ..."""


def _row(name: str, log: ScanLog, truth: Truth, data: Path) -> str:
    mapper = PlaneMapper()
    fed = feed(mapper, log, "nearest", refine=True, clock=process_time)
    assert log.poses is not None
    poses = mapper.trajectory
    there = np.isfinite(poses).all(axis=(1, 2))
    matched = match_corners(mapper.planes, truth, poses[there], log.poses[there])
    motion = (matched.R, matched.t) if matched else None
    walls = judge_walls(mapper.planes, truth, poses[there], log.poses[there], motion)
    shares = [walls.get(name) for name in ("wall_recall", "wall_precision", "doubled_length")]
    cells = [
        str(len(log)),
        *judged_cells(judged(mapper, log), len(log)),
        *_relations(name, log.stamps_s[there], poses[there], data),
        *("" if share is None else f"{share:.3f}" for share in shares),
        *times(fed),
    ]
    return " | ".join(cells)


def times(fed: Fed) -> list[str]:
    """Return the cells of the time: of a scan, of refining and of all."""
    scan_ms = 1e3 * fed.durations_s.sum(axis=1)
    all_s = scan_ms.sum() / 1e3 + fed.finish_s + fed.refine_s
    figures = np.median(scan_ms), scan_ms.mean(), fed.refine_s, all_s
    return [f"{value:.2f}" for value in figures[:2]] + [f"{value:.1f}" for value in figures[2:]]


def _relations(name: str, stamps_s: Floats, poses: Floats, data: Path) -> list[str]:
    """Return the cells of the errors against checked relations: all, and those at scans."""
    if name not in CHECKED:
        return ["", ""] * 2
    relations = relations_by_clocks(data / RELATIONS)
    cells = list[str]()
    for near_s in np.inf, AT_SCANS_S:
        errors = relation_errors(stamps_s, poses, relations, near_s)
        assert errors is not None
        cells += [f"{errors.shift_m:.3f}", f"{np.rad2deg(errors.turn_rad):.2f}"]
    return cells


if __name__ == "__main__":
    main()
