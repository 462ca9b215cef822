"""What iSAM2 and gtsam's batch solver share: range-bearing factors of a scan.

An observation is a unit vector and a range, which gtsam has a factor for; with a bearing as wide as
the range is exact it says what a Cartesian observation with equal noise on each axis says.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

PRIOR_SD = 1e-6
"""Of the first pose, which makes the frame, metres and radians."""


class Factors:
    """Makes keys, factors and values for worlds of two or three dimensions.

    Parameters
    ----------
    dimension : int
        2 or 3.
    sigma_m : float
        Standard deviation of each observed coordinate, metres.

    Raises
    ------
    ImportError
        Where gtsam is not installed.
    """

    def __init__(self, dimension: int, sigma_m: float) -> None:
        import gtsam

        self._gtsam: Any = gtsam
        self._d, self._sigma_m = dimension, sigma_m

    def pose_key(self, k: int) -> int:
        """Return the key of the pose of iteration `k`."""
        return int(self._gtsam.symbol("x", k))

    def landmark_key(self, label: int) -> int:
        """Return the key of a landmark."""
        return int(self._gtsam.symbol("l", label))

    def pose(self, R: NDArray[np.float64], t: NDArray[np.float64]) -> Any:
        """Return gtsam's ``T_map_robot`` of R (d, d), t (d,)."""
        if self._d == 2:
            return self._gtsam.Pose2(t[0], t[1], np.arctan2(R[1, 0], R[0, 0]))
        return self._gtsam.Pose3(self._gtsam.Rot3(R), t)

    def prior(self, k: int, pose: Any) -> Any:
        """Return the factor that holds the first pose, that of iteration `k`."""
        q = 3 if self._d == 2 else 6
        kind = self._gtsam.PriorFactorPose2 if self._d == 2 else self._gtsam.PriorFactorPose3
        noise = self._gtsam.noiseModel.Isotropic.Sigma(q, PRIOR_SD)
        return kind(self.pose_key(k), pose, noise)

    def of_scan(self, k: int, points: NDArray[np.float64], labels: list[int]) -> list[Any]:
        """Return one factor for each observation (n, d) of iteration `k`."""
        gtsam, ranges = self._gtsam, np.linalg.norm(points, axis=1).tolist()
        key, made = self.pose_key(k), []
        for point, label, r in zip(points, labels, ranges, strict=True):
            wide = self._sigma_m / r
            if self._d == 2:
                noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([wide, self._sigma_m]))
                bearing, kind = gtsam.Rot2.atan2(point[1], point[0]), gtsam.BearingRangeFactor2D
            else:
                noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([wide, wide, self._sigma_m]))
                bearing, kind = gtsam.Unit3(point), gtsam.BearingRangeFactor3D
            made.append(kind(key, self.landmark_key(label), bearing, r, noise))
        return made

    def landmark(self, values: Any, label: int) -> NDArray[np.float64]:
        """Return the place (d,) of a landmark in gtsam's values."""
        at = values.atPoint2 if self._d == 2 else values.atPoint3
        return np.asarray(at(self.landmark_key(label)))

    def pose_matrix(self, values: Any, k: int) -> NDArray[np.float64]:
        """Return ``T_map_robot`` (4, 4) of iteration `k` in gtsam's values."""
        at = values.atPose2 if self._d == 2 else values.atPose3
        T, d, matrix = np.eye(4), self._d, at(self.pose_key(k)).matrix()
        T[:d, :d], T[:d, 3] = matrix[:d, :d], matrix[:d, d]
        return T
