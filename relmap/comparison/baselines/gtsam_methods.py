"""iSAM2 and the batch solver of gtsam, over range-bearing factors; needs ``relmap[peers]``.

Kaess et al., "iSAM2: Incremental smoothing and mapping using the Bayes tree", IJRR 2012; Dellaert
and Kaess, "Factor graphs for robot perception", 2017.

An observation is a unit vector and a range, for which gtsam has a factor; if the error across
equals that of the range, it is equivalent to a Cartesian observation with isotropic noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from relmap.comparison.baselines.base import KnownBaseline, Pose, SolvedAtTheEnd, fitted, map_of
from relmap.comparison.baselines.frames import frame_to_map
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import transforms
from relmap.core.landmarks import LandmarkMap
from relmap.datasets.base import ObservationLog

PRIOR_SD = 1e-6
"""Prior noise of the first pose, which defines the frame, metres and radians."""
RELINEARIZE = 0.01
"""Relinearisation threshold, metres or radians: as in gtsam's own examples."""


class Factors:
    """A graph of scans and landmarks, in worlds of two or three dimensions.

    `dimension`: 2 or 3; `sigma_m`: standard deviation of each observed coordinate, metres.

    Attributes: `gtsam`: module; `values`: initial value of each variable of the graph. Raises
    `ImportError` if gtsam is not installed.
    """

    def __init__(self, dimension: int, sigma_m: float) -> None:
        import gtsam

        self.gtsam: Any = gtsam
        self._d, self._sigma_m = dimension, sigma_m
        self._is_first = True
        self.clear()

    def clear(self) -> None:
        """Begin an empty graph; later poses then have no prior."""
        self.graph: Any = self.gtsam.NonlinearFactorGraph()
        self.values: Any = self.gtsam.Values()

    def landmark_key(self, label: int) -> int:
        """Return the key of a landmark."""
        return int(self.gtsam.symbol("l", label))

    def _pose_key(self, k: int) -> int:
        return int(self.gtsam.symbol("x", k))

    def add_landmark(self, label: int, place: Floats) -> None:
        """Add a landmark with an initial position (d,), metres."""
        self.values.insert(self.landmark_key(label), place)

    def add_scan(self, k: int, pose: Pose, points: Floats, labels: Sequence[int]) -> None:
        """Add iteration `k` with its observations; the first one defines the frame.

        `pose`: initial pose; `points` (n, d), robot frame, metres; `labels`: landmark of each
        point.
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

    def _seen(self, pose_key: int, label: int, point: Floats, r: float) -> Any:
        """Return the factor of one observation, `r` metres away."""
        gtsam, wide = self.gtsam, [self._sigma_m / r] * (self._d - 1)
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([*wide, self._sigma_m]))
        if self._d == 2:
            bearing, kind = gtsam.Rot2.atan2(point[1], point[0]), gtsam.BearingRangeFactor2D
        else:
            bearing, kind = gtsam.Unit3(point), gtsam.BearingRangeFactor3D
        return kind(pose_key, self.landmark_key(label), bearing, r, noise)

    def landmark(self, values: Any, label: int) -> Floats:
        """Return the position (d,) of a landmark in gtsam's values."""
        at = values.atPoint2 if self._d == 2 else values.atPoint3
        return np.asarray(at(self.landmark_key(label)))

    def pose_matrix(self, values: Any, k: int) -> Floats:
        """Return ``T_map_robot`` (4, 4) of iteration `k` in gtsam's values."""
        at = values.atPose2 if self._d == 2 else values.atPose3
        d, matrix = self._d, at(self._pose_key(k)).matrix()
        return transforms(matrix[:d, :d], matrix[:d, d])


class Isam2(KnownBaseline):
    """Smooths after every scan; a new pose is initialised by fitting its scan to the map."""

    def __init__(self, dimension: int, sigma_m: float) -> None:
        super().__init__(dimension)
        self._factors = Factors(dimension, sigma_m)
        parameters = self._factors.gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(RELINEARIZE)
        parameters.relinearizeSkip = 1
        self._solver: Any = self._factors.gtsam.ISAM2(parameters)
        self._places: dict[int, Floats] = {}

    def _placed(self, points: Floats, labels: Ints) -> Pose | None:
        """Add one scan and smooth; return the initial pose."""
        seen, k = labels.tolist(), len(self._poses)
        start = self._start(points, seen)
        if start is None:
            return None
        factors, (R, t) = self._factors, start
        factors.add_scan(k, start, points, seen)
        for label, place in zip(seen, points @ R.T + t, strict=True):
            if label not in self._places:
                factors.add_landmark(label, place)
        self._solver.update(factors.graph, factors.values)
        factors.clear()
        solver, planar = self._solver, self._d == 2
        estimate = solver.calculateEstimatePoint2 if planar else solver.calculateEstimatePoint3
        for label in seen:
            self._places[label] = estimate(factors.landmark_key(label))
        return start

    def _start(self, points: Floats, seen: list[int]) -> Pose | None:
        """Return an initial pose; None if the map does not determine one."""
        if not self._places:
            return (np.eye(self._d), np.zeros(self._d)) if seen else None
        old = [row for row, label in enumerate(seen) if label in self._places]
        there = np.array([self._places[seen[row]] for row in old]).reshape(-1, self._d)
        return fitted(points[old], there)

    @property
    def map(self) -> LandmarkMap:
        """The landmarks, smoothed over all scans so far."""
        values = self._solver.calculateEstimate()
        return map_of({label: self._factors.landmark(values, label) for label in self._places})

    @property
    def trajectory(self) -> Floats:
        """The poses, smoothed over all scans so far."""
        values, poses = self._solver.calculateEstimate(), super().trajectory
        for k in np.flatnonzero(np.isfinite(poses[:, 0, 0])).tolist():
            poses[k] = self._factors.pose_matrix(values, k)
        return poses


class GtsamBatch(SolvedAtTheEnd):
    """Solves once at the end of the log, initialised by frame-to-map averaging."""

    def __init__(self, dimension: int, sigma_m: float) -> None:
        super().__init__(dimension)
        self._factors = Factors(dimension, sigma_m)

    def _solved(self, log: ObservationLog) -> LandmarkMap:
        start, factors = frame_to_map(log), self._factors
        labels = start.map.landmark_ids.tolist()
        if not labels:
            return start.map
        for label, place in zip(labels, start.map.positions[:, : self._d], strict=True):
            factors.add_landmark(label, place)
        d = self._d
        for k, (scan, T) in enumerate(zip(log.scans(), start.trajectory, strict=True)):
            if np.isfinite(T).all() and scan.ids is not None:  # as averaging could place it
                mapped = np.isin(scan.ids, labels)
                seen, points = scan.ids[mapped].tolist(), scan.points_robot[mapped]
                factors.add_scan(k, (T[:d, :d], T[:d, 3]), points, seen)
        found = factors.gtsam.LevenbergMarquardtOptimizer(factors.graph, factors.values).optimize()
        return map_of({label: factors.landmark(found, label) for label in labels})
