"""Links between scans of walls, and breaks: motions and submaps.

Walls imply a motion; for a laser it is verified by beams (`search`), otherwise by the walls alone
(`placement`, `links`). If none is accepted, a submap begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from relmap.core.arrays import Floats
from relmap.planes.linking.judging import NO_MATCH, Found, View
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.linking.links import (
    USUAL,
    VARYING,
    VARYING_M,
    farthest_m,
    is_supported,
    measured_along,
    slower_m,
    unsure_m,
    usual_motion,
    varies_m,
)
from relmap.planes.linking.placement import STILL, PlaneTracks, place, settled, worth
from relmap.planes.linking.scan_comparison import VERIFYING
from relmap.planes.linking.search import Search
from relmap.planes.linking.tying import OFTEN, share_at_rest
from relmap.planes.motions import others, then
from relmap.planes.odometry.prediction import OTHERWISE, Expected
from relmap.planes.scans.beams import Beams
from relmap.planes.scans.observation import PlaneObservation

SURE, USUALLY = 4.0, 0.5
"""Log odds below which another scan must confirm a motion; and as a fraction of the usual ones."""
TOGETHER = 5.0
"""Sum of the log odds that both need."""
FEW = 4.0
"""Number of unmatched walls and corners on either side that contradict odometry."""
FIRST, AGAIN, LATELY = (10, 20), 50, 50
"""Numbers of scans after which it is evaluated whether small objects stay in place, then the
interval; and the approximate number of links examined."""
TURNING = np.deg2rad(2.5)
"""Rotation from scan to scan above which a robot is expected to be slow."""
AMBIGUOUS = 0.5
"""Largest error, as a fraction of that of an unmeasured motion along walls, where beams prefer none
of several motions along them."""
VIEWS = 6
"""Number of last scans whose beams a scan is compared with."""


class ScanLinks(LinkRecord):
    """Accepts the motion into each scan, or begins a submap; see `LinkRecord`."""

    @property
    def usual(self) -> Floats:
        """Predicted motion: by odometry, else the recent motion.

        The latter is the median over some scans, since one of them may be a jump.
        """
        expected = self._expected
        return expected.motion if expected else usual_motion(self.motions, self.measured)

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
            self._unsure_each_m = unsure_m(self.motions[self.measured])
        self._unsure_m += self._unsure_each_m
        if abs(found.motion[0]) < TURNING:
            self._unsure_m += slower_m(self.motions[self.measured], self.usual)
        most_m = AMBIGUOUS * self._bridge_m if found.ambiguous else self._bridge_m
        if self._unsure_m > most_m or self._unsure_each_m > VARYING_M:
            self._unsure_m = 0.0
            return None
        return found

    def _placed(
        self, tracks: PlaneTracks, seen: PlaneObservation, expected: Expected | None
    ) -> Found | None:
        """Return the accepted motion into a scan, and the resulting association."""
        every, recent = self._views(seen), usual_motion(self.motions, self.measured)
        views = [*islice(every, VERIFYING)]
        if views:
            beams = self.beams.of(len(self), seen.ends, seen.beams)
            if len(self) in FIRST or len(self) % AGAIN == 0:
                self._at_rest = share_at_rest(self.scans, self._known()[0], LATELY) > OFTEN
            firm = not self._at_rest
            context = recent, expected, firm, every, self._varies_m
            search = Search(tracks, seen, beams, views, *context)
            instead = self.instead.pop(len(self), None)
            if instead is not None and (near := search.near(instead)):
                self.instead[len(self)] = instead
                return near
            judged = search.found()
            return judged if judged and self._confirmed(judged, seen, beams, views, firm) else None
        motions, submaps = self.motions[-USUAL:], self.submaps[-USUAL:]
        links = motions[1:][(np.diff(submaps) == 0) & (submaps[1:] >= 0)]
        found = place(tracks, seen, self.usual, farthest_m(links))
        if found is None or not is_supported(tracks, seen, found[1]):
            return None
        return Found(*found, measured_along(tracks, seen, found[1]), np.inf)

    def _over(
        self, tracks: PlaneTracks, seen: PlaneObservation, expected: Expected
    ) -> Found | None:
        """Return the motion by odometry alone; None if observations contradict it."""
        views = [*islice(self._views(seen), VERIFYING)]
        if views:
            beams = self.beams.of(len(self), seen.ends, seen.beams)
            recent_motion = usual_motion(self.motions, self.measured)
            return Search(tracks, seen, beams, views, recent_motion, expected).bridged(expected)
        (motion,), (match,) = settled(tracks, seen, [expected.motion])
        near = expected.off(motion[None])[0] < OTHERWISE
        recent = tracks.missed == tracks.missed.min(initial=0)
        if not near and min(worth(tracks, seen, recent)) > FEW:
            return None
        if not near:
            motion, match = expected.motion, NO_MATCH
        return Found(motion, match, False, -np.inf, True)

    def _confirmed(
        self, found: Found, seen: PlaneObservation, beams: Beams, views: list[View], firm: bool
    ) -> bool:
        """Return whether the second of the views confirms a motion, if that is doubtful."""
        evidence = self.evidence[-VARYING:]
        known = np.sort(np.append(evidence[np.isfinite(evidence)], SURE))
        usual = (known[(len(known) - 1) // 2] + known[len(known) // 2]) / 2
        if found.evidence > max(SURE, USUALLY * usual) or len(views) < 2:
            return True
        expected = then(views[1].motion, found.motion)
        tracks = self.scans.tracks_of(views[1].scan)
        view = [View(views[1].beams, STILL)]
        again = Search(tracks, seen, beams, view, expected, firm=firm).found()
        if again is None or found.evidence + again.evidence < TOGETHER:
            return False
        return not others(again.motion[None], expected)[0]

    def _varies_m(self) -> float:
        """Return how much the length of the last measured steps varies, metres."""
        return varies_m(self.motions[self.measured])

    def _views(self, seen: PlaneObservation) -> Iterator[View]:
        """Yield the beams of the last scans of the submap, latest first."""
        if not (seen.beams.in_order and len(seen.beams.points)):
            return
        motion = STILL
        now, motions, ends = len(self._motions), self.motions, self.store.column("location")
        first = max(now - VIEWS, 0, *self.begun[-1:].tolist())  # of the same run
        outside = np.flatnonzero(self.submaps[first:] != self.submaps[-1])
        first += int(outside[-1]) + 1 if len(outside) else 0
        for i in reversed(range(first, now)):
            beams = self.beams.of(i, ends[self.store.rows(i)])
            if len(beams):
                yield View(beams, motion, i)
            motion = then(motions[i], motion)
