"""The links between scans as they were accepted: motions, submaps, and what changes them later."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from itertools import accumulate
from typing import Any

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.state.growing import GrowingArray
from relmap.core.state.store import ObservationStore
from relmap.planes.linking.adjoining import RIVAL, tied_across
from relmap.planes.linking.judging import Found
from relmap.planes.linking.tying import OFTEN, Link, Scans, judged_links, share_at_rest
from relmap.planes.motions import after, from_matrices, inverse, matrices, motion_over
from relmap.planes.odometry.prediction import Wheels
from relmap.planes.scans.beam_store import BeamStore
from relmap.planes.scans.observation import PlaneObservation

IN_DOUBT = 10.0
"""Log odds below which a motion is re-evaluated with the surrounding scans."""
BY_BEAMS = 15.0
"""Those of a tie that only the beams suggested."""


def values_of(column: str) -> Any:
    """Return a property: the values of a `GrowingArray`."""
    return property(lambda self: getattr(self, column).values)


class LinkRecord:
    """The accepted motions between scans, and the submap of each scan.

    `bridge_m`, metres: largest error of an unmeasured motion along walls; beyond it a submap ends.

    Attributes: `store`: all observations so far; `beams`: the beams of each scan, if given;
    `wheels`: the odometry, if any; `submap`: submap of the next scan, unless it begins a new one;
    `same_walls` (k, 2): pairs of wall numbers identified when submaps were joined. `motions`
    (i, 3): approximate motion from each previous robot frame to the next: yaw, x, y; `submaps`
    (i,): submap of each iteration, -1 for none; `measured`, `bridged` (i,): which motions are
    determined by walls in all directions, and by odometry only; `evidence` (i,): log odds of each
    motion; NaN if unknown, infinite if it is by maps or given; `begun` (r,): first iteration of
    each further log, see `begin_run`; `instead`: motions (3,) into some scans that are taken
    instead of those found, see `relmap.planes.submaps.periods`.
    """

    motions: Floats = values_of("_motions")
    submaps: Ints = values_of("_submaps")
    measured: Bools = values_of("_measured")
    bridged: Bools = values_of("_bridged")
    evidence: Floats = values_of("_evidence")
    begun: Ints = values_of("_begun")
    instead: dict[int, Floats]

    STATE = (
        "_motions _submaps _n_submaps submap _unsure_m _unsure_each_m _evidence _measured _bridged "
        "beams same_walls _begun _at_rest instead"
    )
    JOINED = "_motions _submaps submap _evidence _measured _bridged same_walls"
    """What `join` and the refinement of joined submaps change."""

    def __init__(self, bridge_m: float) -> None:
        self._bridge_m = bridge_m
        self._n_submaps, self.submap = 0, -1
        self._begun: GrowingArray[np.int64] = GrowingArray(np.int64)
        self.same_walls = np.empty((0, 2), dtype=np.int64)
        self._unsure_m, self._unsure_each_m = 0.0, 0.0
        self._at_rest = False
        self.instead = {}
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

    def begin_submap(self) -> None:
        """Begin a submap with the next scan."""
        self.submap = self._n_submaps
        self._n_submaps += 1

    def begin_run(self) -> None:
        """Begin another run with the next scan, which is not tied to the last one."""
        if len(self) not in self.begun:
            self._begun.append(len(self))

    def _unite(self, old: int, new: int) -> None:
        """Make one submap part of another, after a motion was changed."""
        self.wheels.look_again()
        self.submaps[self.submaps == old] = new
        self.submap = new if self.submap == old else self.submap

    def append(
        self,
        seen: PlaneObservation,
        motion: Floats,
        is_tied: bool,
        found: Found | None,
        goes_on: bool,
    ) -> None:
        """Record the motion into a scan, whether it belongs to the submap, and its source.

        Without a match (`found`), the source is odometry if the submap `goes_on`. After too many
        scans without walls those before leave the submap: constant motion was only a guess.
        """
        if not is_tied and (self.submaps[-1:] >= 0).any():
            for last in self.store.iterations[-1:].tolist():
                self.submaps[last + 1 :] = -1
        self._evidence.append(found.evidence if found else np.nan)
        self._measured.append(found is not None and found.measured)
        self._bridged.append(found.bridged if found else goes_on)
        self.beams.append(seen.beams)
        self._motions.append(motion)
        self._submaps.append(self.submap if is_tied else -1)

    def cut(self, scans: Ints) -> None:
        """Begin submaps at scans (t,) whose links the map contradicts."""
        self.wheels.look_again()  # the motions may be those of before a join
        for scan in scans.tolist():
            old = self.submaps[scan]
            later = np.flatnonzero(self.submaps == old)
            self.submaps[later[later >= scan]] = self._n_submaps
            self.submap = self._n_submaps if self.submap == old else self.submap
            self._n_submaps += 1

    def cut_torn(self, scans: Ints) -> None:
        """Begin submaps at scans (t,) at which refinement tears the map.

        Or at the ties by beams of the same submaps instead, if there are any: then one of these is
        not certain enough, and the map is as if they had not been found.
        """
        by_beams = np.flatnonzero(self._known()[0] & (self.evidence == BY_BEAMS))
        torn = self.submaps[scans]
        doubtful = by_beams[np.isin(self.submaps[by_beams], torn)]
        others = scans[~np.isin(torn, self.submaps[doubtful])]
        self.cut(np.union1d(doubtful, others))

    def tie(self) -> None:
        """Re-evaluate doubtful links and breaks with the surrounding scans.

        Submaps begin at scans whose links are no longer accepted.
        """
        if not (len(self.beams) and self._n_submaps):
            return
        is_tied, in_doubt = self._known()
        scans, share = self.scans, share_at_rest(self.scans, is_tied)
        links, cut = judged_links(replace(scans, firm=share <= OFTEN), is_tied, in_doubt)
        self.cut(np.array(cut, dtype=np.int64))  # before links past such scans are taken
        self._take(links)
        if share > OFTEN:  # the remaining breaks without small objects, as some may have moved
            is_tied, _ = self._known()
            in_doubt = ~is_tied
            in_doubt[:1] = False
            more, _ = judged_links(replace(self.scans, firm=True), is_tied, in_doubt)
            self._take(more)
        self._take_adjoining(cut)
        self.wheels.look_again()

    def _take_adjoining(self, cut: Sequence[int]) -> None:
        """Tie submaps that are adjacent in time, other than at scans where one was cut.

        The beams supply candidates only where no motion by walls is certain any more.
        """
        scans, failed = replace(self.scans, firm=True), set[tuple[int, ...]]()
        by_beams, found = False, True
        while found or not by_beams:
            by_beams, found = not found, False
            for scan in range(1, len(self)):
                own, other = self.submaps[scan - 1 : scan + 1].tolist()
                if min(own, other) < 0 or own == other or scan in cut:
                    continue
                link = tied_across(scans, self.submaps, scan, failed if by_beams else None)
                if link is not None:
                    self._take([link])
                    self.evidence[scan] = BY_BEAMS if by_beams else RIVAL
                    found = True

    def _take(self, links: Sequence[Link]) -> None:
        """Add links that were accepted later."""
        for link in links:
            between = motion_over(self.motions[link.earlier + 1 : link.later])
            self.motions[link.later] = after(inverse(between), link.motion[None])[0]
            if len(self.wheels.given):
                self.measured[link.later] = link.measured and link.earlier == link.later - 1
                self.bridged[link.later] = not len(link.walls)
            old, new = self.submaps[[link.later, link.earlier]].tolist()
            if old < 0:  # an empty scan; others like it stay outside
                self.submaps[link.later] = new
            elif new >= 0:
                self._unite(old, new)
        walls = np.concatenate([self.same_walls, *(link.walls for link in links)])
        self.same_walls = np.unique(walls, axis=0)

    def join(self, poses: Sequence[Floats], walls: Ints) -> None:
        """Join submaps whose maps show the same place.

        `poses`, sequence of (i, 4, 4): for the submaps that become one, the poses of all their
        scans in one frame; NaN for other scans. `walls` (k, 2): pairs of numbers of the same wall.
        """
        submaps = self.submaps
        chain = np.linalg.inv(matrices(self.motions))
        every = np.array(list(accumulate(chain, np.matmul)))
        for path in poses:
            own = np.isfinite(path[:, 0, 0])
            every[own] = path[own]
        first = np.flatnonzero((np.diff(submaps, prepend=-1) != 0) & (submaps >= 0))
        for path in poses:
            one, *others = np.unique(submaps[np.isfinite(path[:, 0, 0])]).tolist()
            for other in others:
                self._unite(other, one)
        for scan in first.tolist():
            earlier = np.flatnonzero(submaps[:scan] == submaps[scan])
            if len(earlier):
                before = int(earlier[-1])
                motion = from_matrices((np.linalg.inv(every[scan]) @ every[before])[None])
                between = motion_over(self.motions[before + 1 : scan])
                self.motions[scan] = after(inverse(between), motion)[0]
                self.evidence[scan], self.measured[scan] = np.inf, True
        self.same_walls = np.concatenate([self.same_walls, walls])

    def before_join(self) -> dict[str, Any]:
        """Return a copy of what `join` changes."""
        return {name: deepcopy(getattr(self, name)) for name in self.JOINED.split()}

    @property
    def scans(self) -> Scans:
        """All scans with their walls and beams."""
        expected = partial(
            self.wheels.expected, motions=self.motions, measured=self.measured.copy()
        )
        links = self.motions, self.measured, expected, self.begun
        return Scans(self.store, self.beams, *links)

    def _known(self) -> tuple[Bools, Bools]:
        """Return whether the motion into scans (i,) is accepted, and which to re-evaluate."""
        is_tied = (np.diff(self.submaps, prepend=-2) == 0) & (self.submaps >= 0)
        in_doubt = ~(is_tied & (self.evidence > IN_DOUBT))
        in_doubt[:1] = False
        return is_tied, in_doubt
