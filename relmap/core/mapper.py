"""The engine: `update` runs the paper's steps, in the paper's order, one scan at a time.

`turns` decides which landmark is grouped in which iteration; `afterwards` and `repairing` contain
the operations on the whole map.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.choice import DataAssociation
from relmap.core.association.reobservation.merging import Merger
from relmap.core.config import MapperConfig
from relmap.core.grouping.averaging import Averaging
from relmap.core.grouping.chart import PointChart, grow_group
from relmap.core.grouping.completion import RelativeMap
from relmap.core.grouping.levels import GroupLevels
from relmap.core.keeping import keep_motion, keep_observations, variances_of
from relmap.core.map.globalmap import GlobalMap
from relmap.core.map.placing import leave_out_moving, place
from relmap.core.model import LandmarkModel
from relmap.core.odometry import Motions, OdometryUse
from relmap.core.refinement.condensing import CondensedSegments, SegmentRows
from relmap.core.refinement.hinges import Hinges
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.live import LiveRefinement
from relmap.core.state.kept import KeptObservations
from relmap.core.state.schedule import GroupingSchedule
from relmap.core.state.store import ObservationStore
from relmap.core.state.table import LandmarkState
from relmap.core.turns import take_turns


class RelativeMapper:
    """Builds a global map of one kind of landmark from relative maps, one scan at a time."""

    refined: list[Refined]
    hinges: Hinges | None
    odometry: OdometryUse | None
    STATE = (
        "landmarks=table association observations=store schedule averaging map groups=levels "
        "merger segments motions kept odometry live refined hinges"
    )

    def __init__(self, model: LandmarkModel, config: MapperConfig) -> None:
        self.model = model
        self.config = config
        self.table = LandmarkState()
        self.association = DataAssociation(model, config)
        keeps = model.keeps_observations or config.keep_observations
        self.store = ObservationStore(model.columns, model.points, keeps, self.table)
        self.schedule = GroupingSchedule(self.table, config)
        self.averaging = Averaging(self.table, model.noise_spread)
        self.map = GlobalMap(self.table)
        self.levels = GroupLevels(self.table)
        self.merger = Merger(self.table, model, config.group_after)
        self.segments = CondensedSegments(model.noise_spread)
        self.motions, self.kept = Motions(), KeptObservations()
        self.odometry = None
        self.live = LiveRefinement(self.segments, self.map)
        self.refined, self.hinges = [], None

    def update(
        self,
        seen: Any,
        ids: Ints | None,
        covariances: Floats | None = None,
        odometry: Floats | None = None,
    ) -> Ints:
        """Process one scan.

        `seen`: sequence of n observations of the model's kind, robot frame. `ids` (n,): known
        association; negative where a landmark was not identified. `covariances` (n, d, d): only for
        points; robot frame, square metres. `odometry` (4, 4): pose of the robot in its frame of the
        previous iteration. Returns (n,): landmark of each observation, as numbered by the
        association; negative if unknown. Raises `RelmapError` if ids come with some scans but not
        with others.
        """
        iteration = self.store.n_iterations
        if len(seen) or self.association.registration is not None:
            self.association.choose(ids, iteration)
        keep_motion(self, odometry)
        # Register: match observations to those of earlier scans, untransformed (section II).
        found = self.association.match(seen, ids, odometry, covariances)
        self.refined, self.hinges, self.odometry = [], None, None
        # Store every observation untransformed (Fig. 3).
        landmarks = self._store(seen, found, iteration)
        keep_observations(self, found, seen, covariances)
        # Group landmarks that are due, merge and forget (section III).
        take_turns(self, self.schedule.see(landmarks, iteration))
        return found

    def _store(self, seen: Any, found: Ints, iteration: int) -> Ints:
        """Add landmarks to the table and their observations to the store; return the landmarks."""
        rows = self.model.rows(seen, found)
        self.averaging.noise.limit(self.model.least_noise_m(rows))
        shown = self.model.points(rows)
        landmarks = self.table.enter(shown.landmarks, shown.points_robot, iteration)
        self.store.append(**rows)
        return landmarks

    def group(self, seed: int, level: int) -> Ints:
        """Group a landmark with those seen with it, at level 1, 2 or 3; return the mapped ones."""
        chart, fixes = self.chart(seed), self.model.min_shared(self.table.dimension)
        for submap in self.map.submaps_of(chart.landmarks, fixes):
            weights = self.map.weights_in(submap, chart.landmarks)
            relative = self.relative_map(chart, weights, fixes)
            if relative is None:
                continue
            # Align: least-squares fit to the members that are already mapped.
            placed = self.map.align(submap, relative.landmarks, relative.positions, relative.n_used)
            if placed is not None:
                sure = np.isfinite(placed[:, 0])
                placed = placed.take(sure.nonzero()[0], axis=0)
                return place(self, submap, level, placed, relative.only(sure))
        return np.empty(0, dtype=np.int64)

    def chart(self, seed: int) -> PointChart:
        """Chart the landmarks seen together with one in its current interval (Figs 9, 10)."""
        begin = max(int(self.table.begin[seed]), self.store.first_iteration)
        chart = PointChart.around(seed, self.store, begin, self.store.n_iterations)
        variance = variances_of(self, chart.landmarks, begin)
        return chart if variance is None else replace(chart, variance=variance)

    def relative_map(
        self, chart: PointChart, weights: Floats, min_shared: int
    ) -> RelativeMap | None:
        """Average the static landmarks of a chart relative to each other; update which ones move.

        None if no group can be grown, or the group determines no basis.
        """
        relative, fewest = None, self.model.min_shared(self.table.dimension) + 1
        static = self.averaging.static(chart, weights)  # Fig. 12
        group = grow_group(chart, static, weights, fewest, min_shared)  # Fig. 11
        if group is not None:
            average = self.model.average_in_basis(group.points_robot)  # Figs 1, 2 and 8
            if average is not None:
                relative = self.averaging.completed(chart, group, average)
        leave_out_moving(self, chart.landmarks)
        return relative

    def merge(self, placed: Ints, noise_m: float) -> int:
        """Merge re-observed landmarks among landmarks (k,) with the older ones; return how many.

        `noise_m`: standard deviation of an observed coordinate, metres.
        """
        return self.merge_pairs(self.merger.find(placed, noise_m))

    def merge_pairs(self, pairs: Ints) -> int:
        """Merge each pair (k, 2) of a landmark and the older one that it is; return how many."""
        if not len(pairs):
            return 0
        are_distinct = len(set(pairs.ravel().tolist())) == pairs.size
        for new, old in [pairs.T] if are_distinct else pairs[:, :, None]:
            for part in (self.table, self.schedule, self.merger):
                part.merge(new, old)
        return len(pairs)

    @property
    def rows(self) -> SegmentRows:
        """The condensed observations of all iterations."""
        return self.segments.with_rest(self.store, self.table.dynamic)

    @property
    def noise_m(self) -> float:
        """Standard deviation of an observed coordinate, metres; NaN before any repeated one.

        Estimated by the groups, or within segments if no landmark was in view long enough.
        """
        noise = self.averaging.noise
        is_known = np.isfinite(noise.sigma_m)
        return noise.sigma_m if is_known else max(self.rows.noise_m, noise.least_m)
