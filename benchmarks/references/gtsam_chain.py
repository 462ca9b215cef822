"""The problem of `pose_chain` solved by GTSAM, another reference; needs ``relmap[peers]``."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from references.pose_chain import CAUCHY, HELD, Floats, Problem, State


def peer_solved(problem: Problem, state: State, constant: Floats) -> Floats | None:
    """Return the landmarks (m, 2) by GTSAM's Levenberg-Marquardt; None if it is not installed.

    It has no factor with constant errors of odometry, so these are removed from the odometry first.
    """
    try:
        import gtsam
    except ImportError:
        return None
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    robust = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY)
    pose_key, landmark_key = (partial(gtsam.symbol, letter) for letter in "xl")

    def noise(covariance: Floats) -> Any:
        gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
        return gtsam.noiseModel.Robust.Create(robust, gaussian)

    for k, pose in enumerate(state.poses):
        values.insert(pose_key(k), gtsam.Pose2(*pose))
    for label in np.flatnonzero(np.isfinite(state.landmarks[:, 0])).tolist():
        values.insert(landmark_key(label), state.landmarks[label])
    first = gtsam.noiseModel.Isotropic.Sigma(3, HELD**-0.5)
    graph.add(gtsam.PriorFactorPose2(pose_key(0), gtsam.Pose2(*state.poses[0]), first))
    for point, k, label, root in zip(
        problem.points, problem.pose.tolist(), problem.landmark.tolist(), problem.roots, strict=True
    ):
        r = float(np.hypot(*point))
        # From x and y to bearing and range.
        J = np.array([[-point[1] / r**2, point[0] / r**2], point / r])
        polar = J @ np.linalg.inv(root.T @ root) @ J.T
        bearing = gtsam.Rot2.atan2(point[1], point[0])
        graph.add(
            gtsam.BearingRangeFactor2D(pose_key(k), landmark_key(label), bearing, r, noise(polar))
        )
    scale, turn_scale, per_m = constant
    for k in np.flatnonzero(np.isfinite(problem.motion[:, 0])).tolist():
        x, y, yaw = problem.motion[k]
        motion = np.array([x, y, 0]) / (1 + scale)
        motion[2] = (yaw + np.hypot(x, y) * per_m) / (1 + turn_scale)
        sd = problem.sd[k, [0, 0, 1]] / (1 + np.array([scale, scale, turn_scale]))
        between = gtsam.Pose2(*motion)
        graph.add(
            gtsam.BetweenFactorPose2(pose_key(k - 1), pose_key(k), between, noise(np.diag(sd**2)))
        )
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    landmarks = np.full_like(state.landmarks, np.nan)
    for label in np.flatnonzero(np.isfinite(state.landmarks[:, 0])).tolist():
        landmarks[label] = found.atPoint2(landmark_key(label))
    return landmarks
