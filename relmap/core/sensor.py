"""Covariances of points measured by range and bearing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError, brief
from relmap.core.scan import checked_points, numbers

LEVEL = 0.01
"""Smallest horizontal distance of a point, relative to its range: right above the sensor the
bearing is undefined and the covariance would be singular."""


def range_bearing_covariances(
    points: ArrayLike,
    range_sigma_m: float,
    bearing_sigma_rad: float,
    elevation_sigma_rad: float | None = None,
) -> Floats:
    """Return the covariances of points measured by range, bearing and, in space, elevation.

    First-order propagation: the range variance along the ray, the angular variance times the
    squared distance across it.

    Parameters
    ----------
    points : (n, 2) or (n, 3) array, metres
        In the frame of the sensor, z up.
    range_sigma_m, bearing_sigma_rad : float
        Standard deviations of range and bearing.
    elevation_sigma_rad : float, optional
        In space: standard deviation of the angle above the x-y plane; by default that of the
        bearing.

    Returns
    -------
    (n, d, d) float64, square metres

    Raises
    ------
    RelmapError
        If the points are not valid for `PointMapper.update`, or a standard deviation is not
        positive and finite.
    """
    array = checked_points(points, 0)
    if elevation_sigma_rad is None:
        elevation_sigma_rad = bearing_sigma_rad
    for name, unit, sigma in (
        ("range", "metres", range_sigma_m),
        ("bearing", "radians", bearing_sigma_rad),
        ("elevation", "radians", elevation_sigma_rad),
    ):
        what, wanted = f"the sigma of the {name}", f"above 0, in {unit}"
        value = numbers(sigma, what, wanted, 0.0)
        if value.shape or not 0 < value < np.inf:
            raise RelmapError(f"{what} is {brief(sigma)}; it must be {wanted}")
    n, d = array.shape
    distance = np.maximum(np.linalg.norm(array, axis=1), range_sigma_m)
    level = np.maximum(np.hypot(array[:, 0], array[:, 1]), LEVEL * distance)
    yaw, pitch = np.arctan2(array[:, 1], array[:, 0]), np.zeros(n)
    if d == 3:
        pitch = np.arctan2(array[:, 2], np.hypot(array[:, 0], array[:, 1]))
    c, s, up, zero = np.cos(yaw), np.sin(yaw), np.sin(pitch), np.zeros(n)
    flat = np.cos(pitch)
    axes = np.stack([[c * flat, s * flat, up], [-s, c, zero], [-c * up, -s * up, flat]])[:d, :d]
    across = bearing_sigma_rad * level, elevation_sigma_rad * distance
    sigmas = np.stack([np.full(n, range_sigma_m), *across])[:d]
    root = axes * sigmas[:, None]
    return np.asarray(np.einsum("kan,kbn->nab", root, root))
