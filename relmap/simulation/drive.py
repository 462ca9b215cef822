"""Ways: positions along them, and driving round a closed one, slower in turns, weaving."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats
from relmap.datasets.scans import planar_poses

STEP_M = 0.22
TURN_RAD = np.deg2rad(4.0)
"""Approximate maximum motion and rotation between scans."""
WEAVE_M = 0.15
"""Amplitude of weaving about the line."""
WEAVES = 5
GRID_M = 0.01
SMOOTH_M = 0.4


def lengths_along(way: Floats) -> Floats:
    """Return the length (n,) of a way (n, d) up to each of its points."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1)))


def places_along(way: Floats, lengths: NDArray[Any], at: Floats) -> Floats:
    """Return the positions (k, d) on a way (n, d) at lengths (k,); `lengths`: of its points."""
    return np.column_stack([np.interp(at, lengths, axis) for axis in way.T])


def drive_round(
    loop: Floats, loops: int, iterations: int | None, step_m: float, rng: np.random.Generator
) -> Floats:
    """Return the poses (k, 4, 4) of a robot on a closed line (l, 2), slower where it turns.

    It starts at a random point; without a number of iterations it drives round `loops` times.
    Rotations scale with the steps.
    """
    from scipy.ndimage import gaussian_filter1d

    line, yaw, turning = _fine_line(loop, rng)
    effort = np.maximum(1 / step_m, turning / (TURN_RAD * step_m / STEP_M))
    effort = gaussian_filter1d(effort, SMOOTH_M / GRID_M, mode="wrap")
    done = np.concatenate([[0.0], np.cumsum(effort)])
    around = int(np.ceil(done[-1] * GRID_M))
    k = loops * around if iterations is None else iterations
    at = np.arange(k) % around * (done[-1] / around)
    grid = np.arange(len(line), dtype=np.float64)
    cell = np.interp(at, done, grid)
    x, y, angle = (np.interp(cell, grid, values) for values in (*line.T, yaw))
    return planar_poses(x, y, angle)


def _fine_line(loop: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return points (g + 1, 2), yaw (g + 1,) and turn rate per metre (g,) of a path of g cells."""
    from scipy.ndimage import gaussian_filter1d

    closed = np.vstack([loop, loop[:1]])
    length = lengths_along(closed)
    g = round(length[-1] / GRID_M)
    s = np.arange(g) * (length[-1] / g) + rng.uniform(0, length[-1])
    points = places_along(closed, length, s % length[-1])
    points = gaussian_filter1d(points, SMOOTH_M / GRID_M / 2, axis=0, mode="wrap")
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    left /= np.linalg.norm(left, axis=1)[:, None]
    weave = WEAVE_M * np.sin(2 * np.pi * WEAVES * np.arange(g) / g + rng.uniform(0, 2 * np.pi))
    points += weave[:, None] * left
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    yaw = np.append(yaw, yaw[0] + 2 * np.pi * np.rint((yaw[-1] - yaw[0]) / (2 * np.pi)))
    turning = np.abs(np.diff(yaw)) / GRID_M
    return np.vstack([points, points[:1]]), yaw, turning
