"""Batch least squares over all observations with known ids: a lower bound of the map error.

Poses and landmarks are solved for together by sparse Gauss-Newton, with the poses eliminated (Schur
complement), from a start given by another map.  Under Gaussian noise its error is the Cramer-Rao
bound.  It serves as a reference: slow, and independent of the mapper's code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from relmap.comparison.baselines.base import SolvedAtTheEnd, fitted
from relmap.comparison.baselines.frames import frame_to_map
from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.landmarks import LandmarkMap, in_space
from relmap.datasets.base import ObservationLog

CONVERGED_M = 1e-9


@dataclass(frozen=True, eq=False)
class Batch:
    """Observations for a batch solve, each of a landmark from a pose.

    `points_robot` (n, d), robot frame, metres; `pose` (n,): 0 to k - 1; `landmark` (n,): 0 to m -
    1.
    """

    points_robot: Floats
    pose: Ints
    landmark: Ints


def batch_least_squares(observations: Batch, start_map: Floats, iterations: int = 50) -> Floats:
    """Return the landmarks (m, d) that best fit all observations.

    `observations`: every pose sees enough landmarks to be fixed by them. `start_map` (m, d),
    metres: a map to start from; its frame is kept at the first pose. Raises `RelmapError` if a pose
    is not fixed by what it sees, a landmark is not seen, the observations do not connect into one
    map, or the solution does not converge.
    """
    landmarks = start_map.copy()
    _require_one_map(observations, len(landmarks))
    R, t = _poses(observations, landmarks)
    if len(R) == 1:
        sums, counts = np.zeros_like(landmarks), np.zeros(len(landmarks))
        np.add.at(sums, observations.landmark, observations.points_robot @ R[0].T + t[0])
        np.add.at(counts, observations.landmark, 1)
        return np.asarray(sums / counts[:, None])
    for _ in range(iterations):
        turn, shift, step = _gauss_newton(observations, R, t, landmarks)
        R, t = turn @ R, t + shift
        landmarks = landmarks + step
        if np.abs(step).max() < CONVERGED_M * (1 + np.abs(landmarks).max()):
            return landmarks
    raise RelmapError(f"batch least squares did not converge in {iterations} iterations")


def _require_one_map(observations: Batch, m: int) -> None:
    unseen = np.flatnonzero(np.bincount(observations.landmark, minlength=m) == 0)
    if len(unseen):
        raise RelmapError(f"batch least squares: landmark {unseen[0]} is not seen from any pose")
    size = m + int(observations.pose.max()) + 1
    ties = np.ones(len(observations.pose)), (observations.landmark, m + observations.pose)
    parts = connected_components(sparse.coo_array(ties, shape=(size, size)), directed=False)[1]
    if parts[:m].max() != parts[:m].min():
        raise RelmapError("batch least squares: the observations do not connect into one map")


def _poses(observations: Batch, landmarks: Floats) -> tuple[Floats, Floats]:
    k, d = int(observations.pose.max()) + 1, landmarks.shape[1]
    R, t = np.empty((k, d, d)), np.empty((k, d))
    for pose in range(k):
        rows = observations.pose == pose
        found = fitted(observations.points_robot[rows], landmarks[observations.landmark[rows]])
        if found is None:
            raise RelmapError(
                f"batch least squares: pose {pose} is not determined by its observations"
            )
        R[pose], t[pose] = found
    return R, t


def _gauss_newton(
    observations: Batch, R: Floats, t: Floats, landmarks: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return a step: rotations (k, d, d) and shifts (k, d) of poses, shifts of landmarks."""
    n, d = observations.points_robot.shape
    k, m = len(R), len(landmarks)
    turned = np.einsum("nij,nj->ni", R[observations.pose], observations.points_robot)
    residual = (turned + t[observations.pose] - landmarks[observations.landmark]).ravel()
    by_pose = derivatives(turned)
    q = by_pose.shape[2]
    J_pose = _block_columns(by_pose, observations.pose, k)[:, q:]  # the first pose is fixed
    J_map = _block_columns(np.tile(-np.eye(d), (n, 1, 1)), observations.landmark, m)
    products = np.zeros((k, q, q))
    np.add.at(products, observations.pose, np.swapaxes(by_pose, 1, 2) @ by_pose)
    inverses = np.asarray(np.linalg.inv(products[1:]), dtype=np.float64)
    inverse = _block_columns(inverses, np.arange(k - 1), k - 1)
    coupling = J_pose.T @ J_map
    reduced = J_map.T @ J_map - coupling.T @ (inverse @ coupling)
    right = J_map.T @ residual - coupling.T @ (inverse @ (J_pose.T @ residual))
    landmark_step = -spsolve(reduced.tocsc(), right)
    pose_step = -inverse @ (J_pose.T @ residual + coupling @ landmark_step)
    step = np.concatenate([np.zeros((1, q)), pose_step.reshape(k - 1, q)])
    return rotations(step[:, : q - d]), step[:, q - d :], landmark_step.reshape(m, d)


def _block_columns(blocks: Floats, column: Ints, n_columns: int) -> sparse.csr_array:
    """Return the sparse matrix with block i (d, q) in block row i and block column `column[i]`."""
    n, d, q = blocks.shape
    whole = sparse.bsr_array((blocks, column, np.arange(n + 1)), shape=(n * d, n_columns * q))
    return whole.tocsr()


def least_squares_map(log: ObservationLog) -> LandmarkMap:
    """Map the identified landmarks of a log by batch least squares.

    Iterations with fewer identified landmarks than determine a pose (two in the plane, three in
    space) are left out, as are landmarks that frame-to-map averaging, used for initialisation,
    cannot place.

    `log`: with ids. The map is in the frame of the first iteration that is used. Raises
    `RelmapError` if the log has no ids, or they do not connect into one map.
    """
    if log.ids is None:
        raise RelmapError("least squares with known ids: the log has no ids")
    start = frame_to_map(log).map
    used = np.isin(log.ids, start.landmark_ids)
    seen = np.bincount(log.iteration[used] - log.first_iteration, minlength=len(log))
    used &= (seen >= log.points_robot.shape[1])[log.iteration - log.first_iteration]
    log = log.only(used)
    if log.ids is None or not len(log.ids):
        raise RelmapError("least squares with known ids: too few landmarks are identified")
    _, pose = np.unique(log.iteration, return_inverse=True)
    labels, landmark = np.unique(log.ids, return_inverse=True)
    dimension = log.points_robot.shape[1]
    places = start.positions[np.isin(start.landmark_ids, labels), :dimension]
    observations = Batch(log.points_robot, pose, landmark)
    return LandmarkMap(labels, in_space(batch_least_squares(observations, places)))


class BatchLeastSquares(SolvedAtTheEnd):
    """Solves for all poses and landmarks at once: a lower bound of the map error."""

    def _solved(self, log: ObservationLog) -> LandmarkMap:
        return least_squares_map(log)
