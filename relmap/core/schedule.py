"""When a landmark is grouped: after every few sightings, and when it leaves the view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.growing import GrowingArray
from relmap.core.sightings import Sightings


class GroupingSchedule:
    """Which of each landmark's observations no group has used yet, and so who is due.

    Parameters
    ----------
    group_after : int
        A landmark is due each time so many observations wait.
    max_missed : int
        A landmark unseen for more iterations than this has left the view.
    sightings : Sightings
        Kept up to date here.
    """

    def __init__(self, group_after: int, max_missed: int, sightings: Sightings) -> None:
        self._group_after = group_after
        self._max_missed = max_missed
        self._begin: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._waiting: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._sightings = sightings
        self._in_view = np.empty(0, dtype=np.int64)

    @property
    def begin(self) -> NDArray[np.int64]:
        """First iteration of each landmark that no group has used yet; (n,)."""
        return self._begin.values

    @property
    def waiting(self) -> NDArray[np.int64]:
        """Number of observations of each landmark that no group has used yet; (n,)."""
        return self._waiting.values

    @property
    def in_view(self) -> NDArray[np.int64]:
        """Landmarks in view, those missed for a moment included."""
        return self._in_view

    @property
    def oldest_needed(self) -> int | None:
        """First iteration that a landmark in view has waiting; None where nothing is in view."""
        return int(self.begin[self._in_view].min()) if len(self._in_view) else None

    def see(self, landmarks: NDArray[np.int64], iteration: int) -> NDArray[np.int64]:
        """Note who is seen in this iteration; return who has left the view with it."""
        size = int(landmarks.max(initial=-1)) + 1
        if size > len(self._begin):
            self._begin.resize(size, 0)
            self._waiting.resize(size, 0)
            self._sightings.resize(size, iteration)
        last_seen = self._sightings.last
        arrived = landmarks[iteration - last_seen[landmarks] > self._max_missed + 1]
        self._begin.values[arrived] = iteration
        self._waiting.values[arrived] = 0
        self._waiting.values[landmarks] += 1
        self._sightings.see(landmarks, iteration)
        stays = iteration - last_seen[self._in_view] <= self._max_missed
        left = self._in_view[~stays]
        self._in_view = np.concatenate([self._in_view[stays], arrived])
        return left

    def due(self, landmarks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return those of the landmarks that are due, the ones that wait longest first."""
        ready = landmarks[self.is_due(landmarks)]
        return ready[np.lexsort((self.begin[ready], -self._waiting.values[ready]))]

    def is_due(self, landmarks: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which landmarks have enough observations waiting.

        One whose group failed for want of company is due again after as many more.
        """
        waiting = self._waiting.values[landmarks]
        return np.asarray((waiting > 0) & (waiting % self._group_after == 0))

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark go on in place of a new one, which turned out to be it."""
        self.begin[old], self.waiting[old] = self.begin[new], self.waiting[new]
        self._in_view[self._in_view == new] = old

    def grouped(self, landmarks: NDArray[np.int64], end: int) -> None:
        """Note that a group has used the landmarks' observations before iteration `end`."""
        self._begin.values[landmarks] = end
        self._waiting.values[landmarks] = 0
