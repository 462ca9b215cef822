"""When landmarks are grouped: the three passes of section III."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Ints, among
from relmap.core.config import MapperConfig
from relmap.core.state.table import LandmarkState

WAIT = 2
"""Delay of level 3 until others leave the view too, in units of level 1's observations."""
LONGEST_INTERVAL = 128
"""Maximum number of iterations kept, even if a landmark has found no group."""
RIPE = 0.75
"""Fraction of the longest interval above which one is complete when a neighbour's is."""
FEW = 0.1
"""Fraction of the landmarks in view up to which those without a position wait: a group of a higher
level places them soon. Level 1 is due only if there are more."""


class GroupingSchedule:
    """The current interval of each landmark, and which landmarks are due at which level.

    A landmark is due at level 1 after a few observations, at level 2 when there are enough to
    detect motion, and at level 3 when it has left the view and its whole interval is known.

    `config`: when each level is due; level 3 waits for the end of the interval, but at most
    `third_pass`: the observations of a landmark that stays in view are split into several
    intervals.

    Attributes: `in_view` (k,): landmarks in view, including those missed for a moment; `gone` (k,):
    those that have left the view and wait for level 3, in the order of leaving.
    """

    STATE = "in_view _due gone"

    def __init__(self, table: LandmarkState, config: MapperConfig) -> None:
        self._table = table
        self._max_missed = config.max_missed
        self._wait = config.max_missed + WAIT * config.group_after
        passes = np.array([1, config.second_pass, config.third_pass])
        self._thresholds = config.group_after * passes
        self.in_view = np.empty(0, dtype=np.int64)
        self._due = np.empty(0, dtype=np.int64)
        self.gone = np.empty(0, dtype=np.int64)
        self._first: int | None = None  # see `needed_from`; None after a change

    def needed_from(self, end: int) -> int:
        """Return the first iteration that a group may still need; `end` is the next iteration."""
        if self._first is None:
            begins = self._table.begin[np.concatenate([self.in_view, self.gone])]
            self._first = int(begins.min(initial=end))
        return max(self._first, end - LONGEST_INTERVAL)

    def see(self, landmarks: Ints, iteration: int) -> Ints:
        """Record which landmarks are seen in this iteration; return those that left in it.

        Those that have become due are queued. A landmark whose group fails is due again after as
        many more observations.
        """
        import relmap.core.state.seeing_kernels as kernels

        of, waiting = self._table, (self.in_view, self.gone)
        counts = of.last, of.observations, of.in_interval
        columns = *counts, of.is_gone, of.begin, of.level, of.weight
        self.in_view, self.gone, left, ready, self._first = kernels.see(
            columns, landmarks, waiting, iteration, self._max_missed, self._thresholds
        )
        if len(ready):
            fresh = ready[~among(ready, self._due)] if len(self._due) else ready
            self._due = np.concatenate([self._due, fresh])
        return left

    def next_due(self) -> tuple[int, int] | None:
        """Remove a landmark that is still due from the queue; return it with its level.

        Lower levels come first, then the landmarks seen longest.
        """
        if not len(self._due):
            return None
        import relmap.core.state.seeing_kernels as kernels

        of = self._table
        columns = of.in_interval, of.level, of.weight
        self._due, level = kernels.due(columns, self._due, self._thresholds, 1, -1.0, self._due)
        if not len(self._due):
            return None
        counts, begin = self._table.in_interval[self._due], self._table.begin[self._due]
        order = np.lexsort((self._due, begin, -counts, level))
        seed, self._due = int(self._due[order[0]]), self._due[order[1:]]
        return seed, int(level[order[0]])

    def waited(self, iteration: int) -> Ints:
        """Return the landmarks due at level 3 because they left the view long ago; (k,)."""
        gone, last = self.gone, self._table.last
        if not len(gone) or iteration - last[gone[0]] < self._wait:
            return gone[:0]
        return gone[iteration - last[gone] >= self._wait]

    def end(self) -> None:
        """Mark everything in view as left: no more scans will come."""
        stayed = self.in_view[~self._table.is_gone[self.in_view]]
        self.gone = np.concatenate([self.gone, stayed])
        self._table.is_gone[self.in_view] = True
        self._first = None

    @property
    def limits(self) -> tuple[float, int]:
        """Observations with which an interval is complete, and of which one may be stored."""
        return RIPE * float(self._thresholds[-1]), LONGEST_INTERVAL

    def merge(self, new: Ints, old: Ints) -> None:
        """Let older landmarks (k,) wait in place of the new ones (k,) merged into them.

        One in view stays there if the new one has left, or does not wait any more.
        """
        stays = among(old, self.in_view) & ~among(old, self.gone)
        self._table.is_gone[old[stays]] = False
        replaced = old[among(new, self.in_view)]
        self.in_view = self.in_view[~among(self.in_view, replaced)]
        self._first = None
        order = new.argsort()
        new, old = new[order], old[order]
        for waiting in (self.in_view, self._due, self.gone):
            at = np.minimum(np.searchsorted(new, waiting), len(new) - 1)
            waiting[:] = np.where(new[at] == waiting, old[at], waiting)
        self.gone = self.gone[self._table.is_gone[self.gone]]

    def part(self, track: int, iteration: int) -> None:
        """Begin an interval of a track that is no longer another landmark's, in view if just seen.

        `iteration`: the next one.
        """
        own = np.array([track])
        self.begin_anew(own, iteration)
        if iteration - 1 - self._table.last[track] <= self._max_missed:
            self.in_view = np.append(self.in_view, own)

    def begin_anew(self, landmarks: Ints, iteration: int) -> None:
        """End the interval of landmarks; those in view begin a new one."""
        self._table.is_gone[landmarks] = False
        self.gone = self.gone[self._table.is_gone[self.gone]]
        self._table.begin[landmarks] = iteration
        self._table.in_interval[landmarks] = 0
        self._first = None
