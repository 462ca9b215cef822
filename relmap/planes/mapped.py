"""What a plane mapper has found so far: walls, corners, submaps, groups and the trajectory."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.guard import reads_whole
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup
from relmap.core.odometry import OdometryUse
from relmap.core.refinement.joint import Refined
from relmap.mapper import Mapper
from relmap.planes.linking.registration import PlaneRegistration
from relmap.planes.refinement.refining import odometry_left_out, on_odometry
from relmap.planes.refinement.solving import corner_covariances, refined_walls
from relmap.planes.scans.beam_store import PlacedBeams
from relmap.planes.submaps.doubtful import free_directions, undetermined_steps
from relmap.planes.submaps.grouped_map import GroupedMap, KeptFrame
from relmap.planes.submaps.submap import WallSubmap, among_all
from relmap.planes.walls.assembly import Assembled, WallNumbers
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.table import (
    PlaneTable,
    corner_group,
    corner_map,
    corner_table,
    plane_table,
)


@reads_whole()
class MappedWalls(Mapper):
    """The results of a plane mapper."""

    _planes: PlaneRegistration
    _refined_walls: tuple[list[WallSubmap], WallNumbers] | None
    _spread: tuple[Assembled, Floats] | None = None
    _weak: tuple[tuple[list[WallSubmap], WallNumbers], Ints] | None = None
    _chained: tuple[list[int], tuple[list[WallSubmap], WallNumbers]] | None = None
    _moved: Ints
    _frame: KeptFrame | None = None

    @property
    def history(self) -> PlaneHistory:
        """A view of all observations of walls, untransformed."""
        store = self.engine.store
        return PlaneHistory(
            iteration=store.iterations,
            plane=store.column("wall"),
            ends=store.column("location"),
            sd=store.column("sd"),
            z_extent=store.column("z_extent"),
            corner=store.column("corner"),
            motion=self._planes.links.motions,
            submap=self._planes.links.submaps,
            measured=self._planes.links.measured,
            spacing_rad=self._planes.links.beams.spacing_rad,
            same=self._planes.links.same_walls,
            kept=-1 if self._frame is None else self._frame.scan,
        )

    @property
    def submaps(self) -> list[WallSubmap]:
        """The unconnected parts of the run, those with most scans first.

        A map to which a log was added is before all others; see `take_up`.
        """
        return self._state[0]

    @property
    def planes(self) -> PlaneTable:
        """Every wall ever seen; those of the first submap are mapped."""
        return self.planes_of(0)

    def planes_of(self, number: int) -> PlaneTable:
        """Return every wall ever seen; those of one submap are mapped, in its frame.

        Parameters
        ----------
        number : int
            Index of the submap in `submaps`.

        Returns
        -------
        PlaneTable
        """
        submaps, numbers = self._state
        assembled = submaps[number].assembled if submaps else None
        return plane_table(self.history, numbers, assembled, self._moving)

    def beams_of(self, number: int, most: int) -> PlacedBeams:
        """Return start and end points of beams of a submap, in its frame.

        Parameters
        ----------
        number : int
            Index of the submap in `submaps`.
        most : int
            Maximum number of beams, by subsampling.

        Returns
        -------
        PlacedBeams
            Start and end points, metres, and the scan of each beam.
        """
        submap = self.submaps[number]
        return self._planes.links.beams.placed(submap.poses, submap.span, most)

    @property
    def map(self) -> LandmarkMap:
        """The mapped corners of the first submap, in ascending order of numbers.

        Their covariances are available after refinement, until the next update; otherwise (0, 3,
        3).
        """
        submaps = self.submaps
        return corner_map(submaps[0].assembled if submaps else None, self._covariances)

    @property
    def landmarks(self) -> LandmarkTable:
        """Every corner ever seen; those of the first submap are mapped.

        Before refinement `sd` covers only the average of a corner, along its wall.
        """
        submaps, numbers = self._state
        moving, spread = self._grouped.moving_corners, self._covariances
        assembled = [submap.assembled for submap in submaps]
        return corner_table(self.history, numbers, assembled, moving, spread)

    @property
    def groups(self) -> list[MappedGroup]:
        """The groups behind the chained map, in the order in which they were placed.

        Their landmarks are corners, numbered as in `landmarks`, without the estimated midpoints.
        Corners that were merged share a number.
        """
        corner_of = self._own_numbers.corner_of
        return [corner_group(group, corner_of) for group in super().groups]

    @property
    def group_walls(self) -> list[Ints]:
        """Numbers of the walls that each group connects, in the order of mapping."""
        wall = self._own_numbers.wall_of[self._planes.wall_end // 2]
        return [np.unique(wall[group.landmarks // 2]) for group in super().groups]

    @property
    def refined(self) -> list[Refined]:
        """The submaps as refined, in order; none before refinement and after a later update.

        They include the residuals of each eight iterations and of each joined corner, and the
        covariances of the corners, which are the landmarks.
        """
        submaps = [] if self._refined_walls is None else self._refined_walls[0]
        history = self.history
        return [refined_walls(s.assembled, history) for s in submaps if s.refined and s.assembled]

    @property
    def trajectory(self) -> Floats:
        """``T_map_robot`` of every iteration (k, 4, 4), for display; NaN outside the map."""
        history, submaps = self.history, self.submaps
        if not submaps:
            return np.full((history.n_iterations, 4, 4), np.nan)
        return among_all(submaps[0].poses, submaps[0].span, history)

    @property
    def paths(self) -> list[tuple[Ints, Floats]]:
        """Of each of the `submaps`: the iterations (p,) in it, and their poses (p, 4, 4)."""
        own = self.submaps
        return [(each.first_iteration + each.known, each.poses[each.known]) for each in own]

    @property
    def weak_links(self) -> Ints:
        """Iterations (k,) whose motion since the previous one is not fully determined.

        By the beams of a laser: they do not exclude a motion 0.3 m off, or it is the usual one
        instead of one a period of the walls off. With odometry, or without
        beams, by the walls: the scans share neither two crossing walls nor a corner.
        """
        state = self._state
        if self._weak is None or self._weak[0] is not state:
            self._weak = state, undetermined_steps(state[0], self.history, self._planes.links)
        return self._weak[1].copy()

    @property
    def weak_directions(self) -> Floats:
        """Directions (k, 2), robot frame, that the walls determine least in each of `weak_links`.

        Unit vectors; along a corridor without doors that of the corridor.
        """
        return free_directions(self.history)[self.weak_links, 1:]

    @property
    def begun(self) -> Ints:
        """First iterations (r,) of the logs that were added to the map, see `take_up`."""
        return self._planes.links.begun.copy()

    @property
    def odometry(self) -> OdometryUse | None:
        """How odometry was used so far; None if there was none.

        `hanging` are the iterations whose motion since the previous one walls do not fully
        determine; `left_out` contains all iterations if odometry is wrong too often.
        """
        links, history = self._planes.links, self.history
        left_out, hanging = odometry_left_out(links, history), on_odometry(links, history)
        return links.wheels.use(links.motions, links.measured, left_out, hanging)

    @property
    def _state(self) -> tuple[list[WallSubmap], WallNumbers]:
        """The current map and its association; that of the groups is kept until the next change."""
        self._guard.check()
        if self._refined_walls is not None:
            return self._refined_walls
        latest = self._guard.latest
        if self._chained is not None and self._chained[0] is latest:
            return self._chained[1]
        grouped = self._grouped
        numbers = grouped.numbers
        state = grouped.submaps(grouped.at_rest(numbers), self._moving), numbers
        if not self._guard.is_changing:
            self._chained = latest, state
        return state

    @property
    def _own_numbers(self) -> WallNumbers:
        """The association of the current map."""
        self._guard.check()
        return self._refined_walls[1] if self._refined_walls else self._grouped.numbers

    @property
    def _covariances(self) -> Floats | None:
        """Covariances (c, 2, 2) of the first submap's corners, if refined; computed on access."""
        first = next(iter(self._refined_walls[0]), None) if self._refined_walls else None
        if first is None or first.assembled is None or not first.refined:
            return None
        if self._spread is None or self._spread[0] is not first.assembled:
            self._spread = first.assembled, corner_covariances(first.assembled)
        return self._spread[1]

    @property
    def _grouped(self) -> GroupedMap:
        return GroupedMap(self.engine, self._planes, self.history, frame=self._frame)

    @property
    def _moving(self) -> Bools:
        """Whether plane tracks (p,) move, or are not where the refined map has them."""
        moving = self._grouped.moving_walls
        moving[self._moved] = True
        return moving
