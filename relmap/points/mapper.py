"""The point variant of the mapper (section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relmap.core import afterwards, repairing
from relmap.core.arrays import Floats, Ints
from relmap.core.association.placement import Placement
from relmap.core.association.reobservation.recognition import PlaceFinder
from relmap.core.errors import RelmapError
from relmap.core.geometry.motions import transforms
from relmap.core.guard import reads_whole
from relmap.core.linalg.threads import one_thread
from relmap.core.odometry import checked_odometry
from relmap.core.readout import mapped_positions
from relmap.core.scan import checked_covariances, checked_ids, checked_points
from relmap.io.journal import RecordedScan
from relmap.mapper import Mapper, Place
from relmap.points.model import PointModel

TRIED = 1000
"""Number of scans of a log that may be tried until one is found in the map."""
AROUND = 1.2
"""Expected distance of landmarks from the robot, in units of the scan's extent."""


@reads_whole("update", "finish", "refine", "take_up")
class PointMapper(Mapper):
    """Maps point landmarks, with six degrees of freedom in space or three in the plane.

    Parameters
    ----------
    config : MapperConfig, optional
    journal : path, optional
        A new file that records every scan, so that `resume` can continue from it.
    run : dict, optional
        Description of the run to store in the journal.

    Examples
    --------
    >>> import numpy as np
    >>> from relmap import PointMapper
    >>> corners = np.array([[2.0, 0.0], [0.0, 2.0], [3.0, 3.0]])
    >>> mapper = PointMapper()
    >>> for x in np.linspace(0.0, 0.5, 11):
    ...     labels = mapper.update(corners - [x, 0.0])
    >>> mapper.finish()
    >>> mapper.map.positions.round(6).tolist()
    [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [3.0, 3.0, 0.0]]
    """

    _variant = "points"
    _finder: tuple[object, PlaceFinder] | None = None

    def update(
        self,
        points: ArrayLike,
        ids: ArrayLike | None = None,
        covariances: ArrayLike | None = None,
        odometry: ArrayLike | None = None,
        stamp_s: float | None = None,
    ) -> Ints:
        """Process the observations of one iteration.

        Parameters
        ----------
        points : (n, 2) or (n, 3) array, robot frame, metres
            Two columns make a planar world.
        ids : (n,) array of int, optional
            Known association; negative for unidentified landmarks. Give ids with every scan or with
            none.
        covariances : (n, d, d) array, robot frame, square metres, optional
            Noise of each point; see `range_bearing_covariances` for sensors that measure range and
            bearing. `refine` weights the observations by it. Give covariances with every non-empty
            scan or with none.
        odometry : (3,), (7,) or (4, 4) array, optional
            Motion of the robot since the last update, see `relmap.core.odometry.checked_odometry`;
            that of the first update is not used.
        stamp_s : float, optional
            Time of the scan, seconds, later than that of earlier scans; kept for the trajectory.

        Returns
        -------
        (n,) int64
            Label of the landmark of each observation; -1 if unidentified. A landmark that is
            recognised later changes its label: see `landmarks_of`.

        Raises
        ------
        RelmapError
            If the scan is invalid; the mapper is then unchanged.
        """
        with self._guard.change():
            points_robot = checked_points(points, self._engine.store.dimension)
            known = None if ids is None else checked_ids(ids, len(points_robot))
            noise = None if covariances is None else checked_covariances(covariances, points_robot)
            motion = None if odometry is None else checked_odometry(odometry)
            time_s = None if stamp_s is None else self._stamps.checked(stamp_s)
            return self._take_in(points_robot, known, noise, motion, time_s)

    def _take_in(
        self,
        points_robot: Floats,
        known: Ints | None,
        noise: Floats | None,
        motion: Floats | None,
        stamp_s: float | None,
    ) -> Ints:
        if len(points_robot) and self._has_covariances not in (None, noise is not None):
            given = "came with" if noise is None else "did not come with"
            raise RelmapError(
                f"covariances {given} earlier scans; give them with every scan or none"
            )
        if self._journal is not None:
            self._journal.ready()
        engine = self._engine
        labels = engine.update(points_robot, known, noise, motion)
        self._stamps.append(stamp_s, engine.store.n_iterations - 1)
        labels = engine.association.current.labels_of(engine.table.now(labels))
        if self._journal is not None:
            self._journal.append(
                RecordedScan(points_robot, known, labels, noise, odometry=motion, stamp_s=stamp_s)
            )
        return labels

    @property
    def _has_covariances(self) -> bool | None:
        """Whether covariances are given with observations; None before the first one."""
        engine = self._engine
        given = len(engine.kept.covariance) > 0
        given = given and not engine.association.current.estimates_covariances
        return given if len(engine.table) else None

    @property
    def rejected_observations(self) -> Ints:
        """Iteration and row of each observation (r, 2) whose id was overruled.

        It lies far from the landmark of that id, so it was assigned to no landmark or to the one
        expected there, as its label shows. Observations of `rejected` iterations are not listed.
        """
        return self.engine.association.overruled

    def refine(self) -> None:
        """Move all landmarks to the joint least-squares solution over all observations.

        The chain of groups drifts; this distributes the drift over the whole map, in particular
        after a loop closure. Without ids, landmarks that then coincide with compatible older ones
        are merged (see `landmarks_of`). Covariances of the positions are available until the next
        update. With `keep_observations`, bounded noise is exploited.
        """
        with self._guard.change(), one_thread():
            self._note_call("refine")
            repairing.refine(self.engine)

    def finish(self) -> None:
        """Finish the map: map the rest, distribute the drift, and without ids join submaps.

        Submaps that show the same place are joined. Landmarks that turn out to be the same are
        merged: see `landmarks_of`.
        """
        super().finish()

    def _finish(self) -> None:
        super()._finish()
        engine, before = self.engine, afterwards.extent(self.engine)
        if self.config.refine_live and not engine.refined:
            engine.live.complete()
            engine.merger.look_again()
        afterwards.complete(engine)
        is_live = self.config.refine_live and not engine.refined
        if is_live and afterwards.extent(engine) != before:  # Loops that are closed now.
            engine.live.complete()

    def localise(self, points: ArrayLike) -> Floats:
        """Localise a scan in the map, without changing the mapper.

        Parameters
        ----------
        points : (n, 2) or (n, 3) array, robot frame, metres

        Returns
        -------
        (4, 4) float64
            ``T_map_robot``; NaN if less than half of the scan or fewer than 7 landmarks (5 in the
            plane) are in the map, if chance would explain as many, or if the place is ambiguous.

        Raises
        ------
        RelmapError
            If the scan is invalid.
        """
        return self.locate(points).T_map_robot

    def locate(self, points: ArrayLike) -> Place:
        """Localise a scan, and return also the number of places in which it fits.

        Parameters
        ----------
        points : (n, 2) or (n, 3) array, robot frame, metres

        Returns
        -------
        Place
            The pose ``T_map_robot`` (4, 4), NaN if the scan is not found or is ambiguous, and the
            number of places.

        Raises
        ------
        RelmapError
            If the scan is invalid.
        """
        placement, n_places = self._placed(checked_points(points, self.engine.store.dimension), 1)
        if placement is None:
            return Place(np.full((4, 4), np.nan), n_places)
        return Place(transforms(placement.R, placement.t), n_places)

    def take_up(self, points: ArrayLike) -> bool:
        """Localise a scan in the map so that the next update, of this scan, continues there.

        Use it to add a log to a map whose last scan was taken elsewhere. The map stays the first of
        the `submaps`, even if a longer log is not connected to it. With known association no scan
        is localised: the ids connect the log.

        Parameters
        ----------
        points : (n, 2) or (n, 3) array, robot frame, metres

        Returns
        -------
        bool
            Whether the scan was found in the map.

        Raises
        ------
        RelmapError
            If the scan is invalid, or a journal is kept, which could not record it.
        """
        if self._journal is not None:
            raise RelmapError("a run that keeps a journal begins with an empty map")
        seen = checked_points(points, self.engine.store.dimension)
        if not self.engine.map.kept_until:
            with self._guard.change():
                self.engine.map.kept_until = self.engine.store.n_iterations
                self.engine.map.kept_anchor = self._anchor()
        association = self.engine.association
        with self._guard.change():
            association.current.begin_log()
        placement = None if association.has_ids else self._placed(seen, TRIED)[0]
        if placement is None:
            return False
        positions = mapped_positions(self.engine)
        landmarks = np.flatnonzero(np.isfinite(positions[:, 0]))
        around = (positions[landmarks] - placement.t) @ placement.R
        near = np.linalg.norm(around, axis=1) <= AROUND * np.linalg.norm(seen, axis=1).max()
        with self._guard.change():
            association.current.expect(landmarks[near], around[near])
        return True

    def _anchor(self) -> int:
        """Return the iteration whose pose defines the frame of the map."""
        if self.refined:
            return self.refined[0].anchor_iteration
        own = self.engine.table.first[self.engine.map.ranks == 0]
        return int(own.min()) if len(own) else 0

    def _placed(self, points_robot: Floats, searches: int) -> tuple[Placement | None, int]:
        """Return the placement of a scan in the map, if certain, and the number of placements.

        `searches`: number of scans tried of which none may be found by chance.
        """
        known, latest = self._finder, self._guard.latest
        if known is None or known[0] is not latest:
            positions = mapped_positions(self.engine)
            mapped = positions[np.isfinite(positions).all(axis=1)]
            known = self._finder = latest, PlaceFinder(mapped, np.nan_to_num(self.noise_m))
        finder = known[1]
        places = finder.places(points_robot)
        if places and finder.is_certain(points_robot, places, searches):
            return places[0], 1
        return None, 2 if len(places) > 1 else 0

    def _model(self) -> PointModel:
        return PointModel()

    def _again(self, scan: RecordedScan) -> Ints:
        return self.update(scan.values, scan.ids, scan.covariances, scan.odometry, scan.stamp_s)
