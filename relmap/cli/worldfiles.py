"""The files written by ``relmap simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from relmap.datasets.base import ObservationLog
    from relmap.evaluation.truth import Truth
    from relmap.simulation import Building


def write_points(folder: Path, log: ObservationLog, truth: Truth) -> str:
    """Write a run past landmarks into an existing folder and return a line with counts."""
    from relmap.datasets.observation_csv import write_observation_csv
    from relmap.evaluation.truth import write_truth

    write_observation_csv(folder / "observations.csv", log)
    (folder / "truth").mkdir()
    write_truth(folder / "truth", truth)
    return (
        f"{len(truth.landmark_ids)} landmarks, {len(log)} iterations, "
        f"{len(log.points_robot)} observations"
    )


def write_building(folder: Path, building: Building) -> None:
    """Write a run into an existing folder."""
    import numpy as np

    from relmap.datasets import write_scans_npz
    from relmap.evaluation.sources import log_of
    from relmap.io.files import atomic_write, write_tum
    from relmap.io.tables import columns_text
    from relmap.plots.planes import write_building_png

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
    write_building_png(folder / "building.png", building)
