"""Planes and points from the same scans, over spacing and noise: the table of docs/benchmarks.md.

    OMP_NUM_THREADS=1 python benchmarks/crossing.py [--seeds 1] [--spacing 0.3]

Fixed points on the walls of a building; `relmap figures crossing` draws the same.  Median of the
seeds: RMSE of corners or points, in brackets the fraction of those seen ten times that is mapped.
"""

from __future__ import annotations

import argparse
from itertools import product

import numpy as np
from shared.tables import header, row

from relmap.evaluation.surface_points import METHODS, VariantRun, map_of, wall_points

SPACINGS_M = (0.2, 0.3, 0.4)
NOISES = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--spacing", type=float, nargs="+", default=SPACINGS_M)
    given = parser.parse_args()
    seeds = range(given.seeds)
    header("spacing [m]", "sigma / spacing", *(f"{name} [m]" for name in METHODS))
    for spacing_m, noise in product(given.spacing, NOISES):
        seen = [wall_points(spacing_m, noise, seed) for seed in seeds]
        cells = (_cell([map_of(method, each)[1] for each in seen]) for method in METHODS)
        row(spacing_m, noise, *cells)


def _cell(runs: list[VariantRun]) -> str:
    errors_m = [np.inf if run.map_rmse_m is None else run.map_rmse_m for run in runs]
    error_m, coverage = np.median(errors_m), np.median([run.coverage for run in runs])
    return f"{error_m:.3f} ({coverage:.0%})" if np.isfinite(error_m) else f"none ({coverage:.0%})"


if __name__ == "__main__":
    main()
