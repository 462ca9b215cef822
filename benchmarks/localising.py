"""Scans localised one by one in maps of walls, some of them taken there, others elsewhere.

    OMP_NUM_THREADS=1 python benchmarks/localising.py DATA [--seed 31]

Each line is a map and a log: scans tried, right: found within 0.5 m and 10 degrees of the true
pose, and wrong: found anywhere else. A scan of another building is wrong wherever it is found.
Whole maps of simulated buildings are of every second scan, and the others are tried; every seed is
another building of its kind. DATA is a folder of the real data sets.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from laser import LOGS, every_scan, simulated
from shared.tables import header, row

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.core.geometry.alignment import fit_rigid
from relmap.datasets import open_scans
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import feed, preparation
from relmap.planes.motions import from_matrices, others

REAL = "freiburg-079", "freiburg-101", "fhw", "belgioioso", "csail"
WORLDS = "building", "oblique", "furniture", "twin-rooms", "corridor", "glass", "panels"
NEAR_M, NEAR_RAD = 0.5, np.deg2rad(10.0)
TRIED = 40
"""Approximate number of scans of each log."""


class Map:
    """A map of walls, in which scans are localised."""

    def __init__(self, log: ScanLog) -> None:
        self.mapper, self.log = PlaneMapper(), log
        feed(self.mapper, log, "nearest", refine=True)

    def poses_of(self, poses: Floats) -> Floats:
        """Return poses (k, 4, 4) in the frame of the map, given in that of the poses of its log."""
        own, true = self.mapper.trajectory, self.log.poses
        assert true is not None
        known, T = np.isfinite(own[:, 0, 0]), np.eye(4)
        T[:2, :2], T[:2, 3] = fit_rigid(true[known, :2, 3], own[known, :2, 3])
        return np.asarray(T @ poses)

    def cells(self, log: ScanLog, is_here: bool) -> tuple[int, int, int]:
        """Return the cells of a log: scans tried, right, and wrong."""
        first, tried = log.first_iteration, range(1, len(log), 2 * max(len(log) // (2 * TRIED), 1))
        prepare, right, wrong = preparation(self.mapper, log), 0, 0
        for k in tried:
            (scan,) = log.between(first + k, first + k + 1).scans()
            place = self.mapper.locate(prepare(scan.points_robot), scan.points_robot)
            if place.n_places != 1:
                continue
            found, there = from_matrices(place.T_map_robot[None]), False
            if is_here and log.poses is not None:
                true = from_matrices(self.poses_of(log.poses[k][None]))[0]
                there = not others(found, true, NEAR_M, NEAR_RAD)[0]
            right, wrong = right + there, wrong + (not there)
        return len(tried), right, wrong


def main() -> None:
    """Print a line for each map and log."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--seed", type=int, default=31, help="of the simulated buildings")
    given = parser.parse_args()
    header("map", "scans of", "tried", "right", "wrong")
    real = {name: open_scans(given.data / LOGS[name]) for name in REAL}
    for name, log in real.items():
        middle, end = log.first_iteration + len(log) // 2, log.first_iteration + len(log)
        known = Map(log.between(log.first_iteration, middle))
        row(f"{name}, first half", "first half", *known.cells(known.log, is_here=True))
        row(f"{name}, first half", "second half", *known.cells(log.between(middle, end), True))
        for away in [one for one in REAL if one != name]:
            row(f"{name}, first half", away, *known.cells(real[away], is_here=False))
    for world in WORLDS:
        options = {"world": world, "points": 181, "step_m": 0.11}
        log, other = (simulated(seed, options)[0] for seed in (given.seed, given.seed + 1))
        known, half = Map(every_scan(2, log)), Map(log.between(0, len(log) // 2))
        row(f"sim/{world}/{given.seed}", "same", *known.cells(log, is_here=True))
        row(f"sim/{world}/{given.seed}", "another", *known.cells(other, is_here=False))
        later = half.cells(log.between(len(log) // 2, len(log)), is_here=True)
        row(f"sim/{world}/{given.seed}, first half", "second half", *later)


if __name__ == "__main__":
    main()
