"""What iSAM2 and gtsam's batch solver share: range-bearing factors of a scan.

An observation is a unit vector and a range, which gtsam has a factor for; with a bearing as wide as
the range is exact it says what a Cartesian observation with equal noise on each axis says.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.baselines.base import Pose

PRIOR_SD = 1e-6
"""Of the first pose, which makes the frame, metres and radians."""


class Factors:
    """A graph of scans and landmarks, in worlds of two or three dimensions.

    Parameters
    ----------
    dimension : int
        2 or 3.
    sigma_m : float
        Standard deviation of each observed coordinate, metres.

    Attributes
    ----------
    gtsam : module
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Where each variable of the graph begins.

    Raises
    ------
    ImportError
        Where gtsam is not installed.
    """

    def __init__(self, dimension: int, sigma_m: float) -> None:
        import gtsam

        self.gtsam: Any = gtsam
        self._d, self._sigma_m = dimension, sigma_m
        self._is_first = True
        self.clear()

    def clear(self) -> None:
        """Begin an empty graph; a later pose is not the first any more."""
        self.graph: Any = self.gtsam.NonlinearFactorGraph()
        self.values: Any = self.gtsam.Values()

    def landmark_key(self, label: int) -> int:
        """Return the key of a landmark."""
        return int(self.gtsam.symbol("l", label))

    def _pose_key(self, k: int) -> int:
        return int(self.gtsam.symbol("x", k))

    def add_landmark(self, label: int, place: NDArray[np.float64]) -> None:
        """Add a landmark that begins at a place (d,), metres."""
        self.values.insert(self.landmark_key(label), place)

    def add_scan(
        self, k: int, pose: Pose, points: NDArray[np.float64], labels: Sequence[int]
    ) -> None:
        """Add iteration `k` with its observations; the first one makes the frame.

        Parameters
        ----------
        k : int
        pose : Pose
            Where it begins.
        points : (n, d) float64, robot frame, metres
        labels : sequence of int
            Landmark of each point.
        """
        gtsam, key, (R, t) = self.gtsam, self._pose_key(k), pose
        if self._d == 2:
            start = gtsam.Pose2(t[0], t[1], np.arctan2(R[1, 0], R[0, 0]))
        else:
            start = gtsam.Pose3(gtsam.Rot3(R), t)
        self.values.insert(key, start)
        if self._is_first:
            prior = gtsam.PriorFactorPose2 if self._d == 2 else gtsam.PriorFactorPose3
            noise = gtsam.noiseModel.Isotropic.Sigma(3 if self._d == 2 else 6, PRIOR_SD)
            self.graph.add(prior(key, start, noise))
            self._is_first = False
        for point, label, r in zip(
            points, labels, np.linalg.norm(points, axis=1).tolist(), strict=True
        ):
            self.graph.add(self._seen(key, label, point, r))

    def _seen(self, pose_key: int, label: int, point: NDArray[np.float64], r: float) -> Any:
        """Return the factor of one observation, `r` metres away."""
        gtsam, wide = self.gtsam, [self._sigma_m / r] * (self._d - 1)
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([*wide, self._sigma_m]))
        if self._d == 2:
            bearing, kind = gtsam.Rot2.atan2(point[1], point[0]), gtsam.BearingRangeFactor2D
        else:
            bearing, kind = gtsam.Unit3(point), gtsam.BearingRangeFactor3D
        return kind(pose_key, self.landmark_key(label), bearing, r, noise)

    def landmark(self, values: Any, label: int) -> NDArray[np.float64]:
        """Return the place (d,) of a landmark in gtsam's values."""
        at = values.atPoint2 if self._d == 2 else values.atPoint3
        return np.asarray(at(self.landmark_key(label)))

    def pose_matrix(self, values: Any, k: int) -> NDArray[np.float64]:
        """Return ``T_map_robot`` (4, 4) of iteration `k` in gtsam's values."""
        at = values.atPose2 if self._d == 2 else values.atPose3
        T, d, matrix = np.eye(4), self._d, at(self._pose_key(k)).matrix()
        T[:d, :d], T[:d, 3] = matrix[:d, :d], matrix[:d, d]
        return T
