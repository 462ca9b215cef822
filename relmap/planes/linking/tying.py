"""Re-evaluation of breaks and doubtful links together with the surrounding scans.

A motion that is ambiguous for a single pair of scans may be resolved by the surrounding scans: the
motions around each break and doubtful link are evaluated jointly (`hypotheses`). Small
free-standing objects are used only if they stay in place, and do not walk about as people do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import product
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.state.store import ObservationStore
from relmap.planes.linking.hypotheses import LATER, Hypotheses, Verdict
from relmap.planes.linking.judging import NO_CANDIDATES, Candidates, View
from relmap.planes.linking.links import VARYING_M, unsure_m, usual_motion
from relmap.planes.linking.placement import STILL, PlaneTracks
from relmap.planes.linking.search import Search
from relmap.planes.motions import motion_over, others
from relmap.planes.odometry.prediction import OTHERWISE, Expected
from relmap.planes.scans.beam_store import RECENT, BeamStore
from relmap.planes.scans.beams import Beams
from relmap.planes.scans.observation import PlaneObservation, seen_before

ACCEPTED = 2.5
"""Log odds above which a new motion is accepted."""
DOUBTED = -0.5
"""Log odds below which an accepted motion is rejected."""
SKIPPED, STEP_M = 2, 0.5
"""Maximum number of consecutive unmatched scans to skip, if the median step is shorter than this:
over longer ones too little stays in view, and 2 of 8 such links were wrong."""
BESIDE = 2
"""Number of links before and after a link along walls; one of these must be measured."""
EARLIER = 2
"""Scans before a doubtful one that are evaluated with it."""
LINKS = 200
"""Approximate number of links by which small free-standing objects are examined."""
APART_M, MOST_APART = 1.0, 10
"""Distance travelled between two compared scans, during which people walk on, and maximum number of
scans."""
UNKNOWN = 20
"""Points added to those that are gone: few points do not prove rest."""
OFTEN = 0.5
"""Fraction of their points that stay, above which such objects are used like all others."""


@dataclass(eq=False)
class Scans:
    """All scans with their walls and beams, and the motions between them.

    `store`: the walls of every scan, and their numbers at the time of observation; `motions`
    (i, 3): from the frame of the previous scan to that of each: yaw, x, y; `measured` (i,): which
    of these are determined in all directions; `expected`: returns the motion between two scans
    expected from odometry, or None; `begun` (b,): first scans of further runs; `firm`: whether to
    leave out walls and beams on small free-standing objects.
    """

    store: ObservationStore
    beams: BeamStore
    motions: Floats
    measured: Bools
    expected: Callable[[int, int], Expected | None]
    begun: Ints
    firm: bool = True

    def of_one_run(self, earlier: int, later: int) -> bool:
        """Return whether two scans belong to one run."""
        return not ((self.begun > earlier) & (self.begun <= later)).any()

    def motion(self, earlier: int, later: int) -> Floats:
        """Return the motion (3,) from the frame of one scan to that of another."""
        return motion_over(self.motions[earlier + 1 : later + 1])

    def plane(self, scan: int) -> Ints:
        """Return the numbers of the walls of one scan."""
        return np.asarray(self.store.column("wall")[self.store.rows(scan)])

    def beams_of(self, scan: int) -> Beams:
        """Return the beams of one scan."""
        return self.beams.of(scan, self.store.column("location")[self.store.rows(scan)])

    def holds(self, link: Link) -> bool:
        """Return whether a link is measured, or one near it is and steps are steady.

        With odometry, whether it is measured or agrees with that.
        """
        expected = self.expected(link.earlier, link.later)
        if expected is not None:
            return link.measured or bool(expected.off(link.motion[None])[0] < OTHERWISE)
        near = self.measured[max(link.earlier + 1 - BESIDE, 0) : link.later + 1 + BESIDE]
        steady = unsure_m(self.motions[self.measured]) <= VARYING_M
        return link.measured or (bool(near.any()) and steady)

    def agree(self, link: Link) -> bool:
        """Return whether the walls of two scans have the numbers that a link implies."""
        both = np.intersect1d(self.plane(link.earlier), self.plane(link.later))
        return np.array_equal(np.unique(link.walls), both) and not np.diff(link.walls).any()

    @cached_property
    def seen(self) -> Callable[[int], PlaneObservation]:
        """Returns the walls of one scan; the last ones are kept."""
        return lru_cache(RECENT)(partial(seen_before, self.store))

    @cached_property
    def tracks_of(self) -> Callable[[int], PlaneTracks]:
        """Returns the walls of one scan as tracks that a later scan may continue."""
        return lru_cache(RECENT)(
            lambda scan: PlaneTracks.of_scan(self.plane(scan), self.seen(scan))
        )

    def search(self, earlier: int, later: int, before: Floats) -> Search | None:
        """Return the search for the motion of one scan into another; None if one is empty."""
        tracks, seen = self.tracks_of(earlier), self.seen(later)
        beams = [self.beams_of(scan) for scan in (earlier, later)]
        if not min(len(tracks), len(seen), *map(len, beams)):
            return None
        views = [View(beams[0], STILL)]
        expected = self.expected(earlier, later)
        return Search(tracks, seen, beams[1], views, before, expected, self.firm)


class Link(NamedTuple):
    """An accepted motion.

    `earlier`, `later`: the scans whose frames it connects; `motion` (3,); `walls` (k, 2): pairs of
    wall numbers that are identified; `measured`: whether the motion is determined in all
    directions.
    """

    earlier: int
    later: int
    motion: Floats
    walls: Ints
    measured: bool


def judged_links(scans: Scans, is_tied: Bools, in_doubt: Bools) -> tuple[list[Link], list[int]]:
    """Re-evaluate the motions into doubtful scans with the surrounding ones.

    `is_tied` (i,): whether the motion into each scan is accepted so far; `in_doubt` (i,): which to
    evaluate; scans without walls that the run went on over are not. Returns `links`: newly accepted
    links, possibly across a few unmatched scans and `cut`: scans into which no motion is accepted
    any more.
    """
    links, cut = list[Link](), list[int]()
    shown = np.array([not tied or len(scans.plane(k)) > 0 for k, tied in enumerate(is_tied)])
    in_doubt = in_doubt & shown
    runs = ([scan for scan in part if shown[scan]] for part in _runs(in_doubt, scans.begun))
    for run in filter(None, runs):  # the last scans of a log may be empty
        fixed = is_tied[run[0]] and not in_doubt[run[0]] and run[0] not in scans.begun
        for judged in _judged(scans, run, fixed):
            if not is_tied[judged.later]:
                links += [link for link in judged.accepted if scans.holds(link)]
            elif in_doubt[judged.later] and judged.is_doubted(scans):
                same = [link for link in judged.accepted if scans.agree(link)]
                links += same
                cut += [] if same else [judged.later]
    is_tied = is_tied.copy()
    is_tied[[link.later for link in links]] = True
    is_tied[cut] = False
    links += _over_gaps(scans, is_tied)
    is_tied[[link.later for link in links]] = True
    untied = np.setdiff1d(np.flatnonzero(~is_tied), [0, *cut]).tolist()
    return links + [link for scan in untied for link in _by_odometry(scans, scan)], cut


def _by_odometry(scans: Scans, later: int) -> list[Link]:
    """Return the link into a scan by odometry alone, unless the scans contradict it."""
    expected = scans.expected(later - 1, later)
    if expected is None:
        return []
    motion, search = expected.motion, scans.search(later - 1, later, STILL)
    if search and not search.bridged(expected):
        return []
    return [Link(later - 1, later, motion, np.empty((0, 2), dtype=np.int64), False)]


def _over_gaps(scans: Scans, is_tied: Bools) -> list[Link]:
    """Return the links across a few unmatched scans."""
    links, breaks, last = list[Link](), np.flatnonzero(~is_tied), 0
    if np.median(np.hypot(*scans.motions[:, 1:].T)) > STEP_M:
        return links
    for begin, end in product(breaks.tolist(), range(1, SKIPPED + 1)):
        earlier, later = begin - 1, begin + end
        if earlier < last or later >= len(is_tied) or is_tied[later]:
            continue
        if not scans.of_one_run(earlier - EARLIER, later + LATER):
            continue
        before = range(max(earlier - EARLIER, 0), begin)
        after = range(later, min(later + LATER + 1, len(is_tied)))
        judged = _judged(scans, [*before, *after], bool(is_tied[before[0]]))
        accepted = [link for one in judged if one.later == later for link in one.accepted]
        found = [link for link in accepted if link.measured]
        links += found
        last = later if found else last
    return links


class _Judged(NamedTuple):
    """The motions from one scan into another with their likelihoods, and the accepted one."""

    earlier: int
    later: int
    verdict: Verdict
    accepted: list[Link]

    def is_doubted(self, scans: Scans) -> bool:
        """Return whether the previously accepted motion is now rejected.

        A motion that agrees with odometry never is.
        """
        motion = scans.motion(self.earlier, self.later)
        expected = scans.expected(self.earlier, self.later)
        agrees = expected is not None and expected.off(motion[None])[0] < OTHERWISE
        best, odds = self.verdict.best, self.verdict.odds(motion)
        rival = best is not None and self.verdict.odds(best) > odds
        return (odds < DOUBTED or rival) and not agrees


def _accepted(
    scans: Scans, earlier: int, later: int, found: Candidates, verdict: Verdict
) -> list[Link]:
    """Return the link between two scans if a motion is accepted: likely, and not doubtful."""
    motion = verdict.best
    if motion is None or verdict.odds(motion) < ACCEPTED:
        return []
    same = int(np.argmin(others(found.motions, motion)))
    if found.doubtful[same] and scans.expected(earlier, later) is None:
        return []
    match = found.matches[same]
    walls = np.column_stack([scans.plane(earlier)[match.tracks], scans.plane(later)[match.walls]])
    return [Link(earlier, later, motion, walls, bool(found.measured[same]))]


def _runs(in_doubt: Bools, begun: Ints) -> list[range]:
    """Return runs of scans around doubtful ones, each from one scan before the first.

    None crosses the beginning of another log.
    """
    near = np.zeros(len(in_doubt), dtype=np.bool_)
    for scan in np.flatnonzero(in_doubt).tolist():
        near[max(scan - EARLIER, 0) : scan + LATER + 1] = True
    edges = np.flatnonzero(np.diff(near, prepend=False, append=False))
    begun = begun[(begun > 0) & (begun < len(near))]  # the last log may have no scan yet
    cuts = begun[near[begun] & near[begun - 1]]
    bounds = np.sort(np.concatenate([edges, cuts, cuts])).reshape(-1, 2)
    return [range(a, b) for a, b in bounds.tolist()]


def _judged(scans: Scans, run: Sequence[int], fixed: bool) -> list[_Judged]:
    """Evaluate the motions from scan to scan of a run; the one into the first may be `fixed`."""
    hypotheses = Hypotheses(scans.motions[run[0]] if fixed else np.full(3, np.nan))
    found, judged = list[Candidates](), list[_Judged]()
    for k in range(1, len(run) + LATER):
        if k < len(run):
            usual = usual_motion(scans.motions[: run[k]])
            search = scans.search(run[k - 1], run[k], usual)
            known = [scans.motion(run[k - 1], run[k])]
            found.append(search.candidates(known) if search else NO_CANDIDATES)
            before = run[k - 2] if k > 1 else max(run[0] - 1, 0)
            same = scans.of_one_run(before, run[k])
            two_back = scans.search(before, run[k], STILL) if same else None
            expected = scans.expected(run[k - 1], run[k])
            judge = two_back.judged if two_back else None
            hypotheses.go_on(found[-1], usual, judge, expected)
        if k > LATER:
            scan = k - LATER
            verdict = hypotheses.verdict(scan)
            link = _accepted(scans, run[scan - 1], run[scan], found[scan - 1], verdict)
            judged.append(_Judged(run[scan - 1], run[scan], verdict, link))
    return judged


def share_at_rest(scans: Scans, is_tied: Bools, most: int = LINKS) -> float:
    """Return the fraction of the points on small free-standing objects that are still there later.

    Clutter is left out of both scans: it differs in each, but by chance may be where an object was.
    `is_tied` (i,): whether the motion into each scan is accepted; `most`: approximate number of
    links to examine. Returns 0 if there is none.
    """
    from relmap.planes.scans.loose_kernels import seen_again

    there = gone = 0
    step_m = float(np.median(np.hypot(*scans.motions[:, 1:].T)))
    apart = int(np.clip(np.ceil(APART_M / max(step_m, 1e-3)), 1, MOST_APART))
    for later in range(apart, len(is_tied), 1 + len(is_tied) // most):
        between = slice(later - apart + 1, later + 1)
        if not is_tied[between].all():
            continue
        before, given = (scans.beams.given(scan) for scan in (later - apart, later))
        objects, firm = before.loose & ~before.clutter, ~given.clutter
        if objects.any() and firm.any():
            points, bearings = given.by_bearing
            seen = points[firm], bearings[firm], given.origin
            motion = motion_over(scans.motions[between])
            stays, goes = seen_again(before.by_bearing[0][objects], seen, motion)
            there, gone = there + stays, gone + goes
    return there / (there + gone + UNKNOWN)
