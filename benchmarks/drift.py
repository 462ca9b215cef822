"""Rounding errors of a long run without noise.

    python benchmarks/drift.py [--iterations N]

The figure eight at density 100, driven repeatedly, and the road of `endurance.py`, both with known
ids and without noise.  The map after a tenth of the run and after all of it,
before any refinement, is compared with the truth after rigid alignment.
"""

from __future__ import annotations

import argparse
from itertools import cycle, islice

import numpy as np
from endurance import CHUNK_M, STEP_M, Scans, road, stretches
from shared.tables import table
from speed import on_one_core

from relmap import PointMapper
from relmap.core.arrays import Floats
from relmap.core.geometry.alignment import fit_rigid
from relmap.simulation import simulate_figure_eight

BAR_M = 1e-6


def round_and_round(seed: int) -> tuple[Scans, Floats]:
    """Return the figure eight without end, and its landmarks (m, 3) by their ids."""
    world = simulate_figure_eight(density=100, sigma=0.0, seed=seed)
    places = np.full((world.landmark_ids.max() + 1, 3), np.nan)
    places[world.landmark_ids] = world.landmarks_map
    scans = [(scan.points_robot, scan.ids) for scan in world.log.scans()]
    return ((points, ids) for points, ids in cycle(scans) if ids is not None), places


def on_and_on(seed: int, iterations: int) -> tuple[Scans, Floats]:
    """Return the road, and its landmarks (m, 3) by their ids."""
    n = int(STEP_M * iterations / CHUNK_M) + 10
    return road(seed, sigma_m=0.0), np.concatenate(list(islice(stretches(seed), n)))


def errors_m(mapper: PointMapper, places: Floats) -> Floats:
    """Return the error of each mapped landmark, after rigid alignment."""
    found = mapper.map
    there = places[found.landmark_ids]
    R, t = fit_rigid(found.positions, there)
    return np.asarray(np.linalg.norm(found.positions @ R.T + t - there, axis=1))


def main(iterations: int) -> None:
    rows = []
    for name, (scans, places) in {
        "figure eight, repeated": round_and_round(seed=0),
        "road": on_and_on(0, iterations),
    }.items():
        mapper = PointMapper()
        for k, (points, ids) in enumerate(islice(scans, iterations), start=1):
            mapper.update(points, ids)
            if k in (iterations // 10, iterations):
                off = errors_m(mapper, places)
                rmse = float(np.sqrt(np.mean(off**2)))
                rows.append([name, f"{k}", f"{len(off)}", f"{len(mapper.submaps)}"])
                rows[-1] += [f"{rmse:.1e}", f"{off.max():.1e}", "yes" if rmse <= BAR_M else "no"]
    header = ["run", "iterations", "mapped", "submaps", "RMSE [m]", "worst [m]", f"<= {BAR_M:g}"]
    table("Without noise, known ids, seed 0", header, rows)


if __name__ == "__main__":
    on_one_core()
    parser = argparse.ArgumentParser(description="Measure rounding errors of a long run.")
    parser.add_argument("--iterations", metavar="N", type=int, default=20_000)
    main(parser.parse_args().iterations)
