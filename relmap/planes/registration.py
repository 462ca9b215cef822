"""Registration of walls, and what the map is made of: their corners and estimated midpoints.

A wall's ends move as it comes into view and leaves it; its static corners do not, nor does what
is at a fixed place relative to one: the midpoint, estimated by going half the size of the wall
from the corner along the wall (Fig. 4).  The size is that seen when the corner was seen first, and
stays.  Corner and midpoint are two points at rest, which hold the normal of the wall as well: so
the points of one corner fix a group in the plane, and all that follows is what is done with points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.state.growing import GrowingArray
from relmap.core.state.store import ObservationStore
from relmap.planes.beams import Beams, BeamStore
from relmap.planes.corners import CORNER, INTERVAL, UNKNOWN, compared_ends
from relmap.planes.links import (
    STEADY,
    USUAL,
    VARYING,
    believed,
    farthest_m,
    measured_along,
    unsure_m,
)
from relmap.planes.observation import PlaneObservation
from relmap.planes.placement import STILL, PlanarMotion, place
from relmap.planes.search import REACH_M, Found, Search, View, after, others
from relmap.planes.tracks import MEMORY, NO_CORNER, PlaneTracks
from relmap.planes.tying import Scans, tied

STRAYED_M = 0.15
SIGMAS = 5.0
"""How far from where it is expected a corner may be, along its wall: so far, and so many standard
deviations of corners."""
MOST = 14
"""Corners of a scan that the map hangs on: more of them would not make it firmer."""
LONG_M = 4.0
"""Walls longer than this are as good as any."""
UNTOLD, STATIC, MOVING = 0, 1, -1
"""What was found out of an end over time."""
TESTED = 4
"""Ends of unknown type are tested every so many iterations."""
VARYING_M = 0.15
"""Steps that vary by more are not bridged where nothing measures them."""
SURE, USUALLY = 4.0, 0.5
"""Log odds below which another scan must confirm a motion; and as a share of the usual ones."""
TOGETHER = 5.0
"""Log odds that both must have in sum."""
VIEWS = 2
"""Last scans whose beams judge a motion."""
FAMILIAR = 8
"""Sights of a corner, in as many of which its rank doubles: who is chosen should stay it."""


class PlaneRegistration:
    """Matches walls to those of the iterations before, and gives their corners numbers.

    Corner ``k`` is landmark ``2 k``, and the midpoint estimated from it landmark ``2 k + 1``; the
    map hangs on few of those of a scan.

    Parameters
    ----------
    max_missed : int
        A wall unseen for more iterations than this has left the view.
    bridge_m : float, metres
        How far off the way along walls may be where nothing measures it; there a submap ends.

    Attributes
    ----------
    store : ObservationStore
        What was observed so far, for ends of unknown type.
    beams : BeamStore
        The beams of each scan, where they are told.
    same_walls : (k, 2) int64
        Numbers of walls that are one wall each, as submaps were tied.
    corner, landmark : (w, 2) int64
        Corner at either end of each wall of the scan seen last, and the landmark that the map hangs
        on there; -1 for none.
    """

    _tracks: PlaneTracks | None
    _motion: PlanarMotion
    STATE = (
        "_motions _submaps _tracks _motion n_planes _n_submaps _submap _unsure_m "
        "_unsure_each_m _half _wall_end _submap_of _told _since _evidence beams same_walls"
    )

    def __init__(self, max_missed: int, bridge_m: float) -> None:
        self._max_missed, self._bridge_m = max_missed, bridge_m
        self._tracks = None
        self._motion = STILL
        self._n_submaps, self._submap = 0, -1
        self.same_walls = np.empty((0, 2), dtype=np.int64)
        self._unsure_m, self._unsure_each_m = 0.0, 0.0
        self._motions: GrowingArray[np.float64] = GrowingArray(np.float64, (3,))
        self._submaps: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._half: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._wall_end: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._submap_of: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._told: GrowingArray[np.int8] = GrowingArray(np.int8, (2,))
        self._since: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._evidence: GrowingArray[np.float64] = GrowingArray(np.float64)
        self.n_planes = 0
        self.store = ObservationStore()
        self.beams = BeamStore()
        self.corner = np.empty((0, 2), dtype=np.int64)
        self.landmark = np.empty((0, 2), dtype=np.int64)

    @property
    def _usual(self) -> PlanarMotion:
        """How the robot went last: the median of some scans, for one of them may be a jump."""
        if not len(self._motions):
            return STILL
        last = np.sort(self.motions[-STEADY:], axis=0)
        yaw, x, y = last[len(last) // 2].tolist()
        return PlanarMotion(yaw, np.array([x, y]))

    @property
    def motions(self) -> NDArray[np.float64]:
        """From the robot frame before into that of each iteration: yaw, x, y; (i, 3), rough."""
        return self._motions.values

    @property
    def submaps(self) -> NDArray[np.int64]:
        """Submap of each iteration; (i,), -1 where nothing ties it to any."""
        return self._submaps.values

    @property
    def half(self) -> NDArray[np.float64]:
        """Half of the size of its wall, as when each corner was seen first; metres."""
        return self._half.values

    @property
    def wall_end(self) -> NDArray[np.int64]:
        """Wall end of each corner: twice the number of the wall, and 1 more for its left end."""
        return self._wall_end.values

    @property
    def submap_of(self) -> NDArray[np.int64]:
        """Submap of each corner."""
        return self._submap_of.values

    def labels_of(self, landmarks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return landmarks (n,) as they are: they go by their number."""
        return landmarks

    def expect(self, landmarks: NDArray[np.int64], points_robot: NDArray[np.float64]) -> None:
        """Do nothing: walls are expected by their lines."""

    @property
    def rejected(self) -> list[int]:
        """None: walls are judged one by one."""
        return []

    def match(
        self, seen: PlaneObservation, ids: NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Return the number of each wall (m,) of one scan.

        Where no link to those before is believed, a submap begins.
        """
        walls = np.full(len(seen), -1)
        self._motion, tracks = self._usual, self._tracks  # on as before
        if tracks is not None and len(seen):
            tracks = self._followed(tracks, seen, walls)
        elif tracks is not None:
            tracks = tracks.carried(self._motion.yaw, self._motion.t)
            tracks.missed += 1
        if tracks is None and len(seen):
            self._submap = self._n_submaps
            self._n_submaps += 1
        new = walls < 0
        walls[new] = self.n_planes + np.arange(new.sum())
        self.n_planes += int(new.sum())
        self._told.resize(self.n_planes, UNTOLD)
        self._since.resize(self.n_planes, len(self._motions))
        self._test_ends()
        begun = PlaneTracks.begun(walls[new], seen.only(new))
        tracks = begun if tracks is None else tracks.joined(begun)
        tracks = tracks.kept(tracks.missed <= self._max_missed)
        self._tracks = tracks if len(tracks) else None
        self._see_corners(tracks, seen, walls)
        self.beams.append(seen.beams)
        self._motions.extend(np.array([[self._motion.yaw, *self._motion.t]]))
        self._submaps.extend(np.array([-1 if self._tracks is None else self._submap]))
        return walls

    def _followed(
        self, tracks: PlaneTracks, seen: PlaneObservation, walls: NDArray[np.int64]
    ) -> PlaneTracks | None:
        """Return the tracks where a scan sees them, and enter which walls (m,) they are.

        None where it is tied to them by too little.
        """
        found = self._placed(tracks, seen)
        if found is None:
            return None
        motion, match = found.motion, found.match
        self._evidence.extend(np.array([found.evidence]))
        if found.measured:
            self._unsure_m = 0.0
        else:
            if not self._unsure_m:
                self._unsure_each_m = unsure_m(self._believed)
            self._unsure_m += self._unsure_each_m
        if self._unsure_m > self._bridge_m or (self._unsure_m and self._unsure_each_m > VARYING_M):
            self._unsure_m = 0.0
            return None
        self._motion = motion
        tracks = tracks.carried(motion.yaw, motion.t)
        tracks.see(match.tracks, seen, match.walls)
        walls[match.walls] = tracks.plane[match.tracks]
        return tracks

    def _placed(self, tracks: PlaneTracks, seen: PlaneObservation) -> Found | None:
        """Return the motion into a scan that is believed, and who is who by it."""
        told, reach_m = seen.beams, farthest_m(self._believed)
        views = self._views() if told.in_order and len(told.points) else []
        if views:
            beams = Beams.of(told.points, told.origin, seen.ends)
            judged = Search(tracks, seen, beams, views, self._usual).found(REACH_M)
            return judged if judged and self._confirmed(judged, seen, beams, views) else None
        found = place(tracks, seen, self._usual, reach_m)
        if found is None or not believed(tracks, seen, found, self._usual):
            return None
        return Found(*found, measured_along(tracks, seen, found[1]), np.inf)

    def _confirmed(
        self, found: Found, seen: PlaneObservation, beams: Beams, views: list[View]
    ) -> bool:
        """Tell whether the scan before the last one confirms a motion, where that is in doubt."""
        usual = np.median(np.append(self._evidence.values[-VARYING:], SURE))
        if found.evidence > max(SURE, USUALLY * usual) or len(views) < 2:
            return True
        now, motion = len(self._motions), np.array([found.motion.yaw, *found.motion.t])
        expected = after(views[1].motion, motion[None])[0]
        rows, _ = self.store.between(now - 2, now - 1)
        earlier = seen_before(self.store, rows)
        tracks = PlaneTracks.begun(self.store.column("wall")[rows], earlier)
        tracks.corner_at = np.where(earlier.static[..., None], earlier.ends, np.nan)
        before = PlanarMotion(float(expected[0]), expected[1:])
        view = [View(views[1].beams, np.zeros(3))]
        again = Search(tracks, seen, beams, view, before).found(REACH_M)
        if again is None or found.evidence + again.evidence < TOGETHER:
            return False
        return not others(np.array([[again.motion.yaw, *again.motion.t]]), expected)[0]

    @property
    def _believed(self) -> NDArray[np.float64]:
        """The last motions (k, 3) that tie scans of a submap to one another."""
        last = slice(-USUAL, None)
        motions, submaps = self.motions[last], self.submaps[last]
        return np.asarray(motions[1:][(np.diff(submaps) == 0) & (submaps[1:] >= 0)])

    def _views(self) -> list[View]:
        """Return the beams of the last scans of the submap, the very last first."""
        found, motion = [], np.zeros(3)
        now = len(self._motions)
        for i in reversed(range(max(now - VIEWS, 0), now)):
            if self.submaps[i] != self.submaps[-1]:
                break
            rows, _ = self.store.between(i, i + 1)
            beams = self.beams.of(i, self.store.column("location")[rows])
            if len(beams):
                found.append(View(beams, motion))
            motion = after(self.motions[i], motion[None])[0]
        return found

    def tie(self) -> None:
        """Tie submaps that follow one another where their scans, compared anew, agree."""
        store, before = self.store, self.submaps.copy()
        if not len(self.beams):
            return
        rows, _ = store.between(0, len(self._motions))
        first_row = np.searchsorted(store.iterations, np.arange(len(before) + 1))
        seen, wall = seen_before(store, rows), store.column("wall")[rows]
        scans = Scans(seen, wall, first_row, self.beams, self.motions)
        found, walls = tied(scans, before)
        self._submaps.values[:] = found
        self.same_walls = np.concatenate([self.same_walls, walls])
        name = np.arange(self._n_submaps)
        name[before[before >= 0]] = found[before >= 0]
        self._submap_of.values[:] = name[self.submap_of]
        self._submap = int(name[self._submap])

    def _see_corners(
        self, tracks: PlaneTracks, seen: PlaneObservation, walls: NDArray[np.int64]
    ) -> None:
        """Tell which corner every static end is; begin new ones where none is expected there."""
        row_of = {plane: row for row, plane in enumerate(tracks.plane.tolist())}
        told = self._told.values[walls]
        untyped = seen.kind == UNKNOWN
        wall, end = np.nonzero(np.where(untyped, told == STATIC, seen.static))
        row = np.array([row_of[plane] for plane in walls[wall].tolist()], dtype=np.int64)
        at = seen.ends[wall, end]
        off = np.abs(((at - tracks.corner_at[row, end]) * seen.along[wall]).sum(axis=1))
        fresh = ~(off <= STRAYED_M + SIGMAS * self._sd(seen)[wall])
        strayed = untyped[wall, end] & fresh & (tracks.corner[row, end] >= 0)
        if strayed.any():  # what was static is no longer in view: another interval begins
            tracks.corner[row[strayed], end[strayed]] = NO_CORNER
            self._ask_again(walls[wall[strayed]], end[strayed])
            wall, end, row, at, fresh = (v[~strayed] for v in (wall, end, row, at, fresh))
        corners = tracks.corner[row, end]
        corners[fresh] = len(self._half) + np.arange(fresh.sum())
        self._half.extend(seen.size[wall[fresh]] / 2)
        self._submap_of.extend(np.full(fresh.sum(), self._submap))
        self._wall_end.extend(2 * walls[wall[fresh]] + end[fresh])
        times = np.where(fresh, 1, tracks.corner_seen[row, end] + 1)
        share = (1 / np.minimum(times, MEMORY))[:, None]
        before = np.where(fresh[:, None], at, tracks.corner_at[row, end])
        tracks.corner_at[row, end] = before + share * (at - before)
        tracks.corner_seen[row, end] = times
        tracks.corner[row, end] = corners
        for k in np.flatnonzero(fresh & untyped[wall, end]).tolist():
            self._name(walls[wall[k]], end[k], corners[k])
        self.corner, self.landmark = np.full((2, len(seen), 2), NO_CORNER)
        self.corner[wall, end] = corners
        best = _best(seen.size[wall], times)
        self.landmark[wall[best], end[best]] = 2 * corners[best]

    def _test_ends(self) -> None:
        """Tell by the last iterations which ends are static, where no types tell (Fig. 4).

        Ends of unknown type are tested now and then.
        """
        now = len(self._motions)
        if now < INTERVAL or now % TESTED:
            return
        rows, iteration = self.store.between(now - INTERVAL, now)
        wall, kind = self.store.column("wall")[rows], self.store.column("kind")[rows]
        ends, sd = self.store.column("location")[rows], self.store.column("sd")[rows]
        same, unknown = self._since.values[wall] <= now - INTERVAL, kind == UNKNOWN
        if not (same & unknown.any(axis=1)).any():
            return
        told = self._told.values
        untyped = np.zeros(told.shape, dtype=np.bool_)
        np.logical_or.at(untyped, wall, unknown)
        kind = np.where(unknown & (told[wall] == STATIC), CORNER, kind)
        found = compared_ends(iteration[same], wall[same], ends[same], sd[same], kind[same])
        moving = found.moving & ~found.static & untyped[found.walls]
        static = found.static & untyped[found.walls]
        before = told[found.walls]
        told[found.walls] = np.where(static, STATIC, np.where(moving, MOVING, before))
        for k, end in np.argwhere(moving).tolist():
            self._name(found.walls[k], end, NO_CORNER)

    def _ask_again(self, walls: NDArray[np.int64], ends: NDArray[np.int64]) -> None:
        """Let another interval begin for walls (k,), and forget what was told of their ends."""
        self._told.values[walls, ends] = UNTOLD
        self._since.values[walls] = len(self._motions)

    def _name(self, wall: int, end: int, corner: int) -> None:
        """Enter which corner an end of a wall was throughout the last interval."""
        now = len(self._motions)
        begin = max(int(self._since.values[wall]), now - INTERVAL, 0)
        rows, _ = self.store.between(min(begin, now), now)
        own = self.store.column("wall")[rows] == wall
        self.store.column("corner")[rows][own, end] = corner
        if corner == NO_CORNER:
            self.store.column("landmark")[rows][own, end] = corner

    def _sd(self, seen: PlaneObservation) -> NDArray[np.float64]:
        """Return how sure the ends (m,) are along their walls, about."""
        return 3 * seen.sd


def seen_before(store: ObservationStore, rows: slice) -> PlaneObservation:
    """Return walls by their rows in the store."""
    columns = ("location", "kind", "sd", "z_extent")
    return PlaneObservation.of(*(store.column(name)[rows] for name in columns))


def _best(size: NDArray[np.float64], times: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return which corners (k,) the map hangs on: of long walls, and seen before."""
    rank = np.minimum(size, LONG_M) * (1 + np.minimum(times / FAMILIAR, 1))
    return np.argsort(-rank, kind="stable")[:MOST]
