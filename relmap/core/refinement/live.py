"""Refinement while the map is being built, in small slices at a constant amortised cost.

A chain of groups is nearly as good as can be until landmarks are seen again after a long time; then
the map has drifted on the way, and the drift must be spread over all of it.  So when enough of them
came back one Gauss-Newton step is taken for the whole map, with one placement for each segment; see
`refinement`.  Each update does a slice of it.  As a step costs the more the longer the run, the
next is taken the later: when the run has become longer by a share.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from relmap.core.geometry.robust import fit_robust_each
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SEEN, CondensedSegments, SegmentRows
from relmap.core.refinement.slices import SLICE, StepInSlices
from relmap.core.state.table import NONE, LandmarkState

SLICE_EVERY = 8
"""Iterations for each slice."""
GROWTH = 1.15
"""How many times as long a run must be as when the last step was begun."""
SOUND = 0.1
"""How far a step may move a landmark, as a share of the extent of the map."""
BACK = 16
"""Landmarks that must have come back into view before a step is worth while."""
LEAST = 16
"""Segments before the first step, and for which a landmark that closes a loop was out of sight."""
SMALL, MOST = 45000, 6
"""Rows of all segments up to which more slices than one are done at a time, and how many."""
Points = NDArray[np.float64]
Indices = NDArray[np.int64]


class StepUnderWay:
    """A step, slice by slice: segments are laid on the map as it is, then the step is solved for.

    How much of the solution is done is known as a number of slices, so that a copy can do them
    again.

    Parameters
    ----------
    submap : int
        That is refined.
    member : int
        A landmark of it: where that has come to another submap, the step is of no use.
    n_rows : int
        Rows of segments that take part.
    step : StepInSlices
    """

    STATE = "submap member step _n_rows _first _n_solved"

    def __init__(self, submap: int, member: int, n_rows: int, step: StepInSlices) -> None:
        self.submap = submap
        self.member = member
        self.step = step
        self._n_rows = n_rows
        self._first = 0
        self._n_solved = 0
        self._solving: Iterator[None] | None = None

    def __getstate__(self) -> dict[str, object]:
        """Leave out the solution so far: a copy does its slices again."""
        return self.__dict__ | {"_solving": None}

    def go_on(self, segments: CondensedSegments, table: LandmarkState) -> bool:
        """Do a slice; tell whether it was the last."""
        if self._first < self._n_rows:
            self._lay_on(segments.rows, table)
            return False
        if self._solving is None:
            self._solving = self.step.run()
            for _ in range(self._n_solved):
                next(self._solving)
        self._n_solved += 1
        return bool(next(self._solving, True))

    def _lay_on(self, rows: SegmentRows, table: LandmarkState) -> None:
        """Lay some segments on the map."""
        first, segments = self._first, rows.segment[: self._n_rows]
        last = segments[min(first + SLICE, self._n_rows) - 1]
        end = int(np.searchsorted(segments, last, side="right"))
        landmark = table.landmark_of[rows.landmark[first:end]]
        kept = table.submap[landmark] == self.submap
        kept &= landmark < self.step.n_landmarks  # what merged into one first seen since then waits
        landmark, segment = landmark[kept], segments[first:end][kept]
        points = rows.points[first:end][kept]
        seen = SEEN[rows.visible[first:end][kept]].astype(np.float64)
        base = segments[first]
        there = table.position[landmark]
        at, n = segment - base, int(last - base) + 1
        R, t, fixed, weight = fit_robust_each(points, there, seen, at, n)
        placed = np.einsum("nij,nj->ni", R[at], points) + t[at]
        on = fixed[at]
        self.step.add(placed[on], landmark[on], segment[on], (weight * seen)[on])
        self._first = end


class LiveRefinement:
    """Keeps the live map near the best that was seen so far.

    Parameters
    ----------
    segments : CondensedSegments
    global_map : GlobalMap
    """

    _step: StepUnderWay | None
    STATE = "_step _begun _noted _back"

    def __init__(self, segments: CondensedSegments, global_map: GlobalMap) -> None:
        self._segments = segments
        self._table = global_map.table
        self._map = global_map
        self._step = None
        self._begun = LEAST
        self._noted = 0
        self._back = 0

    def blank(self) -> StepUnderWay:
        """Return a step to be restored."""
        return StepUnderWay(NONE, NONE, 0, StepInSlices(0, 0, 0, self._table.dimension))

    def advance(self) -> bool:
        """Do a slice of work, if there is any; tell whether it has moved the map."""
        self._note()
        if self._step is None:
            n = self._segments.rows.n_segments
            if self._back <= BACK or GROWTH * self._begun >= n:
                return False
            self._step = self._begin()
            if self._step is None:
                return True
        # The slices of a short run are small.
        for _ in range(np.clip(SMALL // len(self._segments.rows.segment), 1, MOST)):
            if self._go_on():
                return True
        return False

    def complete(self) -> None:
        """Take a whole step over all there is, as no more is to come."""
        self._note()
        if self._segments.rows.n_segments > LEAST:
            self._step = self._begin()
        while self._step is not None:
            self._go_on()

    def _go_on(self) -> bool:
        """Do a slice of the step under way; tell whether it was the last and has moved the map."""
        if self._step is None or not self._step.go_on(self._segments, self._table):
            return False
        self._apply(self._step)
        self._step = None
        return True

    @property
    def is_busy(self) -> bool:
        """Whether a step is under way."""
        return self._step is not None

    def _note(self) -> None:
        """Note which landmarks came back into view after a long time."""
        rows = self._segments.rows
        if rows.n_segments == self._noted:
            return
        first = int(np.searchsorted(rows.segment, self._noted))
        self._noted = rows.n_segments
        landmark, at = self._table.landmark_of[rows.landmark[first:]], rows.segment[first:]
        last = self._table.last_segment[landmark]
        self._back += int(((last != NONE) & (last < at - LEAST)).sum())
        self._table.last_segment[landmark] = at

    def _begin(self) -> StepUnderWay | None:
        """Begin a Gauss-Newton step for the submap that is in view, if there is one."""
        rows = self._segments.rows
        self._begun, self._back = rows.n_segments, 0
        submap = self._submap_in_view(rows)
        if submap == NONE:
            return None
        n_rows = len(rows.segment)
        size = n_rows, len(self._table), rows.n_segments
        step = StepInSlices(*size, rows.points.shape[1])
        return StepUnderWay(submap, int(np.argmax(self._table.submap == submap)), n_rows, step)

    def _submap_in_view(self, rows: SegmentRows) -> int:
        submaps = self._table.submap[self._table.landmark_of[rows.landmark[-SLICE:]]]
        mapped = submaps[submaps != NONE]
        return int(mapped[-1]) if len(mapped) else NONE

    def _apply(self, done: StepUnderWay) -> None:
        """Move the landmarks, and what was mapped meanwhile along with the latest segment.

        A step that leaves the neighbourhood in which it holds, as wrong matches make it, is not
        taken.
        """
        submap, step = done.submap, done.step
        positions, members = self._table.position, step.members
        if self._table.submap[done.member] != submap or not len(members):
            return
        extent = np.ptp(positions[members], axis=0).max()
        if not np.abs(step.moves).max() <= SOUND * extent:
            return
        is_other = self._table.submap == submap
        is_other[members] = False
        others = np.flatnonzero(is_other)
        turn, shift, centre = step.latest
        self._map.move(others, (positions[others] - centre) @ turn.T + centre + shift)
        self._map.move(members, positions[members] + step.moves)
