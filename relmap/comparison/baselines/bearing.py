"""Range, yaw and pitch of landmarks, with Jacobians: the sensor model of the EKF."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.motions import derivatives

if TYPE_CHECKING:
    from relmap.comparison.baselines.ekf import EkfConfig


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
