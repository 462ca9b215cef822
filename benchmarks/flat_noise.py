"""What an estimator for bounded noise would gain over least squares: the figures of the README.

    python benchmarks/flat_noise.py

Uniform noise has edges, and observations near them say more than others.  The estimate that
minimises the sum of the p-th powers of what is left, for a large p, leans on the edges (p = 2 is
least squares; p to infinity is Chebyshev's).  It is found by reweighting (Lawson, 1961) from the
least squares solution, over all observations, coordinate by coordinate in the robot's frame, where
the noise is bounded.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from relmap.core.alignment import fit_rigid, fit_rigid_each
from relmap.evaluation.baselines.batch import Batch, batch_least_squares
from relmap.simulation import simulate_figure_eight

SEEDS = range(10)
POWERS = (4, 8, 16)
ROUNDS = 15
FAINT = 0.05
"""Least residual, as a share of the largest, that a weight is taken from."""


def rmse(positions: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Return the RMSE, metres, after rigid alignment."""
    R, t = fit_rigid(positions, truth)
    return float(np.sqrt(np.mean(np.sum((positions @ R.T + t - truth) ** 2, axis=1))))


def power_mean_map(
    seen: Batch, landmarks: NDArray[np.float64], power: float
) -> NDArray[np.float64]:
    """Return the landmarks (m, 3) of the least sum of powers, from those of least squares."""
    n, k, m = len(seen.pose), int(seen.pose.max()) + 1, len(landmarks)
    there = landmarks[seen.landmark]
    R, t, _ = fit_rigid_each(seen.points_robot, there, np.ones(n), seen.pose, k)
    for _ in range(ROUNDS):
        turned = np.einsum("nij,nj->ni", R[seen.pose], seen.points_robot)
        residual = turned + t[seen.pose] - landmarks[seen.landmark]
        back = np.swapaxes(R[seen.pose], 1, 2)
        left = np.einsum("nij,nj->ni", back, residual)
        size = np.abs(left) / np.abs(left).max()
        root = np.maximum(size, FAINT) ** (power / 2 - 1)
        turning = np.stack([np.cross(axis, turned) for axis in np.eye(3)], axis=2)
        by_pose = back @ np.concatenate([turning, np.tile(np.eye(3), (n, 1, 1))], axis=2)
        J = sparse.hstack(
            [
                columns(root[:, :, None] * by_pose, seen.pose, k)[:, 6:],
                columns(-root[:, :, None] * back, seen.landmark, m),
            ]
        ).tocsc()
        normal = (J.T @ J).tocsc()
        normal += 1e-9 * normal.diagonal().mean() * sparse.eye_array(normal.shape[0])
        solver = splu(normal, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        step = -solver.solve(J.T @ (root * left).ravel()) / (power - 1)
        poses = np.concatenate([np.zeros((1, 6)), step[: 6 * (k - 1)].reshape(-1, 6)])
        R = Rotation.from_rotvec(poses[:, :3]).as_matrix() @ R
        t = t + poses[:, 3:]
        landmarks = landmarks + step[6 * (k - 1) :].reshape(m, 3)
    return landmarks


def columns(
    blocks: NDArray[np.float64], column: NDArray[np.int64], n_columns: int
) -> sparse.csr_array:
    """Return the sparse matrix with block i (3, q) in block row i and block column `column[i]`."""
    n, d, q = blocks.shape
    at = np.repeat((column[:, None] * q + np.arange(q))[:, None], d, axis=1)
    begin = np.arange(0, n * d * q + 1, q)
    return sparse.csr_array((blocks.ravel(), at.ravel(), begin), shape=(n * d, n_columns * q))


if __name__ == "__main__":
    print(
        "| figure eight, density 25, sigma 0.05 | RMSE / least squares, median (worst) |\n|---|---|"
    )
    for noise in ("uniform", "gaussian"):
        ratios = []
        for seed in SEEDS:
            world = simulate_figure_eight(noise=noise, seed=seed)
            seen = Batch(world.log.points_robot, world.log.iteration, world.log.ids)
            best = batch_least_squares(seen, world.landmarks_map)
            error = rmse(best, world.landmarks_map)
            found = [power_mean_map(seen, best, power) for power in POWERS]
            ratios.append([rmse(each, world.landmarks_map) / error for each in found])
        for power, of_power in zip(POWERS, np.transpose(ratios), strict=True):
            worst = f"{np.median(of_power):.2f} ({of_power.max():.2f})"
            print(f"| {noise} noise, p = {power} | {worst} |", flush=True)
