"""Range-bearing EKF SLAM without odometry: the filter that section V compares with.

One Gaussian over the robot's pose and all landmarks.  The rotation is estimated as a small
perturbation of a matrix, the landmarks are Cartesian, an observation is range, yaw and pitch
(planar: range and yaw).  There is no odometry, so there are two choices for the prediction:

* ``standing``: the last pose, as in MRPT (Blanco, "Derivation and implementation of a full 6D
  EKF-based solution to range-bearing SLAM", University of Malaga, 2008; `CRangeBearingKFSLAM`);
  MRPT's process noise is 0.1 m on each axis and 0.05 on each component of the quaternion, which is
  a rotation of 0.1 rad about each axis;
* ``fitted``: the pose at which the scan fits the map best, with process noise so large that the
  prediction has no weight and only defines the linearisation point.

Sola, "Simultaneous localization and mapping with the extended Kalman filter", 2014, explains the
equations.  An iteration costs O(m^2) for m landmarks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular

from relmap.comparison.baselines.base import KnownBaseline, Pose, Setup, fitted, map_of
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.landmarks import LandmarkMap

UNKNOWN_M, UNKNOWN_RAD = 10.0, 1.0
"""Process noise large enough to give the prediction no weight, relative to a step of the robot."""


@dataclass(frozen=True)
class EkfConfig:
    """Settings of the filter.

    `step_sd_m`, `turn_sd_rad`: process noise of an iteration, along and about each axis.
    `range_sd_m`: standard deviation of an observed range. `bearing_sd_rad`: of an observed yaw and
    pitch; None: such that the error across equals that of the range at any distance.
    `T_robot_sensor` (4, 4): pose of the sensor on the robot.
    """

    prediction: Literal["standing", "fitted"] = "standing"
    step_sd_m: float = 0.1
    turn_sd_rad: float = 0.1
    range_sd_m: float = 0.05
    bearing_sd_rad: float | None = None
    T_robot_sensor: Floats = field(default_factory=lambda: np.eye(4))


class Ekf(KnownBaseline):
    """EKF SLAM with known association; the map frame is the robot's in the first iteration."""

    def __init__(self, dimension: int, config: EkfConfig) -> None:
        super().__init__(dimension)
        self._config = config
        self._turns = 1 if dimension == 2 else 3
        self._q = dimension + self._turns
        """Components of the pose in the state, which come first."""
        self._R, self._t = np.eye(dimension), np.zeros(dimension)
        self._row: dict[int, int] = {}
        self._map = np.empty((0, dimension))
        self._P = np.zeros((self._q, self._q))

    def _placed(self, points: Floats, labels: Ints) -> Pose:
        """Predict, correct with mapped landmarks, add new ones."""
        rows = np.array([self._row.get(label, -1) for label in labels.tolist()], np.int64)
        old = rows >= 0
        if self._row:
            step, turn = self._config.step_sd_m, self._config.turn_sd_rad
            if self._config.prediction == "fitted":
                step, turn = UNKNOWN_M, UNKNOWN_RAD
                fit = fitted(points[old], self._map[rows[old]])
                self._R, self._t = fit or (self._R, self._t)
            noise = np.repeat([step**2, turn**2], [self._d, self._turns])
            self._P[np.arange(self._q), np.arange(self._q)] += noise
            self._correct(points[old], rows[old])
        self._add(labels[~old].tolist(), points[~old])
        return self._R, self._t

    def _correct(self, points: Floats, rows: Ints) -> None:
        if not len(rows):
            return
        innovation, by_pose, by_landmark, variance = predicted(
            self._R, self._t, self._map[rows], points, self._config
        )
        d, q, n = self._d, self._q, len(rows)
        columns = np.concatenate([np.arange(q), (q + d * rows[:, None] + np.arange(d)).ravel()])
        of_map = np.zeros((n, d, n, d))
        of_map[np.arange(n), :, np.arange(n)] = by_landmark
        H = np.hstack([by_pose.reshape(n * d, q), of_map.reshape(n * d, n * d)])
        PHt = self._P[:, columns] @ H.T
        S = H @ PHt[columns] + np.diag(variance.ravel())
        # With S = L L', the gain is W L^-1 and the covariance is reduced by W W', where W = P H'
        # L'^-1.
        L = np.linalg.cholesky(S)
        W = solve_triangular(L, PHt.T, lower=True, check_finite=False).T
        step = W @ solve_triangular(L, innovation.ravel(), lower=True, check_finite=False)
        self._P -= W @ W.T
        self._t = self._t + step[:d]
        self._R = rotations(step[None, d:q])[0] @ self._R
        self._map = self._map + step[q:].reshape(-1, d)

    def _add(self, labels: list[int], points: Floats) -> None:
        if not labels:
            return
        d, n = self._d, len(labels)
        places, by_pose, covariance = inverse_model(self._R, self._t, points, self._config)
        self._row |= {label: len(self._map) + k for k, label in enumerate(labels)}
        self._map = np.concatenate([self._map, places])
        G = by_pose.reshape(n * d, self._q)
        cross = G @ self._P[: self._q]
        own = cross[:, : self._q] @ G.T
        own.reshape(n, d, n, d)[np.arange(n), :, np.arange(n)] += covariance
        self._P = np.block([[self._P, cross.T], [cross, own]])

    @property
    def map(self) -> LandmarkMap:
        """The landmarks in the state."""
        return map_of({label: self._map[row] for label, row in self._row.items()})


