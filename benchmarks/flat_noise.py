"""Refinement for bounded noise compared with least squares.

    python benchmarks/flat_noise.py

Figure eight, sigma 0.05, known association; the noise is uniform or Gaussian, of the same variance.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from shared.runs import mapped, rmse
from shared.tables import header, row

from relmap import MapperConfig, PointMapper
from relmap.core.arrays import Floats
from relmap.simulation import FigureEight, simulate_figure_eight

RUNS: tuple[tuple[Any, int, int], ...] = (
    ("uniform", 25, 10),
    ("uniform", 100, 3),
    ("gaussian", 25, 10),
)
"""Noise, density, seeds."""


def error(mapper: PointMapper, truth: Floats) -> float:
    """Return the RMSE of the map, metres, after rigid alignment."""
    return rmse(mapper.map.positions, truth[mapper.map.landmark_ids])


def squares(mapper: PointMapper, world: FigureEight) -> Floats:
    """Return the mean squared error per axis (3,) in units of the variances, anchor's frame."""
    found = mapper.map
    T = world.trajectory[mapper.refined[0].anchor_iteration]
    there = (world.landmarks_map[found.landmark_ids] - T[:3, 3]) @ T[:3, :3]
    variances = np.einsum("nii->ni", found.covariances)
    return np.asarray(np.mean((found.positions - there) ** 2 / variances, axis=0))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.parse_args()
    header("noise", "density", "seeds", "power", "RMSE / least squares", "normalised squares")
    for noise, density, seeds in RUNS:
        ratios, powers, normalised = [], set(), []
        for seed in range(seeds):
            world = simulate_figure_eight(noise=noise, density=density, seed=seed)
            least = error(mapped(world.log)[0], world.landmarks_map)
            mapper, _ = mapped(world.log, config=MapperConfig(keep_observations=True))
            ratios.append(error(mapper, world.landmarks_map) / least)
            powers.add(mapper.refined[0].power)
            normalised.append(squares(mapper, world))
        share = f"{np.median(ratios):.2f} ({np.max(ratios):.2f})"
        mean = ", ".join(f"{square:.2f}" for square in np.mean(normalised, axis=0))
        power = ", ".join(f"{power:g}" for power in sorted(powers))
        row(noise, density, seeds, power, share, mean)


if __name__ == "__main__":
    main()
