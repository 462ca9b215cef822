"""The online engine: `update(scan)` runs the paper's steps in the paper's order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relmap.core.alignment import fit_rigid
from relmap.core.chart import PointChart
from relmap.core.config import MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.globalmap import GlobalMap
from relmap.core.grouping import Group, grow_group
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup, in_space
from relmap.core.noise import NoiseEstimate
from relmap.core.pose import poses_from_map
from relmap.core.registration import KnownAssociation, NearestPrevious, Registration
from relmap.core.scan import checked_ids, checked_points
from relmap.core.schedule import GroupingSchedule
from relmap.core.store import ObservationStore

LONGEST_INTERVAL = 256
"""Iterations that a chart goes back at most, however long its landmark has found no group."""


class RelativeMapper(ABC):
    """Builds a global map out of relative maps, one scan at a time.

    A variant supplies the consistent basis, and how few shared landmarks fix a group in it.

    Parameters
    ----------
    config : MapperConfig, optional
    """

    def __init__(self, config: MapperConfig | None = None) -> None:
        self.config = config or MapperConfig()
        self._registration: Registration | None = None
        self._store = ObservationStore()
        self._schedule = GroupingSchedule(self.config.group_after, self.config.max_missed)
        self._map = GlobalMap()
        self._noise = NoiseEstimate()
        self._groups: list[MappedGroup] = []

    @abstractmethod
    def _relative_map(self, block: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Average a group's block (g, i, d) in its consistent basis, or None if it fixes none."""

    @abstractmethod
    def _min_shared(self) -> int:
        """Return how few mapped landmarks fix a group."""

    def update(self, points: ArrayLike, ids: ArrayLike | None = None) -> NDArray[np.int64]:
        """Take in the observations of one iteration.

        Parameters
        ----------
        points : (n, 2) or (n, 3) array, robot frame, metres
            Two columns make a planar world.
        ids : (n,) array of int, optional
            Known association; negative where a landmark was not identified.  They come with every
            scan or with none.

        Returns
        -------
        (n,) int64
            Label of the landmark of each observation; -1 where it was not identified.

        Raises
        ------
        RelmapError
            Where the scan cannot be meant; the mapper is then as it was.
        """
        points_robot = checked_points(points, self._store.dimension)
        known = None if ids is None else checked_ids(ids, len(points_robot))
        registration = self._registration_for(known)
        landmarks = registration.match(points_robot, known)
        seen = landmarks >= 0
        left = self._observe(landmarks[seen], points_robot[seen])
        self._group_due(landmarks[seen], left)
        labels = landmarks.copy()
        labels[seen] = registration.labels[landmarks[seen]]
        return labels

    def finish(self) -> None:
        """Group what is still in view and not mapped yet, as if it had left."""
        self._group_unmapped(self._schedule.in_view)

    def _registration_for(self, ids: NDArray[np.int64] | None) -> Registration:
        if self._registration is None:
            nearest = NearestPrevious(self.config.gate_m)
            self._registration = nearest if ids is None else KnownAssociation()
        if isinstance(self._registration, KnownAssociation) != (ids is not None):
            given = "came with" if ids is None else "did not come with"
            raise RelmapError(f"ids {given} the scans before; give them with every scan or none")
        return self._registration

    def _observe(
        self, landmarks: NDArray[np.int64], points_robot: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Store one iteration (Fig. 3); return the landmarks that have left the view."""
        iteration = self._store.n_iterations
        self._store.append(landmarks, points_robot)
        self._map.resize(int(landmarks.max(initial=-1)) + 1, self._store.dimension)
        return self._schedule.see(landmarks, iteration)

    def _group_due(self, seen: NDArray[np.int64], left: NDArray[np.int64]) -> None:
        """Group whoever was seen often enough since the last time, or is seen no longer."""
        for seed in self._schedule.due(seen):
            if self._schedule.is_due(seed):
                self._group(seed)
        self._group_unmapped(left)

    def _group_unmapped(self, landmarks: NDArray[np.int64]) -> None:
        for seed in landmarks:
            if self._map.weights[seed] == 0:
                self._group(seed)

    def _group(self, seed: int) -> None:
        """Grow a group around a landmark, average it, and align it to the map (section III)."""
        end = self._store.n_iterations
        begin = max(self._schedule.begin[seed], end - LONGEST_INTERVAL)
        chart = PointChart.around(seed, self._store, begin, end)
        if self._map.is_empty:  # the frame is the robot's at the start of the first group
            chart = chart.from_the_start()
        fixes = self._min_shared()
        weights = self._map.weights[chart.landmarks]
        group = grow_group(chart, weights, fixes + 1, 0 if self._map.is_empty else fixes)
        if group is None:
            return
        block = self._store.gather(group.landmarks, group.iterations)
        relative_map = self._relative_map(block)
        if relative_map is None:
            return
        self._place(group, relative_map, block)

    def _place(
        self, group: Group, relative_map: NDArray[np.float64], block: NDArray[np.float64]
    ) -> None:
        """Bring a relative map into the global one; the first goes to its first observations."""
        members, iterations = group.landmarks, group.iterations
        if self._map.is_empty:
            R, t = fit_rigid(relative_map, block[:, 0])
            placed = relative_map @ R.T + t
        else:
            aligned = self._map.align(members, relative_map, len(iterations))
            if aligned is None:
                return
            placed = aligned
        unused = np.sum(iterations >= self._schedule.begin[members][:, None], axis=1)
        self._map.average_in(members, placed, unused)
        self._schedule.grouped(members, self._store.n_iterations)
        self._noise.add(block)
        self._groups.append(MappedGroup(members, iterations, relative_map))

    @property
    def map(self) -> LandmarkMap:
        """The mapped landmarks, in ascending order of their labels."""
        table = self.landmarks
        mapped = table.level > 0
        return LandmarkMap(table.landmark[mapped], table.position[mapped])

    @property
    def landmarks(self) -> LandmarkTable:
        """Every landmark ever seen, mapped or not."""
        n = len(self._map.weights)
        labels = self._labels
        order = np.argsort(labels)
        seen = self._store.landmarks
        iterations = self._store.seen(0, self._store.n_iterations)[1]
        first, last = np.full(n, self._store.n_iterations), np.full(n, -1)
        np.minimum.at(first, seen, iterations)
        np.maximum.at(last, seen, iterations)
        weights = self._map.weights
        mapped = weights > 0
        sd = np.where(mapped, self._noise.sigma_m / np.sqrt(np.where(mapped, weights, 1)), np.nan)
        return LandmarkTable(
            landmark=labels[order],
            position=in_space(self._map.positions)[order],
            sd=sd[order],
            observations=np.bincount(seen, minlength=n)[order],
            first_iteration=first[order],
            last_iteration=last[order],
            level=mapped.astype(np.int64)[order],
            status=np.where(mapped, "static", "unmapped")[order],
        )

    @property
    def groups(self) -> list[MappedGroup]:
        """The groups behind the map, in the order in which they were placed."""
        labels = self._labels
        return [replace(group, landmarks=labels[group.landmarks]) for group in self._groups]

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """``T_map_robot`` of every iteration (k, 4, 4), for display; NaN where it is not fixed."""
        return poses_from_map(self._store, self._map.positions, 0, self._store.n_iterations)

    @property
    def noise_m(self) -> float:
        """Estimated standard deviation of an observed coordinate, metres; NaN if not known yet."""
        return self._noise.sigma_m

    @property
    def _labels(self) -> NDArray[np.int64]:
        if self._registration is None:
            return np.empty(0, dtype=np.int64)
        return self._registration.labels
