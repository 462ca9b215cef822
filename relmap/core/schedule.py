"""When landmarks are grouped: the three passes of section III."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.growing import GrowingArray
from relmap.core.levels import GroupLevels
from relmap.core.sightings import Sightings

PASSES = (1, 3, 6)
"""Observations from which levels 1, 2 and 3 are due, in units of those of level 1.

The second pass needs enough to tell who moves.  The third waits for the end of the interval, but
not longer than this: what stays in view has one interval after the other.
"""
WAIT = 2
"""How long level 3 waits for others to leave the view too, in units of level 1's observations."""
LONGEST_INTERVAL = 128
"""Iterations that are kept at most, however long a landmark has found no group."""
RIPE = 0.75
"""Share of the longest interval from which one is whole when a neighbour's is."""


class GroupingSchedule:
    """The interval in which each landmark is being seen, and so who is due at which level.

    A landmark is due at level 1 after a few observations, at level 2 when there are enough to tell
    whether it moves, and at level 3 when it has left the view and its whole interval is known.

    Parameters
    ----------
    group_after : int
        Observations after which level 1 is due.
    max_missed : int
        A landmark unseen for more iterations than this has left the view.
    sightings : Sightings
        Kept up to date here.
    levels : GroupLevels
        What was reached so far.
    """

    def __init__(
        self, group_after: int, max_missed: int, sightings: Sightings, levels: GroupLevels
    ) -> None:
        self.group_after = group_after
        self._max_missed = max_missed
        self._wait = max_missed + WAIT * group_after
        self._sightings = sightings
        self._levels = levels
        self._thresholds = group_after * np.array(PASSES)
        self._begin: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._counts: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._is_gone: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        self._in_view = np.empty(0, dtype=np.int64)
        self._due = np.empty(0, dtype=np.int64)
        self._gone = np.empty(0, dtype=np.int64)

    @property
    def begin(self) -> NDArray[np.int64]:
        """Iteration in which each landmark's present interval began; (n,)."""
        return self._begin.values

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of observations of each landmark in its present interval; (n,)."""
        return self._counts.values

    @property
    def in_view(self) -> NDArray[np.int64]:
        """Landmarks in view, those missed for a moment included."""
        return self._in_view

    @property
    def is_gone(self) -> NDArray[np.bool_]:
        """Whether each landmark has left the view and waits for level 3; (n,)."""
        return self._is_gone.values

    @property
    def gone(self) -> NDArray[np.int64]:
        """Those that have left the view and wait for level 3, in the order of leaving; (k,)."""
        self._gone = self._gone[self.is_gone[self._gone]]
        return self._gone

    @property
    def oldest_needed(self) -> int | None:
        """First iteration that a group may still need; None where none may."""
        begins = self.begin[np.concatenate([self._in_view, self.gone])]
        return int(begins.min()) if len(begins) else None

    def see(self, landmarks: NDArray[np.int64], iteration: int) -> NDArray[np.int64]:
        """Note who is seen in this iteration; return who has left the view with it."""
        self._resize(int(landmarks.max(initial=-1)) + 1, iteration)
        last_seen = self._sightings.last
        arrived = landmarks[iteration - last_seen[landmarks] > self._max_missed + 1]
        if len(arrived):
            self.begin_anew(arrived[~self.is_gone[arrived]], iteration)
            self.is_gone[arrived] = False
        self.counts[landmarks] += 1
        self._sightings.see(landmarks, iteration)
        stays = iteration - last_seen[self._in_view] <= self._max_missed
        left = self._in_view[~stays]
        if len(left) or len(arrived):
            self._in_view = np.concatenate([self._in_view[stays], arrived])
            self._gone = np.concatenate([self.gone, left])
            self.is_gone[left] = True
        return left

    def note_due(self, landmarks: NDArray[np.int64]) -> None:
        """Queue those of the landmarks seen in this iteration that have become due.

        One whose group fails for want of company is due again after as many more observations.
        """
        ready = landmarks[self.counts[landmarks] % self.group_after == 0]
        ready = ready[self.level_due(ready) > 0]
        self._due = np.concatenate([self._due, ready[~np.isin(ready, self._due)]])

    def next_due(self) -> tuple[int, int] | None:
        """Take a landmark off the queue that is still due, and its level.

        The lower levels come first, and then the ones seen longest.
        """
        level = self.level_due(self._due)
        self._due, level = self._due[level > 0], level[level > 0]
        if not len(self._due):
            return None
        counts, begin = self.counts[self._due], self.begin[self._due]
        first = np.lexsort((self._due, begin, -counts, level))[0]
        seed = int(self._due[first])
        self._due = np.delete(self._due, first)
        return seed, int(level[first])

    def level_due(self, landmarks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the level (n,) that landmarks in view should have by now; 0 if they have it."""
        level = np.searchsorted(self._thresholds, self.counts[landmarks], side="right")
        return np.where(level > self._levels.present[landmarks], level, 0)

    def waited(self, iteration: int) -> NDArray[np.int64]:
        """Return who is due at level 3 for having left the view so long ago; (k,)."""
        gone = self.gone
        if not len(gone) or iteration - self.last_seen(gone[:1])[0] < self._wait:
            return gone[:0]
        return gone[iteration - self.last_seen(gone) >= self._wait]

    def last_seen(self, landmarks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the iteration in which landmarks (n,) were last seen."""
        return self._sightings.last[landmarks]

    def end(self) -> None:
        """Let everything in view have left it: nothing more is to come."""
        self._gone = np.concatenate([self.gone, self._in_view[~self.is_gone[self._in_view]]])
        self.is_gone[self._in_view] = True

    def reached(
        self, landmarks: NDArray[np.int64], n_averaged: NDArray[np.int64], level: int
    ) -> NDArray[np.int64]:
        """Return the level (n,) that a group of some level gives to the landmarks it averaged.

        The third is for whole intervals only, and one that holds less than half of a landmark's
        observations, as far as they are kept, gives it no more than the first.
        """
        counts = self.counts[landmarks]
        whole = self.is_gone[landmarks] | (counts >= RIPE * self._thresholds[-1])
        reached = np.where(whole, level, min(level, 2))
        return np.where(2 * n_averaged >= np.minimum(counts, LONGEST_INTERVAL), reached, 1)

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark go on in place of a new one, which turned out to be it."""
        for column in (self._begin, self._counts, self._is_gone):
            column.values[old] = column.values[new]
        self.is_gone[new] = False
        self._in_view = self._in_view[self._in_view != old]
        self._in_view[self._in_view == new] = old
        self._due[self._due == new] = old
        self._gone[self._gone == new] = old

    def begin_anew(self, landmarks: NDArray[np.int64], iteration: int) -> None:
        """End the interval of landmarks; those in view begin another."""
        self.is_gone[landmarks] = False
        self.begin[landmarks] = iteration
        self.counts[landmarks] = 0

    def _resize(self, n: int, iteration: int) -> None:
        if n > len(self._begin):
            self._begin.resize(n, 0)
            self._counts.resize(n, 0)
            self._is_gone.resize(n, False)
            self._sightings.resize(n, iteration)
