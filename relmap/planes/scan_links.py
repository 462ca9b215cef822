"""Links between scans of walls, and breaks: motions and submaps.

Walls imply a motion; for a laser it is verified by beams (`relmap.planes.search`), otherwise by the
walls alone (`relmap.planes.placement`, `relmap.planes.links`). If none is accepted, a submap
begins.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.state.growing import GrowingArray
from relmap.core.state.store import ObservationStore
from relmap.planes.beams import Beams, BeamStore
from relmap.planes.judging import View
from relmap.planes.links import (
    USUAL,
    VARYING,
    VARYING_M,
    believed,
    farthest_m,
    measured_along,
    unsure_m,
    usual_motion,
)
from relmap.planes.motions import after, inverse, motion_over, others, planar
from relmap.planes.observation import PlaneObservation
from relmap.planes.odometry import OTHERWISE, Expected, Wheels
from relmap.planes.placement import PlanarMotion, place, settled, worth
from relmap.planes.search import NO_MATCH, Found, Search
from relmap.planes.tracks import PlaneTracks
from relmap.planes.tying import Scans, judged_links

SURE, USUALLY = 4.0, 0.5
"""Log odds below which another scan must confirm a motion; and as a fraction of the usual ones."""
TOGETHER = 5.0
"""Sum of the log odds that both need."""
IN_DOUBT = 10.0
"""Log odds below which a motion is re-evaluated with the surrounding scans."""
FEW = 4.0
"""Number of unmatched walls and corners on either side that contradict odometry."""
VIEWS = 2
"""Number of last scans whose beams verify a motion."""


class ScanLinks:
    """The accepted motions between scans, and the submap of each scan.

    Parameters
    ----------
    bridge_m : float, metres
        Largest error of an unmeasured motion along walls; beyond it a submap ends.

    Attributes
    ----------
    store : ObservationStore
        All observations so far.
    beams : BeamStore
        The beams of each scan, if given.
    wheels : Wheels
        The odometry, if any.
    submap : int
        Submap of the next scan, unless it begins a new one.
    same_walls : (k, 2) int64
        Pairs of wall numbers identified when submaps were joined.
    """

    STATE = (
        "_motions _submaps _n_submaps submap _unsure_m _unsure_each_m _evidence _measured _bridged "
        "beams same_walls _begun"
    )

    def __init__(self, bridge_m: float) -> None:
        self._bridge_m = bridge_m
        self._n_submaps, self.submap = 0, -1
        self._begun: GrowingArray[np.int64] = GrowingArray(np.int64)
        self.same_walls = np.empty((0, 2), dtype=np.int64)
        self._unsure_m, self._unsure_each_m = 0.0, 0.0
        self._motions: GrowingArray[np.float64] = GrowingArray(np.float64, (3,))
        self._submaps: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._evidence: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._measured: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        self._bridged: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        self.store = ObservationStore()
        self.beams = BeamStore()
        self.wheels = Wheels()

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self._motions)

    @property
    def motions(self) -> Floats:
        """Approximate motion (i, 3) from each previous robot frame to the next: yaw, x, y."""
        return self._motions.values

    @property
    def submaps(self) -> Ints:
        """Submap of each iteration; (i,), -1 for none."""
        return self._submaps.values

    @property
    def measured(self) -> Bools:
        """Which motions (i,) are determined by walls in all directions."""
        return self._measured.values

    @property
    def bridged(self) -> Bools:
        """Which motions (i,) are determined by odometry only."""
        return self._bridged.values

    @property
    def usual(self) -> PlanarMotion:
        """Predicted motion: by odometry, else the recent motion.

        The latter is the median over some scans, since one of them may be a jump.
        """
        expected = self._expected
        return planar(expected.motion if expected else usual_motion(self.motions))

    @property
    def _expected(self) -> Expected | None:
        """The next motion expected from odometry."""
        now = len(self._motions)
        return self.wheels.expected(now - 1, now, self.motions, self.measured) if now else None

    @property
    def goes_on(self) -> bool:
        """Whether odometry links to the next scan, independent of its content."""
        last = self.submaps[-1:]
        return bool((last >= 0).any()) and self._expected is not None

    def begin_submap(self) -> None:
        """Begin a submap with the next scan."""
        self.submap = self._n_submaps
        self._n_submaps += 1

    def begin_run(self) -> None:
        """Begin another run with the next scan, which is not tied to the last one."""
        self._begun.extend(np.array([len(self)]))

    def attach(self, first: int, motion: Floats, scan: int, walls: Ints) -> Ints:
        """Tie a submap to that of another scan, in whose map it was localised.

        Parameters
        ----------
        first : int
            Its first scan.
        motion : (3,) float64
            To that scan, from the one before.
        scan : int
        walls : (k, 2) int64
            Pairs of numbers of the same wall.

        Returns
        -------
        (s,) int64
            New number of each submap.
        """
        old, new = int(self.submaps[first]), int(self.submaps[scan])
        self.motions[first] = motion
        self._evidence.values[first], self.measured[first] = np.inf, True
        self.same_walls = np.concatenate([self.same_walls, walls])
        name = np.arange(self._n_submaps)
        name[old] = new
        self.submap = int(name[self.submap])
        self._submaps.values[self.submaps == old] = new
        return name

    def append(
        self,
        seen: PlaneObservation,
        motion: PlanarMotion,
        is_tied: bool,
        found: Found | None,
        goes_on: bool,
    ) -> None:
        """Record the motion into a scan, whether it belongs to the submap, and its source.

        The source is a match, or odometry if it `goes_on`.
        """
        self._evidence.extend(np.array([found.evidence if found else np.nan]))
        self._measured.extend(np.array([found is not None and found.measured]))
        self._bridged.extend(np.array([found.bridged if found else goes_on]))
        self.beams.append(seen.beams)
        self._motions.extend(np.array([[motion.yaw, *motion.t]]))
        self._submaps.extend(np.array([self.submap if is_tied else -1]))

    def into(self, tracks: PlaneTracks, seen: PlaneObservation) -> Found | None:
        """Return the accepted motion into a scan, and the resulting association.

        None also if the motion along walls has been unmeasured for too long.
        """
        expected = self._expected
        found = self._placed(tracks, seen, expected)
        if found is None:
            return self._over(tracks, seen, expected) if expected else None
        if found.measured or expected:
            self._unsure_m = 0.0
            return found
        if not self._unsure_m:
            self._unsure_each_m = unsure_m(self.motions[self._measured.values])
        self._unsure_m += self._unsure_each_m
        if self._unsure_m > self._bridge_m or self._unsure_each_m > VARYING_M:
            self._unsure_m = 0.0
            return None
        return found

    def _placed(
        self, tracks: PlaneTracks, seen: PlaneObservation, expected: Expected | None
    ) -> Found | None:
        """Return the accepted motion into a scan, and the resulting association."""
        reach_m, views = farthest_m(self._believed), self._views(seen)
        usual = self.usual
        if views:
            beams = Beams.of(seen.beams.points, seen.beams.origin, seen.ends)
            judged = Search(tracks, seen, beams, views, usual, expected).found()
            return judged if judged and self._confirmed(judged, seen, beams, views) else None
        found = place(tracks, seen, usual, reach_m)
        if found is None or not believed(tracks, seen, found, usual):
            return None
        return Found(*found, measured_along(tracks, seen, found[1]), np.inf)

    def _over(
        self, tracks: PlaneTracks, seen: PlaneObservation, expected: Expected
    ) -> Found | None:
        """Return the motion by odometry alone; None if observations contradict it."""
        views = self._views(seen)
        if views:
            beams = Beams.of(seen.beams.points, seen.beams.origin, seen.ends)
            return Search(tracks, seen, beams, views, self.usual, expected).bridged(expected)
        motion, match = settled(tracks, seen, planar(expected.motion))
        near = expected.off(np.array([[motion.yaw, *motion.t]]))[0] < OTHERWISE
        recent = tracks.missed == tracks.missed.min(initial=0)
        if not near and min(worth(tracks, seen, recent)) > FEW:
            return None
        if not near:
            motion, match = planar(expected.motion), NO_MATCH
        return Found(motion, match, False, -np.inf, True)

    def _confirmed(
        self, found: Found, seen: PlaneObservation, beams: Beams, views: list[View]
    ) -> bool:
        """Return whether the scan before the last one confirms a motion, if that is doubtful."""
        evidence = self._evidence.values[-VARYING:]
        usual = np.median(np.append(evidence[np.isfinite(evidence)], SURE))
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
        again = Search(tracks, seen, beams, view, before).found()
        if again is None or found.evidence + again.evidence < TOGETHER:
            return False
        return not others(np.array([[again.motion.yaw, *again.motion.t]]), expected)[0]

    @property
    def _believed(self) -> Floats:
        """The last motions (k, 3) that link scans of a submap."""
        last = slice(-USUAL, None)
        motions, submaps = self.motions[last], self.submaps[last]
        return np.asarray(motions[1:][(np.diff(submaps) == 0) & (submaps[1:] >= 0)])

    def _views(self, seen: PlaneObservation) -> list[View]:
        """Return the beams of the last scans of the submap, latest first."""
        found, motion = list[View](), np.zeros(3)
        if not (seen.beams.in_order and len(seen.beams.points)):
            return found
        now = len(self._motions)
        for i in reversed(range(max(now - VIEWS, 0), now)):
            if self.submaps[i] != self.submaps[-1]:
                break
            rows, _ = self.store.between(i, i + 1)
            beams = self.beams.of(i, self.store.column("location")[rows])
            if len(beams):
                found.append(View(beams, motion))
            if i in self._begun.values:
                break  # earlier scans belong to another run
            motion = after(self.motions[i], motion[None])[0]
        return found

    def leave_to_odometry(self, scans: Ints) -> bool:
        """Let odometry replace links into scans (t,) where it agrees; return if any changed.

        These are links that the map contradicts.
        """
        found = False
        for scan in scans[self.measured[scans]].tolist():
            expected = self.wheels.expected(scan - 1, scan, self.motions, self.measured)
            if expected and expected.off(self.motions[scan][None])[0] < OTHERWISE:
                self.measured[scan], found = False, True
        return found

    def cut(self, scans: Ints) -> None:
        """Begin submaps at scans (t,) whose links the map contradicts."""
        for scan in scans.tolist():
            old = self.submaps[scan]
            later = np.flatnonzero(self.submaps == old)
            self._submaps.values[later[later >= scan]] = self._n_submaps
            self.submap = self._n_submaps if self.submap == old else self.submap
            self._n_submaps += 1

    def tie(self) -> tuple[Ints, Ints]:
        """Re-evaluate doubtful links and breaks with the surrounding scans.

        Returns
        -------
        name : (s,) int64
            Current number of each submap.
        cut : (c,) int64
            Scans whose links are no longer accepted; see `cut`.
        """
        name = np.arange(self._n_submaps)
        if not (len(self.beams) and self._n_submaps):
            return name, np.empty(0, dtype=np.int64)
        links, cut = judged_links(self._scans, *self._known())
        for link in links:
            between = motion_over(self.motions[link.earlier + 1 : link.later])
            self.motions[link.later] = after(inverse(between), link.motion[None])[0]
            if len(self.wheels.given):
                self.measured[link.later] = link.measured and link.earlier == link.later - 1
                self.bridged[link.later] = not len(link.walls)
            old, new = self.submaps[link.later], self.submaps[link.earlier]
            if new >= 0:
                self._submaps.values[self.submaps == old] = new
                name[name == old] = new
        self.same_walls = np.concatenate([self.same_walls, *(link.walls for link in links)])
        self.submap = int(name[self.submap])
        self.wheels.look_again()
        return name, np.array(cut, dtype=np.int64)

    @property
    def _scans(self) -> Scans:
        """All scans with their walls and beams."""
        rows, _ = self.store.between(0, len(self._motions))
        first_row = np.searchsorted(self.store.iterations, np.arange(len(self._motions) + 1))
        seen, wall = seen_before(self.store, rows), self.store.column("wall")[rows]
        expected = partial(
            self.wheels.expected, motions=self.motions, measured=self.measured.copy()
        )
        links = self.motions, self.measured, expected, self._begun.values
        return Scans(seen, wall, first_row, self.beams, *links)

    def _known(self) -> tuple[Bools, Bools]:
        """Return whether the motion into scans (i,) is accepted, and which to re-evaluate."""
        is_tied = (np.diff(self.submaps, prepend=-2) == 0) & (self.submaps >= 0)
        in_doubt = ~(is_tied & (self._evidence.values > IN_DOUBT))
        in_doubt[:1] = False
        return is_tied, in_doubt


def seen_before(store: ObservationStore, rows: slice) -> PlaneObservation:
    """Return walls by their rows in the store."""
    columns = ("location", "kind", "sd", "z_extent")
    return PlaneObservation.of(*(store.column(name)[rows] for name in columns))
