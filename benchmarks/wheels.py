"""Simulate wheel odometry for a log, from its path.

    python benchmarks/wheels.py LOG -o FOLDER/odometry.csv [--seed 0]

LOG is a log of point scans whose poses are exact or corrected. Placed beside a copy of LOG, or a
link to it, the file is read as its odometry. The noise is 1 % of a step and 0.5 degrees per metre,
the systematic error 1 % of the distance and 0.05 degrees per metre to the left.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from relmap.datasets import open_scans
from relmap.datasets.odometry import write_odometry_csv
from relmap.simulation.odometry import LASER_WHEELS, wheel_odometry


def main() -> None:
    parser = argparse.ArgumentParser(description="Simulate odometry from the path of a log.")
    parser.add_argument("log", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=Path("odometry.csv"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    log = open_scans(arguments.log)
    if log.poses is None:
        parser.error(f"{arguments.log} gives no poses")
    rng = np.random.default_rng(arguments.seed)
    odometry = wheel_odometry(log.poses, LASER_WHEELS, rng)
    write_odometry_csv(arguments.out, odometry, log.first_iteration)


if __name__ == "__main__":
    main()