def as_mrpt_ships_it(setup: Setup) -> Ekf:
    """Return the filter that predicts standing still, with MRPT's process noise.

    MRPT uses one standard deviation for all bearings: that of a landmark at half the range.
    """
    bearing_sd_rad = setup.sigma_m / (setup.range_m / 2)
    return Ekf(setup.dimension, EkfConfig("standing", 0.1, 0.1, setup.sigma_m, bearing_sd_rad))


def linearised_at_best_fit(setup: Setup) -> Ekf:
    """Return the filter that predicts by fitting the scan to the map."""
    return Ekf(setup.dimension, EkfConfig("fitted", range_sd_m=setup.sigma_m))


def predicted(
    R: Floats, t: Floats, landmarks_map: Floats, points_robot: Floats, config: EkfConfig
) -> tuple[Floats, Floats, Floats, Floats]:
    """Compare observations with their prediction from the pose and the map.

    `R` (d, d), `t` (d,): ``T_map_robot``; `landmarks_map`, `points_robot` (n, d), metres: mapped
    positions of the landmarks, and their observations. Returns `innovation` (n, d): observed minus
    predicted range, yaw and pitch, `by_pose` (n, d, q): Jacobian of the prediction by a shift and a
    small rotation of the pose, in the map frame, `by_landmark` (n, d, d) and `variance` (n, d):
    variance of the observed values.
    """
    d = len(t)
    R_sensor, t_sensor = config.T_robot_sensor[:d, :d], config.T_robot_sensor[:d, 3]
    apart = landmarks_map - t
    points = (apart @ R - t_sensor) @ R_sensor
    observed = (points_robot - t_sensor) @ R_sensor
    J = _jacobian(points) @ R_sensor.T @ R.T
    innovation = spherical(observed) - spherical(points)
    innovation[:, 1:] = (innovation[:, 1:] + np.pi) % (2 * np.pi) - np.pi
    by_pose = np.concatenate([-J, -J @ derivatives(apart)[:, :, :-d]], axis=2)
    return innovation, by_pose, J, _variance(observed, config)


def inverse_model(
    R: Floats, t: Floats, points_robot: Floats, config: EkfConfig
) -> tuple[Floats, Floats, Floats]:
    """Place observed landmarks on the map.

    Returns `places` (n, d), map frame, metres, `by_pose` (n, d, q): Jacobian of the positions by a
    shift and a small rotation of the pose and `covariance` (n, d, d): covariance of the positions,
    from the noise of the observations alone.
    """
    d = len(t)
    R_sensor, t_sensor = config.T_robot_sensor[:d, :d], config.T_robot_sensor[:d, 3]
    observed = (points_robot - t_sensor) @ R_sensor
    turned = points_robot @ R.T
    K = R @ R_sensor @ np.linalg.inv(_jacobian(observed))
    covariance = (K * _variance(observed, config)[:, None]) @ np.swapaxes(K, 1, 2)
    shift = np.tile(np.eye(d), (len(points_robot), 1, 1))
    return turned + t, np.concatenate([shift, derivatives(turned)[:, :, :-d]], axis=2), covariance


def spherical(points: Floats) -> Floats:
    """Return range, yaw and (in space) pitch of points (n, d), metres and radians."""
    level = np.hypot(points[:, 0], points[:, 1])
    yaw = np.arctan2(points[:, 1], points[:, 0])
    if points.shape[1] == 2:
        return np.column_stack([level, yaw])
    return np.column_stack([np.hypot(level, points[:, 2]), yaw, np.arctan2(points[:, 2], level)])


def _jacobian(points: Floats) -> Floats:
    """Return the derivative (n, d, d) of `spherical`."""
    x, y = points[:, 0], points[:, 1]
    level2 = x**2 + y**2
    level, zero = np.sqrt(level2), np.zeros(len(points))
    if points.shape[1] == 2:
        rows = [[x / level, y / level], [-y / level2, x / level2]]
    else:
        z = points[:, 2]
        r2 = level2 + z**2
        r = np.sqrt(r2)
        rows = [
            [x / r, y / r, z / r],
            [-y / level2, x / level2, zero],
            [-x * z / (r2 * level), -y * z / (r2 * level), level / r2],
        ]
    return np.moveaxis(np.array(rows), 2, 0)


def _variance(observed: Floats, config: EkfConfig) -> Floats:
    """Return the variances (n, d) of range, yaw and pitch of observations at (n, d)."""
    if config.bearing_sd_rad is not None:
        sd = [config.range_sd_m, *[config.bearing_sd_rad] * (observed.shape[1] - 1)]
        return np.tile(np.square(sd), (len(observed), 1))
    level = np.hypot(observed[:, 0], observed[:, 1])
    wide = [np.ones(len(observed)), level, np.linalg.norm(observed, axis=1)]
    return (config.range_sd_m / np.column_stack(wide[: observed.shape[1]])) ** 2
