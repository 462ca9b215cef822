"""Refinement while the map is being built, in small slices at a constant amortised cost.

A chain of groups is nearly as good as can be until landmarks are seen again after a long time; then
the map has drifted on the way, and the drift must be spread over all of it.  So when enough of them
came back one Gauss-Newton step is taken for the whole map, with one placement for each segment; see
`refinement`.  Each update does a slice of it.  As a step costs the more the longer the run, the
next is taken the later: when the run has become longer by a share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid_each
from relmap.core.condensing import CondensedSegments, SegmentRows
from relmap.core.globalmap import UNMAPPED, GlobalMap
from relmap.core.growing import GrowingArray
from relmap.core.slices import SLICE, StepInSlices

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


class LiveRefinement:
    """Keeps the live map near the best that was seen so far.

    Parameters
    ----------
    segments : CondensedSegments
    global_map : GlobalMap
    """

    def __init__(self, segments: CondensedSegments, global_map: GlobalMap) -> None:
        self._segments = segments
        self._map = global_map
        self._work: Iterator[None] | None = None
        self._begun = LEAST
        self._noted = 0
        self._back = 0
        self._last: GrowingArray[np.int64] = GrowingArray(np.int64)

    def advance(self, of: Callable[[Indices], Indices]) -> bool:
        """Do a slice of work, if there is any; tell whether it has moved the map.

        Parameters
        ----------
        of : callable
            The landmark that each number stands for, after merging.
        """
        self._note(of)
        if self._work is None:
            n = self._segments.rows.n_segments
            if self._back <= BACK or GROWTH * self._begun >= n:
                return False
            self._begun, self._back = n, 0
            self._work = self._step(of)
        # The slices of a short run are small.
        for _ in range(np.clip(SMALL // len(self._segments.rows.segment), 1, MOST)):
            if next(self._work, True):
                self._work = None
                return True
        return False

    @property
    def is_busy(self) -> bool:
        """Whether a step is under way."""
        return self._work is not None

    def __getstate__(self) -> dict[str, object]:
        """Leave out the step that is under way: a copy takes its own."""
        return self.__dict__ | {"_work": None}

    def _note(self, of: Callable[[Indices], Indices]) -> None:
        """Note which landmarks came back into view after a long time."""
        rows = self._segments.rows
        if rows.n_segments == self._noted:
            return
        first = int(np.searchsorted(rows.segment, self._noted))
        self._noted = rows.n_segments
        self._last.resize(len(self._map.pieces), rows.n_segments)
        landmark, at = of(rows.landmark[first:]), rows.segment[first:]
        self._back += int((self._last.values[landmark] < at - LEAST).sum())
        self._last.values[landmark] = at

    def _step(self, of: Callable[[Indices], Indices]) -> Iterator[None]:
        """Take a Gauss-Newton step for the piece that is in view, slice by slice."""
        rows = self._segments.rows
        piece = self._piece_in_view(rows, of)
        if piece == UNMAPPED:
            return
        member = int(np.argmax(self._map.pieces == piece))
        size = len(rows.segment), len(self._map.pieces), rows.n_segments
        step = StepInSlices(*size, rows.points.shape[1])
        for part in self._laid_on(rows, of, piece):
            step.add(*part)
            yield
        yield from step.run()
        if self._map.pieces[member] == piece:
            self._apply(piece, step)

    def _piece_in_view(self, rows: SegmentRows, of: Callable[[Indices], Indices]) -> int:
        pieces = self._map.pieces[of(rows.landmark[-SLICE:])]
        mapped = pieces[pieces != UNMAPPED]
        return int(mapped[-1]) if len(mapped) else UNMAPPED

    def _laid_on(
        self, rows: SegmentRows, of: Callable[[Indices], Indices], piece: int
    ) -> Iterator[tuple[Points, Indices, Indices, Points]]:
        """Lay segments on the map, some at a time; give places, landmarks, segments and weights."""
        first = 0
        while first < len(rows.segment):
            last = rows.segment[min(first + SLICE, len(rows.segment)) - 1]
            end = int(np.searchsorted(rows.segment, last, side="right"))
            landmark = of(rows.landmark[first:end])
            kept = self._map.pieces[landmark] == piece
            landmark, segment = landmark[kept], rows.segment[first:end][kept]
            points = rows.points[first:end][kept]
            seen = rows.n_seen[first:end][kept].astype(np.float64)
            base = rows.segment[first]
            there = self._map.positions[landmark]
            R, t, fixed = fit_rigid_each(points, there, seen, segment - base, int(last - base) + 1)
            placed = np.einsum("nij,nj->ni", R[segment - base], points) + t[segment - base]
            on = fixed[segment - base]
            yield placed[on], landmark[on], segment[on], seen[on]
            first = end

    def _apply(self, piece: int, step: StepInSlices) -> None:
        """Move the landmarks, and what was mapped meanwhile along with the latest segment.

        A step that leaves the neighbourhood in which it holds, as wrong matches make it, is not
        taken.
        """
        positions, members = self._map.positions, step.members
        if not len(members):
            return
        extent = np.ptp(positions[members], axis=0).max()
        if not np.abs(step.moves).max() <= SOUND * extent:
            return
        is_other = self._map.pieces == piece
        is_other[members] = False
        others = np.flatnonzero(is_other)
        turn, shift, centre = step.latest
        self._map.move(others, (positions[others] - centre) @ turn.T + centre + shift)
        self._map.move(members, positions[members] + step.moves)
