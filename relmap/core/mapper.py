"""The online engine: `update(scan)` runs the paper's steps in the paper's order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relmap.core.building import MapBuilder
from relmap.core.condensing import CondensedSegments, SegmentRows
from relmap.core.config import WITH_IDS, MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.identity import Identity
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup, Piece
from relmap.core.levels import GroupLevels
from relmap.core.live import SLICE_EVERY, LiveRefinement
from relmap.core.merging import Merger
from relmap.core.observations import KeptObservations
from relmap.core.piecewise import refine_pieces
from relmap.core.pose import trajectory
from relmap.core.readout import (
    landmark_map,
    landmark_table,
    map_pieces,
    positions_in_largest_piece,
)
from relmap.core.refinement import Refined
from relmap.core.registration import (
    Constellation,
    KnownAssociation,
    NearestPrevious,
    Registration,
)
from relmap.core.scan import checked_ids, checked_labels, checked_points
from relmap.core.schedule import GroupingSchedule
from relmap.core.seenagain import SeenAgain
from relmap.core.sightings import Sightings
from relmap.core.store import ObservationStore


class RelativeMapper(ABC):
    """Builds a global map out of relative maps, one scan at a time.

    A variant supplies the consistent basis, and how few shared landmarks fix a group in it.

    Parameters
    ----------
    config : MapperConfig, optional
    """

    _noise_spread = 1.0
    """How many times noisier than the typical landmark the noisiest are."""
    _unused: ClassVar[dict[str, str]] = {}
    """Settings that the variant ignores, and why."""

    def __init__(self, config: MapperConfig | None = None) -> None:
        self.config = config or MapperConfig()
        self.config.refuse(self._unused)
        self._registration: Registration | None = None
        self._begun = 0
        self._store = ObservationStore()
        self._segments = CondensedSegments()
        self._kept = KeptObservations() if self.config.keep_observations else None
        self._refined: list[Refined] = []
        self._identity = Identity()
        self._sightings = Sightings()
        levels = GroupLevels()
        self._schedule = GroupingSchedule(
            self.config.group_after, self.config.max_missed, self._sightings, levels
        )
        self._builder = MapBuilder(
            self._store, self._schedule, levels, self._relative_map, self._noise_spread
        )
        self._live = LiveRefinement(self._segments, self._builder.map)
        merger = Merger(self._builder.map, self._sightings, self.config.group_after)
        states = self._identity, self._sightings, self._schedule, self._builder
        self._seen_again = SeenAgain(merger, self._store, self._builder, states)

    @staticmethod
    @abstractmethod
    def _relative_map(block: NDArray[np.float64]) -> NDArray[np.float64] | None:
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
            Label of the landmark of each observation; -1 where it was not identified.  A landmark
            that is recognised later changes its label: see `landmarks_of`.

        Raises
        ------
        RelmapError
            Where the scan cannot be meant; the mapper is then as it was.
        """
        points_robot = checked_points(points, self._store.dimension)
        known = None if ids is None else checked_ids(ids, len(points_robot))
        if self._registration is None and not len(points_robot):
            self._observe(np.empty(0, dtype=np.int64), points_robot)
            return np.empty(0, dtype=np.int64)
        registration = self._registration_for(known)
        landmarks = registration.match(points_robot, known)
        seen = landmarks >= 0
        self._refined = []
        self._identity.resize(int(landmarks.max(initial=-1)) + 1)
        present = self._identity.of(landmarks[seen])
        left = self._observe(present, points_robot[seen])
        self._go_on(present, left)
        labels = landmarks.copy()
        labels[seen] = registration.labels_of(self._identity.of(landmarks[seen]))
        return labels

    def landmarks_of(self, labels: ArrayLike) -> NDArray[np.int64]:
        """Return what landmarks (n,), labelled by earlier updates, are called now.

        A landmark lost and seen again has a label of its own until it is recognised; -1 stays.
        A label that no update has returned raises `RelmapError`.
        """
        labels = checked_labels(labels, np.append(self._labels, -1))
        if self._has_ids:
            return labels
        return np.where(labels >= 0, self._identity.of(labels), labels)

    def finish(self) -> None:
        """Group what is still in view and not mapped yet, and what has left for the last time."""
        for seed in self._schedule.in_view.tolist():
            if self._builder.map.weights[seed] == 0:
                self._group_or_found(seed, 1)
        self._schedule.end()
        gone = self._schedule.gone
        for seed in gone[np.argsort(-self._schedule.counts[gone], kind="stable")].tolist():
            if self._schedule.is_gone[seed]:
                self._last_pass(seed)

    def refine(self) -> None:
        """Bring all landmarks to where all observations agree best, by joint least squares.

        The chain of groups drifts; this spreads what is left of it, after a loop was closed above
        all, over the whole map.  Without ids, landmarks that then lie where older ones do that they
        may be are merged (see `landmarks_of`).  From then on until the next update it is also known
        how sure each position is.  With `keep_observations`, bounded noise is made use of.
        """
        self._refine_pieces()
        if not self._has_ids and self._seen_again.merge_doubles():
            self._refine_pieces()
        self._seen_again.merger.look_again()

    def _refine_pieces(self) -> None:
        of = self._identity.of(np.arange(len(self._builder.map.pieces)))
        moving = self._builder.dynamics.dynamic
        self._refined = refine_pieces(self._builder.map, self._rows, of, moving, self._kept)

    def _registration_for(self, ids: NDArray[np.int64] | None) -> Registration:
        if self._registration is None:
            if ids is not None:
                self.config.refuse(WITH_IDS)
            self._begun = self._store.n_iterations
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
        if self._kept is not None:
            self._kept.append(iteration, landmarks, points_robot)
        self._builder.resize(int(landmarks.max(initial=-1)) + 1)
        return self._schedule.see(landmarks, iteration)

    def _go_on(self, seen: NDArray[np.int64], left: NDArray[np.int64]) -> None:
        """Group, group for the last time, condense or refine: one at a time, in turns."""
        self._schedule.note_due(seen)
        self._seen_again.merger.leave(left)
        self._seen_again.merger.go_on()
        steps = (self._group_next, self._last_pass_next, self._condense_next, self._refine_next)
        turn = self._store.n_iterations
        for k in range(len(steps)):
            if steps[(turn + k) % len(steps)]():
                break

    def _group_next(self) -> bool:
        """Group whoever was seen often enough since the last time; tell whether somebody was."""
        due = self._schedule.next_due()
        if due is None or self._builder.dynamics.dynamic[due[0]]:
            return False
        self._group_or_found(*due)
        return True

    def _last_pass_next(self) -> bool:
        """Group whoever is seen no longer over the whole interval; tell whether somebody was."""
        seed = self._builder.next_last_pass()
        if seed is not None:
            self._last_pass(seed)
        return seed is not None

    def _condense_next(self) -> bool:
        """Condense observations that are no longer needed; tell whether there were any."""
        return self._builder.forget(self._segments)

    def _refine_next(self) -> bool:
        """Do a slice of refining the live map; tell whether there was any to do.

        Not in every iteration, so that a typical one takes as long as before.
        """
        if self._store.n_iterations % SLICE_EVERY:
            return False
        if self._live.advance(self._identity.of):
            self._seen_again.merger.look_again()
        return self._live.is_busy

    def _group_or_found(self, seed: int, level: int) -> None:
        fixes = self._min_shared()
        placed = self._builder.group(seed, level, fixes)
        if len(placed):
            self._merge(placed)
        elif self._builder.map.weights[seed] == 0:
            self._builder.found_piece(seed, level, fixes)

    def _last_pass(self, seed: int) -> None:
        """Group a landmark over its whole interval, and look for a last time who it is."""
        placed = self._builder.last_pass(seed, self._min_shared())
        if len(placed):
            self._merge(placed)
        self._seen_again.merger.leave(np.array([seed]))

    def _merge(self, placed: NDArray[np.int64]) -> None:
        if not self._has_ids:
            self._seen_again.merge(placed)

    @property
    def map(self) -> LandmarkMap:
        """The mapped landmarks, in ascending order of their labels."""
        return landmark_map(self._builder, self._refined, self._labels)

    @property
    def landmarks(self) -> LandmarkTable:
        """Every landmark ever seen, mapped or not."""
        labels, own = self._labels, self._identity.own
        return landmark_table(self._sightings, self._builder, self._refined, labels, own)

    @property
    def pieces(self) -> list[Piece]:
        """The pieces of the map, the largest first; more than one where it fell apart."""
        return map_pieces(self._sightings, self._builder.map, self._labels)

    @property
    def groups(self) -> list[MappedGroup]:
        """The groups behind the map, in the order in which they were placed."""
        labels, of = self._labels, self._identity.of
        groups = self._builder.levels.groups
        return [replace(group, landmarks=labels[of(group.landmarks)]) for group in groups]

    @property
    def refined(self) -> list[Refined]:
        """The pieces of the map as refined, in ascending order; none after a later update.

        They tell how well each segment of the run, and each merge, fits the map.  Landmarks go by
        their numbers there, in order of first sight.
        """
        return list(self._refined)

    @property
    def rejected(self) -> NDArray[np.int64]:
        """Iterations (r,), ascending, whose scans fit no other and so add nothing to the map."""
        scans = [] if self._registration is None else self._registration.rejected
        return np.array(scans, dtype=np.int64) + self._begun

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """``T_map_robot`` of every iteration (k, 4, 4), for display; NaN where it is not fixed."""
        positions = positions_in_largest_piece(self._builder.map)
        return trajectory(self._rows, positions, self._identity.of(np.arange(len(positions))))

    @property
    def noise_m(self) -> float:
        """Estimated standard deviation of an observed coordinate, metres; NaN if not known yet."""
        return float(self._builder.noise.sigma_m)

    @property
    def _has_ids(self) -> bool:
        """Whether nothing is left to find out about who is who."""
        return self._registration is None or isinstance(self._registration, KnownAssociation)

    @property
    def _rows(self) -> SegmentRows:
        return self._segments.with_rest(self._store, self._builder.dynamics.dynamic)

    @property
    def _labels(self) -> NDArray[np.int64]:
        if self._registration is None:
            return np.empty(0, dtype=np.int64)
        return self._registration.labels_of(np.arange(len(self._sightings.counts)))
