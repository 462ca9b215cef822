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
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup, Piece
from relmap.core.noise import NoiseEstimate
from relmap.core.pose import poses_from_map
from relmap.core.readout import landmark_table, map_pieces, positions_in_largest_piece
from relmap.core.registration import (
    Constellation,
    KnownAssociation,
    NearestPrevious,
    Registration,
)
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
        """Group what is still in view and not mapped yet."""
        for seed in self._schedule.in_view:
            if self._map.weights[seed] == 0 and not self._group(seed):
                self._found_piece(seed)

    def _registration_for(self, ids: NDArray[np.int64] | None) -> Registration:
        if self._registration is None:
            self._registration = KnownAssociation() if ids is not None else self._own_registration()
        if isinstance(self._registration, KnownAssociation) != (ids is not None):
            given = "came with" if ids is None else "did not come with"
            raise RelmapError(f"ids {given} the scans before; give them with every scan or none")
        return self._registration

    def _own_registration(self) -> Registration:
        if self.config.registration == "nearest-previous":
            return NearestPrevious(self.config.gate_m)
        return Constellation(self.config.max_missed)

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
            if self._schedule.is_due(seed) and not self._group(seed):
                self._found_piece(seed)
        for seed in left:
            if self._map.weights[seed] == 0:
                self._group(seed)

    def _group(self, seed: int) -> bool:
        """Grow a group around a landmark, average it, and align it to the map (section III)."""
        chart = self._chart(seed)
        fixes = self._min_shared()
        for piece in self._map.pieces_of(chart.landmarks):
            weights = self._map.weights_in(piece, chart.landmarks)
            group = grow_group(chart, weights, min_members=fixes + 1, min_shared=fixes)
            if group is not None and self._align(group, piece):
                return True
        return False

    def _align(self, group: Group, piece: int) -> bool:
        block = self._store.gather(group.landmarks, group.iterations)
        relative_map = self._relative_map(block)
        if relative_map is None:
            return False
        n_iterations = len(group.iterations)
        placed = self._map.align(piece, group.landmarks, relative_map, n_iterations)
        if placed is None:
            return False
        self._map.average_in(piece, group.landmarks, placed, self._unused(group))
        self._keep(group, relative_map, block)
        return True

    def _found_piece(self, seed: int) -> None:
        """Begin the map, or a new piece of it where what is in view is not enough to go on.

        The frame is that of the robot in the first iteration of the group.
        """
        fixes = self._min_shared()
        if np.sum(self._map.weights[self._schedule.in_view] > 0) >= fixes:
            return
        chart = self._chart(seed).from_the_start()
        group = grow_group(chart, np.zeros(len(chart.landmarks)), fixes + 1, min_shared=0)
        if group is None:
            return
        block = self._store.gather(group.landmarks, group.iterations)
        relative_map = self._relative_map(block)
        if relative_map is None:
            return
        R, t = fit_rigid(relative_map, block[:, 0])
        self._map.found(group.landmarks, relative_map @ R.T + t, self._unused(group))
        self._keep(group, relative_map, block)

    def _chart(self, seed: int) -> PointChart:
        end = self._store.n_iterations
        begin = max(self._schedule.begin[seed], end - LONGEST_INTERVAL)
        return PointChart.around(seed, self._store, begin, end)

    def _unused(self, group: Group) -> NDArray[np.float64]:
        """Return how many iterations of each member no group has used before; (g,)."""
        begin = self._schedule.begin[group.landmarks]
        return np.asarray(np.sum(group.iterations >= begin[:, None], axis=1, dtype=np.float64))

    def _keep(
        self, group: Group, relative_map: NDArray[np.float64], block: NDArray[np.float64]
    ) -> None:
        self._schedule.grouped(group.landmarks, self._store.n_iterations)
        self._noise.add(block)
        self._groups.append(MappedGroup(group.landmarks, group.iterations, relative_map))

    @property
    def map(self) -> LandmarkMap:
        """The mapped landmarks, in ascending order of their labels."""
        table = self.landmarks
        mapped = table.level > 0
        return LandmarkMap(table.landmark[mapped], table.position[mapped])

    @property
    def landmarks(self) -> LandmarkTable:
        """Every landmark ever seen, mapped or not."""
        return landmark_table(self._store, self._map, self._labels, self.noise_m)

    @property
    def pieces(self) -> list[Piece]:
        """The pieces of the map, the largest first; more than one where it fell apart."""
        return map_pieces(self._store, self._map, self._labels)

    @property
    def groups(self) -> list[MappedGroup]:
        """The groups behind the map, in the order in which they were placed."""
        labels = self._labels
        return [replace(group, landmarks=labels[group.landmarks]) for group in self._groups]

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """``T_map_robot`` of every iteration (k, 4, 4), for display; NaN where it is not fixed."""
        positions = positions_in_largest_piece(self._map)
        return poses_from_map(self._store, positions, 0, self._store.n_iterations)

    @property
    def noise_m(self) -> float:
        """Estimated standard deviation of an observed coordinate, metres; NaN if not known yet."""
        return self._noise.sigma_m

    @property
    def _labels(self) -> NDArray[np.int64]:
        if self._registration is None:
            return np.empty(0, dtype=np.int64)
        return self._registration.labels
