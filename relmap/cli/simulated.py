"""The files of ``relmap simulate``: a log, its truth, and odometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.cli.arguments import Fault
from relmap.cli.console import busy
from relmap.core.arrays import Floats
from relmap.datasets import ObservationLog, write_observation_csv, write_scans_npz
from relmap.datasets.odometry import write_odometry_csv
from relmap.evaluation.sources import EightSource, log_of
from relmap.evaluation.truth import Truth, write_truth
from relmap.io.files import atomic_write, staged_folder, write_tum
from relmap.io.tables import columns_text
from relmap.simulation import Building, odometry
from relmap.simulation.odometry import Wheels
from relmap.simulation.storey import Storey

ODOMETRY = "odometry.csv"
"""That of an earlier simulation in the same folder is removed: it is of another path."""
SLIPS = 0.1
"""Fraction of steps that slipping wheels count twice."""
LATE_S, LATE_ITERATIONS = 0.5, 3.0
"""Delay of stale odometry, with and without a clock."""


def write_figure_eight(
    out: Path, source: EightSource, errors: Wheels | None = None, fault: Fault | None = None
) -> str:
    """Simulate the figure eight into a folder and return a line with counts."""
    with staged_folder(out, [ODOMETRY]) as staging, busy("simulating"):
        data = source.load()
        assert data.truth is not None
        write_odometry(staging, errors, fault, data.truth.poses, source.seed)
        return write_points(staging, data.log, data.truth)


def write_points(folder: Path, log: ObservationLog, truth: Truth) -> str:
    """Write a run past landmarks into an existing folder and return a line with counts."""
    write_observation_csv(folder / "observations.csv", log)
    (folder / "truth").mkdir()
    write_truth(folder / "truth", truth)
    landmarks, seen = len(truth.landmark_ids), len(log.points_robot)
    return f"{landmarks} landmarks, {len(log)} iterations, {seen} observations"


def write_building(folder: Path, building: Building) -> None:
    """Write a drive past walls into an existing folder, with a picture."""
    from relmap.plots.planes import plot_building
    from relmap.plots.sheet import write_png

    truth = folder / "truth"
    truth.mkdir()
    log = log_of(building)
    scans = [scan.points_robot for scan in log.scans()]
    write_scans_npz(folder / "scans.npz", scans, log.stamps_s, log.sensor)
    ends, extent = ("plane", "x0", "y0", "x1", "y1", "z0", "z1"), ("seen0", "seen1")
    names = (*ends, "scans", "corner0", "corner1", "status", *extent)
    number, status = np.arange(len(building.walls)), np.where(building.moving, "dynamic", "static")
    columns = (number, *building.walls.T, *building.times_seen().T, status)
    table = dict(zip(names, (*columns, *building.seen_extents().T), strict=True))
    atomic_write(truth / "planes.csv", columns_text(table))
    write_tum(truth / "trajectory.tum", building.stamps_s, building.trajectory)
    write_png(folder / "building.png", plot_building, building)


def write_storey(folder: Path, storey: Storey) -> None:
    """Write a walk through rooms into an existing folder."""
    truth = folder / "truth"
    truth.mkdir()
    write_scans_npz(folder / "scans.npz", storey.scans, storey.stamps_s)
    places = (f"{axis}{corner}" for corner in range(4) for axis in "xyz")
    face, corners = np.arange(len(storey.corners)), storey.corners.reshape(-1, 12)
    columns = (face, storey.plane_of, *corners.T, storey.seen_m2)
    table = dict(zip(("face", "plane", *places, "seen_m2"), columns, strict=True))
    atomic_write(truth / "faces.csv", columns_text(table))
    write_tum(truth / "trajectory.tum", storey.stamps_s, storey.trajectory)


def write_odometry(
    folder: Path,
    wheels: Wheels | None,
    fault: Fault | None,
    poses: Floats,
    seed: int,
    stamps_s: Floats | None = None,
) -> int:
    """Write the odometry of a simulated path, if any, into a folder; return the number of files."""
    if wheels is None or len(poses) < 2:
        return 0
    # A separate generator: the observations are the same with and without odometry.
    rng = np.random.default_rng([seed, len(poses)])
    motion = odometry.wheel_odometry(poses, wheels, rng)
    if fault == "slip":
        motion = odometry.slipping(motion, SLIPS, rng)
    elif fault == "reversed":
        motion = odometry.backward(motion)
    elif fault == "stale":
        iterations = np.arange(float(len(poses)))
        clock = (iterations, LATE_ITERATIONS) if stamps_s is None else (stamps_s, LATE_S)
        motion = odometry.stale(motion, *clock)
    write_odometry_csv(folder / ODOMETRY, motion)
    return 1
