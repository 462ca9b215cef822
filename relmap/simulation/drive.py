"""How a robot drives round a closed line: smoothly, slower where it turns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

STEP_M = 0.22
TURN_RAD = np.deg2rad(4.0)
"""From one scan to the next the robot goes and turns about so far, at most."""
WEAVE_M = 0.15
"""It does not keep the line exactly."""
WEAVES = 5
GRID_M = 0.01
SMOOTH_M = 0.4
STEP_S = 0.2


def drive_round(
    loop: NDArray[np.float64], loops: int, iterations: int | None, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return the poses (k, 4, 4) of a robot that drives round, in the plane z = 0.

    Parameters
    ----------
    loop : (l, 2) float64, map frame, metres
        The closed line; the robot starts somewhere on it.
    loops : int
        Rounds to drive.
    iterations : int or None
        Number of poses; None: as many as the rounds take.
    """
    line, yaw, turning = _fine_line(loop, rng)
    effort = np.maximum(1 / STEP_M, turning / TURN_RAD)
    effort = gaussian_filter1d(effort, SMOOTH_M / GRID_M, mode="wrap")
    done = np.concatenate([[0.0], np.cumsum(effort)])
    around = int(np.ceil(done[-1] * GRID_M))
    k = loops * around if iterations is None else iterations
    at = np.arange(k) % around * (done[-1] / around)
    cell = np.interp(at, done, np.arange(len(done), dtype=np.float64))
    grid = np.arange(len(line), dtype=np.float64)
    angle = np.interp(cell, grid, yaw)
    poses = np.tile(np.eye(4), (k, 1, 1))
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(angle)
    poses[:, 1, 0] = np.sin(angle)
    poses[:, 0, 1] = -np.sin(angle)
    poses[:, :2, 3] = np.column_stack([np.interp(cell, grid, axis) for axis in line.T])
    return poses


def _fine_line(
    loop: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return points (g + 1, 2), yaw (g + 1,) and turn per metre (g,) of the way, g cells long."""
    closed = np.vstack([loop, loop[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    g = round(length[-1] / GRID_M)
    s = np.arange(g) * (length[-1] / g) + rng.uniform(0, length[-1])
    points = np.column_stack([np.interp(s % length[-1], length, axis) for axis in closed.T])
    points = gaussian_filter1d(points, SMOOTH_M / GRID_M / 2, axis=0, mode="wrap")
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    left /= np.linalg.norm(left, axis=1)[:, None]
    weave = WEAVE_M * np.sin(2 * np.pi * WEAVES * np.arange(g) / g + rng.uniform(0, 2 * np.pi))
    points += weave[:, None] * left
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    yaw = np.append(yaw, yaw[0] + 2 * np.pi)
    turning = np.abs(np.diff(yaw)) / GRID_M
    return np.vstack([points, points[:1]]), yaw, turning
