"""Common parts of the baselines: a label for each observation, a pose for each scan."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid, fit_rigid_each, fixes_rotation
from relmap.core.geometry.motions import transforms
from relmap.core.landmarks import LandmarkMap, LandmarkTable, Submap, in_space
from relmap.datasets.base import ObservationLog

NO_MAP = LandmarkMap(np.empty(0, np.int64), np.empty((0, 3)))
Pose = tuple[Floats, Floats]
"""``T_map_robot`` as R (d, d) and t (d,), metres; d is 2 or 3."""


@dataclass(frozen=True)
class Setup:
    """Information given to a method before it starts.

    `dimension`: 2 for a planar world, else 3; `sigma_m`: standard deviation of each observed
    coordinate, metres; `range_m`: distance of the farthest observation of the log, or of the
    farthest point of its first scan with any, metres; `has_ids`: whether scans come with ids.
    """

    dimension: int = 3
    sigma_m: float = 0.05
    range_m: float = 80.0
    has_ids: bool = True


class Baseline(ABC):
    """A baseline in 2 or 3 dimensions; see `relmap.evaluation.feeding.Method`."""

    submaps: Sequence[Submap] = ()

    def __init__(self, dimension: int = 3) -> None:
        self._d = dimension
        self._labels = [np.empty(0, np.int64)]
        self._poses: list[Floats] = []

    @abstractmethod
    def update(self, points_robot: Floats, /, ids: Ints | None = None) -> Ints:
        """Process one scan; see `Method.update`."""

    def _keep(self, labels: Ints, T_map_robot: Floats) -> Ints:
        """Store the results of a scan, and return its labels (n,)."""
        self._labels.append(labels)
        self._poses.append(T_map_robot)
        return labels

    def finish(self) -> None:
        """Finish the log: nothing to do for incremental methods."""
        return

    def landmarks_of(self, labels: Ints, /) -> Ints:
        """Return the labels (n,) unchanged: landmarks are never merged."""
        return labels

    @property
    def map(self) -> LandmarkMap:
        """The landmarks mapped so far; none if a method makes no map."""
        return NO_MAP

    @property
    def trajectory(self) -> Floats:
        """``T_map_robot`` of every scan, as estimated at that time, (k, 4, 4); NaN if unknown."""
        return np.array(self._poses).reshape(-1, 4, 4)

    @property
    def landmarks(self) -> LandmarkTable:
        """Every landmark that was labelled, mapped or not."""
        labels = np.concatenate(self._labels)
        iteration = np.repeat(np.arange(len(self._labels)) - 1, [*map(len, self._labels)])
        labels, iteration = labels[labels >= 0], iteration[labels >= 0]
        landmark, first, counts = np.unique(labels, return_index=True, return_counts=True)
        _, last = np.unique(labels[::-1], return_index=True)
        found, m = self.map, len(landmark)
        mapped, position = np.isin(landmark, found.landmark_ids), np.full((m, 3), np.nan)
        at = np.searchsorted(found.landmark_ids, landmark[mapped])
        position[mapped] = found.positions[at]
        return LandmarkTable(
            landmark=landmark,
            position=position,
            sd=np.full(m, np.nan),
            observations=counts,
            first_iteration=iteration[first],
            last_iteration=iteration[::-1][last],
            level=mapped.astype(np.int64),
            status=np.where(mapped, "static", "unmapped"),
            submap=np.where(mapped, 0, -1),
            moving_bin=np.full(m, -1),
        )


class KnownBaseline(Baseline):
    """A baseline with known association; observations without an id are left out."""

    def update(self, points_robot: Floats, /, ids: Ints | None = None) -> Ints:
        """Process one scan; see `Method.update`."""
        ids = np.full(len(points_robot), -1, np.int64) if ids is None else ids
        labels = np.where(ids >= 0, ids, -1)
        known = labels >= 0
        pose = self._placed(points_robot[known], labels[known])
        return self._keep(labels, np.full((4, 4), np.nan) if pose is None else transforms(*pose))

    @abstractmethod
    def _placed(self, points: Floats, labels: Ints) -> Pose | None:
        """Process points (n, d) of landmarks (n,); return the pose, None if undetermined."""


class SolvedAtTheEnd(KnownBaseline):
    """Collects all scans, and maps them at the end of the log."""

    def __init__(self, dimension: int) -> None:
        super().__init__(dimension)
        self._points: list[Floats] = []
        self._map = NO_MAP

    def _placed(self, points: Floats, labels: Ints) -> Pose | None:
        self._points.append(points)
        return None

    def finish(self) -> None:
        """Solve."""
        self._map = self._solved(self._log)

    @abstractmethod
    def _solved(self, log: ObservationLog) -> LandmarkMap:
        """Return the map of all scans."""

    @property
    def _log(self) -> ObservationLog:
        """All identified observations, iterations counted from 0."""
        return ObservationLog.of_scans(self._points, [ids[ids >= 0] for ids in self._labels[1:]])

    @property
    def map(self) -> LandmarkMap:
        """The landmarks; none before the end."""
        return self._map

    @property
    def trajectory(self) -> Floats:
        """The poses (k, 4, 4) that fit each scan to the map; NaN if undetermined."""
        log, found = self._log, self._map
        assert log.ids is not None
        k, d = len(log), self._d
        poses = np.full((k, 4, 4), np.nan)
        mapped = np.isin(log.ids, found.landmark_ids)
        if not mapped.any():
            return poses
        there = found.positions[np.searchsorted(found.landmark_ids, log.ids[mapped]), :d]
        weights, at = np.ones(len(there)), log.iteration[mapped]
        R, t, fixed = fit_rigid_each(log.points_robot[mapped], there, weights, at, k)
        poses[fixed] = transforms(R[fixed], t[fixed])
        return poses


def fitted(points_robot: Floats, places: Floats) -> Pose | None:
    """Return the pose that brings points (n, d) closest to places (n, d); None if undetermined."""
    return fit_rigid(points_robot, places) if fixes_rotation(places) else None


def map_of(places: Mapping[int, Floats]) -> LandmarkMap:
    """Return the map of landmarks by label; each position is (d,), metres."""
    labels = sorted(places)
    if not labels:
        return NO_MAP
    return LandmarkMap(np.array(labels, np.int64), in_space(np.array([places[i] for i in labels])))
