"""Localising scans in the map of a plane mapper, and adding another log to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.mapper import Place
from relmap.planes.finding import WallFinder
from relmap.planes.mapped import MappedWalls
from relmap.planes.motions import from_matrices, matrices
from relmap.planes.observation import SHORTEST_M, PlaneObservation, checked_planes
from relmap.planes.placement import STILL, settled
from relmap.planes.submaps import WallSubmap
from relmap.planes.table import PlaneTable
from relmap.planes.tracks import PlaneTracks

AROUND = 1.2
"""Maximum distance of expected walls, in units of the reach of the scan."""


@dataclass(frozen=True, eq=False)
class MapOfBefore:
    """The map in which the scans of another log are localised.

    Attributes
    ----------
    table : PlaneTable
    finder : WallFinder
    scan : int
        The last scan of the map; -1 if there is none.
    pose : (4, 4) float64
        ``T_map_robot`` of that scan.
    """

    table: PlaneTable
    finder: WallFinder
    scan: int
    pose: Floats

    @classmethod
    def of(cls, table: PlaneTable, submaps: list[WallSubmap]) -> MapOfBefore:
        """Return the map of the first submap; without submaps, an empty one."""
        if not submaps:
            return cls(table, WallFinder(np.empty((0, 2, 2))), -1, np.eye(4))
        own = submaps[0]
        known = int(np.flatnonzero(np.isfinite(own.poses[:, 0, 3]))[-1])
        finder = WallFinder(table.ends[table.status == "static"])
        return cls(table, finder, own.first_iteration + known, own.poses[known])

    def carried_on(self, motions: Floats) -> Floats:
        """Return the pose (4, 4) of the last scan, by the motions (i, 3) to each scan."""
        pose = self.pose
        for step in matrices(motions[self.scan + 1 :]):
            pose = pose @ np.linalg.inv(step)
        return np.asarray(pose)

    def expected(self, T_map_robot: Floats, reach_m: float) -> PlaneTracks:
        """Return the walls expected in a scan at a pose, in the robot frame."""
        rows = np.flatnonzero(self.table.status == "static")
        ends = (self.table.ends[rows] - T_map_robot[:2, 3]) @ T_map_robot[:2, :2]
        way = ends[:, 1] - ends[:, 0]
        size = np.hypot(*way.T)
        along = way / np.maximum(size, SHORTEST_M)[:, None]
        nearest_m = np.clip(-(ends[:, 0] * along).sum(axis=1), 0.0, size)
        near = np.linalg.norm(ends[:, 0] + nearest_m[:, None] * along, axis=1) <= AROUND * reach_m
        front = way[:, 1] * ends[:, 0, 0] - way[:, 0] * ends[:, 0, 1] > 0
        chosen = front & near & (size > SHORTEST_M)
        return self._tracks(rows[chosen], ends[chosen])

    def _tracks(self, rows: Ints, ends: Floats) -> PlaneTracks:
        """Return walls, with ends (k, 2, 2) in the robot frame, as tracks."""
        n, corner = len(rows), self.table.corner[rows]
        z_extent = self.table.z_extent[rows]
        walls = PlaneObservation.of(ends, np.zeros((n, 2), np.int8), np.zeros(n), z_extent)
        tracks = PlaneTracks.begun(self.table.plane[rows], walls)
        tracks.corner_at = np.where((corner >= 0)[..., None], ends, np.nan)
        return tracks


class LocatingMapper(MappedWalls):
    """The part of `PlaneMapper` that localises scans."""

    _finder: WallFinder | None = None
    _onto: MapOfBefore | None = None
    _found: Floats | None = None

    def locate(self, points: Any, beams: ArrayLike | None = None) -> Place:
        """Localise a scan using only the map; the mapper does not change.

        Parameters
        ----------
        points, beams
            As for `update`; planes without beams are not localised.

        Returns
        -------
        Place
            The pose ``T_map_robot`` (4, 4), and the number of places in which the scan fits. The
            pose is NaN unless that is one: at least half of its walls, and 3 m, must lie on mapped
            walls that are not all parallel, 70 % of its beams must end there, and no other place
            may score nearly as well.

        Raises
        ------
        RelmapError
            If the scan is invalid.
        """
        if self._finder is None:
            self._finder = MapOfBefore.of(self.planes, self.submaps).finder
        return self._finder.find(self._checked(points, beams))

    def localise(self, points: Any, beams: ArrayLike | None = None) -> Floats:
        """Return the pose ``T_map_robot`` (4, 4) of a scan; NaN if it is ambiguous.

        See `locate`.
        """
        return self.locate(points, beams).T_map_robot

    def take_up(self, points: Any, beams: ArrayLike | None = None) -> bool:
        """Localise the next scan of another log, to continue the map from there.

        The first call begins that log: its first scan is not tied to the last scan of the previous
        log. Until a scan is localised the log has submaps of its own; then the submap of that scan
        becomes part of the map.

        Parameters
        ----------
        points, beams
            The scan of the next `update`, as for that.

        Returns
        -------
        bool
            Whether the scan was localised, see `locate`, in the map at the time of the first call.

        Raises
        ------
        RelmapError
            If the scan is invalid, or a journal is kept, which cannot record this.
        """
        if self._journal is not None:
            raise RelmapError("a run that keeps a journal begins with an empty map")
        seen = self._checked(points, beams)
        if self._onto is None:
            self._onto = MapOfBefore.of(self.planes, self.submaps)
            with self._guard.change():
                self._planes.begin_run()
        place = self._onto.finder.find(seen)
        self._found = place.T_map_robot if place.n_places == 1 else None
        return self._found is not None

    def _attach(self, seen: PlaneObservation, walls: Ints) -> None:
        """Tie the last scan, whose walls have these numbers, to its place in the map."""
        if self._found is None or self._onto is None:
            return
        T_map_robot, onto, links = self._found, self._onto, self._planes.links
        reach_m = float(np.linalg.norm(seen.beams.points, axis=1).max())
        tracks = onto.expected(T_map_robot, reach_m)
        motion, match = settled(tracks, seen, STILL)
        same = np.column_stack([tracks.plane[match.tracks], walls[match.walls]])
        step = matrices(np.array([[motion.yaw, *motion.t]]))[0]
        first = int(np.flatnonzero(links.submaps == links.submaps[-1])[0])
        before = onto.carried_on(links.motions[:first])
        into = from_matrices((step @ np.linalg.inv(T_map_robot) @ before)[None])[0]
        self._planes.attach(into, onto.scan, same)
        self._found = self._onto = None

    def _segmented(self, points: Any) -> Any:
        """Return the planes of a scan."""
        raise NotImplementedError

    def _checked(self, points: Any, beams: Any) -> PlaneObservation:
        """Return the walls of a scan given by walls or points."""
        if not hasattr(points, "ends"):
            beams = points if beams is None else beams
            points = self._segmented(points)
        return checked_planes(points, beams)
