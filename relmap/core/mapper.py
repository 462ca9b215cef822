"""The engine: `update` runs the paper's steps, in the paper's order, one scan at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.association import KnownAssociation, Registration
from relmap.core.association.merging import Merger, merge_doubles
from relmap.core.association.tying import tie_submaps
from relmap.core.config import WITH_IDS, MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.grouping.averaging import Averaging
from relmap.core.grouping.chart import PointChart
from relmap.core.grouping.completion import RelativeMap
from relmap.core.grouping.growth import grow_group
from relmap.core.grouping.levels import GroupLevels
from relmap.core.map.globalmap import GlobalMap
from relmap.core.map.placing import Placing
from relmap.core.model import LandmarkModel
from relmap.core.refinement.by_submap import refine_submaps
from relmap.core.refinement.condensing import CondensedSegments, SegmentRows
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.live import LiveRefinement
from relmap.core.refinement.observations import KeptObservations
from relmap.core.state.schedule import GroupingSchedule
from relmap.core.state.store import ObservationStore
from relmap.core.state.table import LandmarkState
from relmap.core.turns import take_turns


class RelativeMapper:
    """Builds a global map out of relative maps, one scan at a time.

    Parameters
    ----------
    model : LandmarkModel
        The kind of landmark.
    config : MapperConfig
    """

    refined: list[Refined]
    STATE = (
        "landmarks=table is_known first_scan association observations=store schedule "
        "averaging map groups=levels merger segments live kept refined"
    )

    def __init__(self, model: LandmarkModel, config: MapperConfig) -> None:
        self.model = model
        self.config = config
        self.table = LandmarkState()
        self.association: Registration | None = None
        self.first_scan = 0
        self.store = ObservationStore()
        self.schedule = GroupingSchedule(self.table, config.group_after, config.max_missed)
        self.averaging = Averaging(self.table, model.noise_spread)
        self.map = GlobalMap(self.table)
        self.levels = GroupLevels(self.table)
        self.placing = Placing(self.store, self.schedule, self.map, self.levels)
        self.merger = Merger(self.table, model, config.group_after)
        self.segments = CondensedSegments()
        self.live = LiveRefinement(self.segments, self.map)
        self.kept = KeptObservations() if config.keep_observations else None
        self.refined = []

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Take in one scan that has been checked.

        Parameters
        ----------
        points_robot : (n, d) float64, robot frame, metres
        ids : (n,) int64, optional
            Known association; negative where a landmark was not identified.

        Returns
        -------
        (n,) int64
            Label of the landmark of each observation; -1 where it was not identified.

        Raises
        ------
        RelmapError
            Where ids come with some scans and not with others.
        """
        if self.association is None and not len(points_robot):
            self._store(np.empty(0, dtype=np.int64), points_robot)
            return np.empty(0, dtype=np.int64)
        association = self._association_for(ids)
        landmarks = association.match(points_robot, ids)  # with earlier scans, untransformed (II)
        seen = landmarks >= 0
        self.refined = []
        n, dimension = int(landmarks.max(initial=-1)) + 1, points_robot.shape[1]
        self.table.resize(n, self.store.n_iterations, dimension)
        present = self.table.landmark_of[landmarks[seen]]
        left = self._store(present, points_robot[seen])  # Fig. 3
        take_turns(self, present, left)  # section III: group, average, align, merge, forget
        labels = landmarks.copy()
        labels[seen] = association.labels_of(self.table.landmark_of[landmarks[seen]])
        return labels

    def _store(
        self, landmarks: NDArray[np.int64], points_robot: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Store one iteration (Fig. 3); return the landmarks that have left the view."""
        iteration = self.store.n_iterations
        self.store.append(landmarks, points_robot)
        if self.kept is not None:
            self.kept.append(iteration, landmarks, points_robot)
        return self.schedule.see(landmarks, iteration)

    def group(self, seed: int, level: int) -> NDArray[np.int64]:
        """Group a landmark with what was seen together with it; return the landmarks mapped (k,).

        The group comes into the map at a level, 1, 2 or 3; nothing where it cannot be aligned.
        """
        fixes = self.model.min_shared(self.store.dimension)
        chart = self._chart(seed)  # Figs 9 and 10
        for submap in self.map.submaps_of(chart.landmarks, fixes):
            weights = self.map.weights_in(submap, chart.landmarks)
            averaged = self._relative_map(chart, weights, fixes + 1, fixes)
            if averaged is None:
                continue
            relative = averaged[0]
            placed = self.map.align(submap, relative.landmarks, relative.positions, relative.n_used)
            if placed is not None:
                return self.placing.place(submap, level, placed, *averaged)
        return np.empty(0, dtype=np.int64)

    def found_submap(self, seed: int, level: int) -> None:
        """Begin the map, or a new submap where what is in view is not enough to go on.

        The frame is that of the robot in the first iteration of the group.
        """
        fixes = self.model.min_shared(self.store.dimension)
        mapped_in_view = np.sum(self.table.weight[self.schedule.in_view] > 0)
        if mapped_in_view >= fixes or self.table.dynamic[seed]:
            return
        chart = self._chart(seed)
        if not len(chart.iterations):
            return
        chart = chart.only(chart.visible[:, 0])
        averaged = self._relative_map(chart, np.zeros(len(chart.landmarks)), fixes + 1, 0)
        if averaged is None:
            return
        relative = averaged[0]
        first = chart.points_robot[np.isin(chart.landmarks, relative.landmarks), 0]
        if len(first) > fixes:
            R, t = fit_rigid(relative.positions, first)
            placed = relative.positions @ R.T + t
            self.placing.place(self.map.new_submap(), level, placed, *averaged)

    def _chart(self, seed: int) -> PointChart:
        """Chart what was seen with a landmark in its present interval (Figs 9 and 10)."""
        begin = max(self.table.begin[seed], self.store.first_iteration)
        return PointChart.around(seed, self.store, begin, self.store.n_iterations)

    def _relative_map(
        self, chart: PointChart, weights: NDArray[np.float64], min_members: int, min_shared: int
    ) -> tuple[RelativeMap, NDArray[np.int64]] | None:
        """Average the static landmarks of a chart relative to one another.

        Returns
        -------
        (relative map, iterations) or None
            The map, completed to all at rest, and the common interval of the group it began with;
            None where no group can be grown, or it fixes no basis.
        """
        static = self.averaging.static(chart, weights)  # Fig. 12
        group = grow_group(chart, static, weights, min_members, min_shared)  # Fig. 11
        core = None if group is None else chart.points_robot[group.rows][:, group.columns]
        average = None if core is None else self.model.average_in_basis(core)  # Figs 1, 2 and 8
        relative = None
        if group is not None and core is not None and average is not None:
            relative = self.averaging.completed(chart, group, core, average)
        self._leave_out_moving(chart.landmarks)
        if group is None or relative is None:
            return None
        return relative, chart.iterations[group.columns]

    def _leave_out_moving(self, landmarks: NDArray[np.int64]) -> None:
        moving = landmarks[self.table.dynamic[landmarks]]
        if len(moving):
            self.table.take_off_map(moving)
            self.levels.leave(moving)
            self.schedule.begin_anew(moving, self.store.n_iterations)

    def merge(self, placed: NDArray[np.int64]) -> int:
        """Merge those of landmarks (k,) that are older ones seen again; return how many were.

        All that is stored of one goes over to the other.
        """
        levels, noise_m = self.table.highest_level[placed], self.averaging.noise.sigma_m
        pairs = self.merger.find(placed, levels, noise_m).tolist()
        for new, old in pairs:
            self.store.relabel(new, old)
            self.table.merge(new, old)
            self.schedule.relabel(new, old)
            self.merger.relabel(new, old)
        return len(pairs)

    def forget(self) -> bool:
        """Condense observations that no group needs any more; tell whether there were any."""
        before = self.schedule.needed_from(self.store.n_iterations)
        condensed = self.segments.condense(self.store, before, self.table.dynamic)
        self.store.forget(min(before, self.segments.end))
        return condensed

    def tie_submaps(self) -> None:
        """Tie submaps that show the same place, and merge what both saw of it."""
        for _ in tie_submaps(self.map, self.averaging.noise.sigma_m):
            merge_doubles(self.table, self.merger, self.merge)

    def refine(self) -> None:
        """Bring all landmarks to where all observations agree best, by joint least squares.

        Without ids, landmarks that then lie where older ones do that they may be are merged.
        """
        self.refined = refine_submaps(self.map, self.rows, self.kept)
        if not self.has_ids and merge_doubles(self.table, self.merger, self.merge):
            self.refined = refine_submaps(self.map, self.rows, self.kept)
        self.merger.look_again()

    def _association_for(self, ids: NDArray[np.int64] | None) -> Registration:
        if self.association is None:
            if ids is not None:
                self.config.refuse(WITH_IDS)
            self.first_scan = self.store.n_iterations
            self.is_known = ids is not None
        if self.is_known != (ids is not None) or self.association is None:
            given = "came with" if ids is None else "did not come with"
            raise RelmapError(f"ids {given} the scans before; give them with every scan or none")
        return self.association

    @property
    def is_known(self) -> bool | None:
        """Whether ids come with the scans; None before the first of them."""
        return None if self.association is None else isinstance(self.association, KnownAssociation)

    @is_known.setter
    def is_known(self, known: bool | None) -> None:
        if known is not None:
            self.association = KnownAssociation() if known else self.model.association(self.config)

    @property
    def has_ids(self) -> bool:
        """Whether nothing is left to find out about who is who."""
        return self.is_known is not False

    @property
    def rows(self) -> SegmentRows:
        """What all iterations said, condensed."""
        return self.segments.with_rest(self.store, self.table.dynamic)
