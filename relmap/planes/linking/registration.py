"""Registration of walls, and the landmarks of the map: corners and estimated midpoints.

The visible ends of a wall move as it enters and leaves the view; its static corners do not, and
neither does a point at a fixed distance from one: the midpoint, estimated at half the size of the
wall from the corner along the wall (Fig. 4). The size is the one observed with the first
observation of the corner. Corner and midpoint are two static points, which also determine the
normal of the wall: the points of one corner determine the pose of a group in the plane, and the
rest of the algorithm is the same as for points.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association import Registration
from relmap.core.state.growing import GrowingArray
from relmap.core.state.store import ObservationStore
from relmap.planes.linking.judging import NO_MATCH
from relmap.planes.linking.link_record import values_of
from relmap.planes.linking.placement import MEMORY, NO_CORNER, PlaneTracks
from relmap.planes.linking.scan_links import ScanLinks
from relmap.planes.scans.corners import CORNER, INTERVAL, LOOSE, UNKNOWN, compared_ends
from relmap.planes.scans.observation import PlaneObservation

STRAYED_M = 0.15
SIGMAS = 5.0
"""Largest distance of a corner from its prediction, along its wall: metres, and in standard
deviations of corners."""
MOST = 14
"""Number of corners of a scan used by the map: more would not improve it."""
LONG_M = 4.0
"""Walls longer than this are equally good."""
UNTYPED, STATIC, MOVING = 0, 1, -1
"""Classification of an end over time."""
TESTED = 4
"""Interval, in iterations, of the tests of ends with unknown type."""
FAMILIAR = 8
"""Number of observations of a corner that doubles its rank: the selection should be stable."""


class PlaneRegistration(Registration):
    """Matches walls to those of earlier iterations, and numbers their corners.

    Corner ``k`` is landmark ``2 k``, and the midpoint estimated from it landmark ``2 k + 1``; the
    map uses few of those of a scan.

    `max_missed`: a wall missed for more iterations than this has left the view. `bridge_m`, metres:
    largest error of an unmeasured motion along walls; beyond it a submap ends.

    Attributes: `links`: links between scans. `corner`, `landmark` (w, 2): corner at either end of
    each wall of the last scan, and the landmark used by the map there; -1 for none. Of each corner
    (c,): `half`, metres: half the size of its wall at the first observation; `wall_end`: twice the
    number of the wall, plus 1 for the left end. `now_of` (n,): the first numbers are those of walls
    before all scans were mapped again, and this is what they are now.
    """

    half: Floats = values_of("_half")
    wall_end: Ints = values_of("_wall_end")
    _tracks: PlaneTracks | None
    STATE = "_tracks n_planes now_of _half _wall_end _begun_at _type _since links"

    def __init__(self, max_missed: int, bridge_m: float) -> None:
        self._max_missed = max_missed
        self._tracks = None
        self.links = ScanLinks(bridge_m)
        self._half: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._wall_end: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._begun_at: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._type: GrowingArray[np.int8] = GrowingArray(np.int8, (2,))
        self._since: GrowingArray[np.int64] = GrowingArray(np.int64)
        self.n_planes, self.now_of = 0, np.empty(0, dtype=np.int64)
        self.corner = np.empty((0, 2), dtype=np.int64)
        self.landmark = np.empty((0, 2), dtype=np.int64)

    def submap_of(self, corners: Ints) -> Ints:
        """Return the submap of corners (k,): that of the scan which showed each first."""
        return np.asarray(self.links.submaps[self._begun_at.values[corners]])

    def match(self, seen: PlaneObservation, ids: Ints | None = None) -> Ints:
        """Return the number of each wall (m,) of one scan.

        If no link to earlier scans is accepted, a submap begins.
        """
        walls, goes_on = np.full(len(seen), -1), self.links.goes_on
        tracks, found = self._tracks, None
        if tracks is not None and len(seen):
            found = self.links.into(tracks, seen)
            goes_on = goes_on and found is not None
        motion = found.motion if found else self.links.usual  # constant motion
        if tracks is not None and len(seen) and not found:
            tracks = None
        elif tracks is not None:
            tracks, match = tracks.carried(motion), found.match if found else NO_MATCH
            tracks.see(match.tracks, seen, match.walls)
            walls[match.walls] = tracks.plane[match.tracks]
        if tracks is None and len(seen) and not goes_on:
            self.links.begin_submap()
        new, n_new = walls < 0, int(np.count_nonzero(walls < 0))
        walls[new] = self.n_planes + np.arange(n_new)
        self.n_planes += n_new
        self._type.resize(self.n_planes, UNTYPED)
        self._since.resize(self.n_planes, len(self.links))
        self._test_ends()
        if tracks is None or n_new:
            begun = PlaneTracks.begun(walls[new], seen.only(new))
            tracks = begun if tracks is None else tracks.joined(begun)
        tracks = tracks.kept(tracks.missed <= self._max_missed)
        self._tracks = tracks if len(tracks) else None
        self._see_corners(tracks, seen, walls)
        is_tied = goes_on or self._tracks is not None
        self.links.append(seen, motion, is_tied, found, goes_on)
        return walls

    def follow(self, old: PlaneRegistration, store: ObservationStore) -> None:
        """Record what the numbers of another registration, with its store, of the same scans are.

        A number that was of several walls is that of most of its observations.
        """
        both = np.column_stack([store.column("wall"), self.links.store.column("wall")])
        both, counts = np.unique(both, axis=0, return_counts=True)
        was, now = both[np.argsort(counts, kind="stable")].T
        self.now_of = np.arange(old.n_planes)
        self.now_of[was] = now
        self.now_of = self.now_of[old.now(np.arange(old.n_planes))]

    def now(self, walls: Ints) -> Ints:
        """Return the present numbers of walls (k,)."""
        now = np.arange(self.n_planes)
        now[: len(self.now_of)] = self.now_of
        return np.asarray(now[walls])

    def begin_run(self) -> None:
        """Begin another run with the next scan, which is not tied to the last one."""
        self._tracks = None
        self.links.begin_run()

    def _see_corners(self, tracks: PlaneTracks, seen: PlaneObservation, walls: Ints) -> None:
        """Assign a corner to every static end; create new ones where none is expected."""
        row_of = {plane: row for row, plane in enumerate(tracks.plane.tolist())}
        types = self._type.values[walls]
        untyped = seen.kind % LOOSE == UNKNOWN
        wall, end = np.where(untyped, types == STATIC, seen.static).nonzero()
        row = np.array([row_of[plane] for plane in walls[wall].tolist()], dtype=np.int64)
        at, before = seen.ends[wall, end], tracks.corner_at[row, end]
        off = (at - before) * seen.along[wall]
        # The standard deviation of an end along its wall is about three times that across it.
        fresh = ~(np.abs(off[:, 0] + off[:, 1]) <= STRAYED_M + SIGMAS * (3 * seen.sd[wall]))
        corners = tracks.corner[row, end]
        strayed = untyped[wall, end] & fresh & (corners >= 0)
        if strayed.any():  # the static corners are out of view: a new interval begins
            tracks.corner[row[strayed], end[strayed]] = NO_CORNER
            self._type.values[walls[wall[strayed]], end[strayed]] = UNTYPED
            self._since.values[walls[wall[strayed]]] = len(self.links)
            columns = (wall, end, row, at, before, fresh, corners)
            wall, end, row, at, before, fresh, corners = (v[~strayed] for v in columns)
        new = fresh.nonzero()[0]
        corners[new] = self._begun(2 * walls[wall[new]] + end[new], seen.size[wall[new]])
        before[new] = at[new]
        times = np.where(fresh, 1, tracks.corner_seen[row, end] + 1)
        share = (1 / np.minimum(times, MEMORY))[:, None]
        tracks.corner_at[row, end] = before + share * (at - before)
        tracks.corner_seen[row, end] = times
        tracks.corner[row, end] = corners
        for k in (fresh & untyped[wall, end]).nonzero()[0].tolist():
            self._name(walls[wall[k]], end[k], corners[k])
        self.corner, self.landmark = np.full((2, len(seen), 2), NO_CORNER)
        self.corner[wall, end] = corners
        best = _best(seen.size[wall], times)
        self.landmark[wall[best], end[best]] = 2 * corners[best]

    def _begun(self, wall_end: Ints, size_m: Floats) -> Ints:
        """Return the numbers of new corners (k,), given their wall ends and the wall sizes."""
        n = len(self._half)
        if len(wall_end):
            self._half.extend(size_m / 2)
            self._begun_at.extend(np.full(len(wall_end), len(self.links)))
            self._wall_end.extend(wall_end)
        return np.arange(n, len(self._half))

    def _test_ends(self) -> None:
        """Determine from the last iterations which ends are static, if no types are given (Fig. 4).

        Ends of unknown type are tested at intervals.
        """
        now = len(self.links)
        if now < INTERVAL or now % TESTED:
            return
        store = self.links.store
        rows, iteration = store.between(now - INTERVAL, now)
        wall, kind = store.column("wall")[rows], store.column("kind")[rows] % LOOSE
        ends, sd = store.column("location")[rows], store.column("sd")[rows]
        same, unknown = self._since.values[wall] <= now - INTERVAL, kind == UNKNOWN
        if not (same & unknown.any(axis=1)).any():
            return
        types = self._type.values
        untyped = np.zeros(types.shape, dtype=np.bool_)
        np.logical_or.at(untyped, wall, unknown)
        kind = np.where(unknown & (types[wall] == STATIC), CORNER, kind)
        seen = (each[same] for each in (iteration, wall, ends, sd, kind))
        walls, static, moving = compared_ends(*seen)
        moving &= ~static & untyped[walls]
        static &= untyped[walls]
        types[walls] = np.where(static, STATIC, np.where(moving, MOVING, types[walls]))
        for k, end in np.argwhere(moving).tolist():
            self._name(walls[k], end, NO_CORNER)

    def _name(self, wall: int, end: int, corner: int) -> None:
        """Record the corner that an end of a wall was throughout the last interval."""
        now = len(self.links)
        begin = max(int(self._since.values[wall]), now - INTERVAL, 0)
        rows, _ = self.links.store.between(min(begin, now), now)
        own = self.links.store.column("wall")[rows] == wall
        self.links.store.column("corner")[rows][own, end] = corner
        if corner == NO_CORNER:
            self.links.store.column("landmark")[rows][own, end] = corner


def _best(size: Floats, times: Ints) -> Ints:
    """Return which corners (k,) the map uses: of long walls, and seen before."""
    rank = np.minimum(size, LONG_M) * (1 + np.minimum(times / FAMILIAR, 1))
    return np.argsort(-rank, kind="stable")[:MOST]
