"""Adding another log to a map of walls.

A place that is not in the map may look like one that is, so of another log one scan is not enough.
All scans of a submap must fit together: their placements in the map, and the motions between them,
agree along a stretch of the path, and no other placement of the submap is supported nearly as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.placement import STILL, PlaneTracks, settled
from relmap.planes.linking.scan_links import ScanLinks
from relmap.planes.motions import from_matrices, matrices, wrapped
from relmap.planes.places.finding import WallFinder
from relmap.planes.scans.corners import CORNER, CUT
from relmap.planes.scans.observation import SHORTEST_M, PlaneObservation, seen_before
from relmap.planes.submaps.submap import WallSubmap
from relmap.planes.walls.table import PlaneTable

AROUND = 1.2
"""Maximum distance of expected walls, in units of the reach of the scan."""
APART_M = 0.5
"""Distance between the scans that are localised."""
NEAR_M, NEAR_RAD = 0.3, np.deg2rad(4.0)
"""Two placements of a submap agree within this distance and angle, ..."""
DRIFT, DRIFT_RAD = 0.03, np.deg2rad(0.3)
"""... plus this per metre of the path between the scans."""
STRETCH_M, AGREE = 7.0, 0.5
"""Length of the path along which this fraction of the scans must agree: over less, a laser sees
the same surfaces all the time."""
RIVAL = 0.5
"""Maximum number of scans that agree on another placement, as a fraction of the best."""


@dataclass(frozen=True, eq=False)
class MapOfBefore:
    """The map in which the scans of another log are localised: its mapped walls.

    `plane` (w,): numbers of the walls; `ends` (w, 2, 2), map frame, metres; `corner` (w, 2);
    `z_extent` (w, 2), metres: as in `PlaneTable`. `scan`: the last scan of the map; -1 if there is
    none. `pose` (4, 4): ``T_map_robot`` of that scan.
    """

    plane: Ints
    ends: Floats
    corner: Ints
    z_extent: Floats
    scan: int
    pose: Floats

    @classmethod
    def of(cls, table: PlaneTable, submaps: list[WallSubmap]) -> MapOfBefore:
        """Return the map of the first submap; without submaps, an empty one."""
        rows = np.flatnonzero(table.status == "static")
        walls = table.plane[rows], table.ends[rows], table.corner[rows], table.z_extent[rows]
        if not submaps:
            return cls(*walls, -1, np.eye(4))
        own = submaps[0]
        known = int(own.known[-1])
        return cls(*walls, own.first_iteration + known, own.poses[known])

    @cached_property
    def finder(self) -> WallFinder:
        """Finds scans among the walls."""
        return WallFinder(self.ends)

    def carried_on(self, motions: Floats) -> Floats:
        """Return the pose (4, 4) of the last scan, by the motions (i, 3) to each scan."""
        pose = self.pose
        for step in matrices(motions[self.scan + 1 :]):
            pose = pose @ np.linalg.inv(step)
        return np.asarray(pose)

    def expected(self, T_map_robot: Floats, reach_m: float) -> PlaneTracks:
        """Return the walls expected in a scan at a pose, in the robot frame."""
        ends = (self.ends - T_map_robot[:2, 3]) @ T_map_robot[:2, :2]
        way = ends[:, 1] - ends[:, 0]
        size = np.hypot(*way.T)
        along = way / np.maximum(size, SHORTEST_M)[:, None]
        nearest_m = np.clip(-(ends[:, 0] * along).sum(axis=1), 0.0, size)
        near = np.linalg.norm(ends[:, 0] + nearest_m[:, None] * along, axis=1) <= AROUND * reach_m
        front = way[:, 1] * ends[:, 0, 0] - way[:, 0] * ends[:, 0, 1] > 0
        chosen = front & near & (size > SHORTEST_M)
        kind = np.where(self.corner[chosen] >= 0, CORNER, CUT).astype(np.int8)
        sd = np.zeros(np.count_nonzero(chosen))
        walls = PlaneObservation.of(ends[chosen], kind, sd, self.z_extent[chosen])
        return PlaneTracks.of_scan(self.plane[chosen], walls)


@dataclass(frozen=True, eq=False)
class Placements:
    """Where the scans of one submap fit in a map.

    `scan` (n,), ascending; `T_run_robot` (n, 4, 4): poses of the scans in the frame of the run;
    `of` (c,), ascending: index of the scan of each placement; `T_map_robot` (c, 4, 4).
    """

    scan: Ints
    T_run_robot: Floats
    of: Ints
    T_map_robot: Floats

    def accepted(self) -> tuple[int, Floats] | None:
        """Return one of the scans and its pose (4, 4), if all agree; see the module."""
        if not len(self.of):
            return None
        agreeing = [self._agreeing(k) for k in range(len(self.of))]
        counts = np.array([self._scans(same).sum() for same in agreeing])
        best = int(np.argmax(counts))
        rival = counts[~agreeing[best]].max(initial=0)
        if rival > RIVAL * counts[best] or not self._is_long(self._scans(agreeing[best])):
            return None
        return int(self.scan[self.of[best]]), self.T_map_robot[best]

    def _is_long(self, agree: Bools) -> bool:
        """Return whether scans (n,) agree along a whole stretch of the path."""
        way_m, count = self._way_m, np.cumsum(agree)
        rows = np.flatnonzero(agree)
        ends = np.searchsorted(way_m[rows], way_m[rows] + STRETCH_M)
        begin, end = rows[ends < len(rows)], rows[ends[ends < len(rows)]]
        share = (count[end] - count[begin] + 1) / (end - begin + 1)
        return bool((share >= AGREE).any())

    def _agreeing(self, k: int) -> Bools:
        """Return which placements (c,) agree with one of them, by the motions between the scans."""
        begun = self.T_map_robot[k] @ np.linalg.inv(self.T_run_robot[self.of[k]])
        expected = begun @ self.T_run_robot[self.of]
        way_m = np.abs(self._way_m[self.of] - self._way_m[self.of[k]])
        turn, x, y = (from_matrices(expected) - from_matrices(self.T_map_robot)).T
        off_m, turned = np.hypot(x, y), np.abs(wrapped(turn))
        near = (off_m <= NEAR_M + DRIFT * way_m) & (turned <= NEAR_RAD + DRIFT_RAD * way_m)
        return np.asarray(near)

    @property
    def _way_m(self) -> Floats:
        """Length of the path to each scan, metres."""
        steps = np.diff(self.T_run_robot[:, :2, 3], axis=0)
        return np.append(0.0, np.cumsum(np.hypot(*steps.T)))

    def _scans(self, placements: Bools) -> Bools:
        """Return the scans (n,) with a placement among some."""
        found = np.zeros(len(self.scan), dtype=np.bool_)
        found[self.of[placements]] = True
        return found


@dataclass(eq=False)
class RunOnto:
    """The scans of a log that is added to a map, and where each fits in it.

    `last` (4, 4): pose of the last scan in the frame of the run; of the scans that were localised
    the numbers `scan` (n,), `poses` (n, 4, 4) in that frame, and `places`, (k, 4, 4) of each, in
    the map.
    """

    before: MapOfBefore
    last: Floats = field(default_factory=lambda: np.eye(4))
    scan: list[int] = field(default_factory=list)
    poses: list[Floats] = field(default_factory=list)
    places: list[Floats] = field(default_factory=list)

    def see(self, seen: PlaneObservation, links: ScanLinks) -> None:
        """Localise the last scan, if the robot has moved since the last one that was."""
        self.last = self.last @ np.linalg.inv(matrices(links.motions[-1:])[0])
        scan = len(links) - 1
        if links.submaps[scan] < 0:
            return
        same = self.scan and links.submaps[self.scan[-1]] == links.submaps[scan]
        if same and np.hypot(*(self.last - self.poses[-1])[:2, 3]) < APART_M:
            return
        self.scan.append(scan)
        self.poses.append(self.last)
        self.places.append(self.before.finder.places(seen))

    def ties(self, links: ScanLinks) -> list[tuple[int, Floats, Ints]]:
        """Return the placements of the submaps of the log whose place in the map is certain.

        Of each its first scan; ``T_map_robot`` (4, 4) of that; and the numbers (k, 2) of the same
        wall: in the map, and in the log.
        """
        scan = np.array(self.scan, dtype=np.int64)
        submap, found = links.submaps[scan], []
        for own in np.unique(submap).tolist():
            rows = np.flatnonzero(submap == own)
            places = [self.places[k] for k in rows.tolist()]
            of = np.repeat(np.arange(len(rows)), [len(each) for each in places])
            poses = np.array([self.poses[k] for k in rows.tolist()])
            place = Placements(scan[rows], poses, of, np.concatenate(places)).accepted()
            if place is None:
                continue
            at, T_map_robot = place
            first = int(np.flatnonzero(links.submaps == own)[0])
            T_map_first = T_map_robot
            for step in matrices(links.motions[first + 1 : at + 1])[::-1]:
                T_map_first = T_map_first @ step
            found.append((first, T_map_first, self._same(at, T_map_robot, links)))
        return found

    def _same(self, scan: int, T_map_robot: Floats, links: ScanLinks) -> Ints:
        """Return the numbers (k, 2) of walls of the map, and of those that a scan shows there."""
        seen = seen_before(links.store, scan)
        walls = links.store.column("wall")[links.store.rows(scan)]
        beams = links.beams.of(scan, seen.ends).points
        reach_m = float(np.linalg.norm(beams, axis=1).max())
        tracks = self.before.expected(T_map_robot, reach_m)
        match = settled(tracks, seen, [STILL])[1][0]
        return np.column_stack([tracks.plane[match.tracks], walls[match.walls]])
