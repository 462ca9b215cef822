"""Refinement while the map is being built, at a bounded cost.

A chain of groups is nearly as good as can be until landmarks are seen again after a long time; then
the map has drifted on the way, and the drift must be spread over all of it.  So when enough of them
came back one Gauss-Newton step is taken for the whole map.  What was condensed is combined into
a bounded number of rigid bodies, the longer the longer the run, so that a step costs no more in a
long run than in a short one.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid, place_each, sums_each
from relmap.core.geometry.robust import fit_robust_each
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SEEN, CondensedSegments
from relmap.core.refinement.equations import FreeLandmarks, Laid
from relmap.core.refinement.gauss_newton import gauss_newton
from relmap.core.refinement.rows import JointRows, levels_of, numbered
from relmap.core.refinement.settling import size_of
from relmap.core.state.table import NONE

SLICE_EVERY = 8
"""Iterations from one time that there may be something to do to the next."""
GROWTH = 1.15
"""How many times as long a run must be as when the last step was taken."""
SOUND = 0.1
"""How far a step may move a landmark, as a share of the extent of the map."""
BACK = 16
"""Landmarks that must have come back into view before a step is worth while."""
LEAST = 16
"""Segments before the first step, and for which a landmark that closes a loop was out of sight."""
BODIES = 64
"""Bodies at most; of more, each two in a row are laid together."""
WHOLE = 400
"""Segments up to which each is a body of its own in the last step, which need not be quick."""

Seen = tuple[Ints, Floats, Floats]
"""Landmarks (n,), where they are, (n, d), and how much was seen of them, (n,)."""


class LiveRefinement:
    """Keeps the live map near the best that was seen so far.

    Parameters
    ----------
    segments : CondensedSegments
    global_map : GlobalMap
    """

    STATE = "_landmark _points _weight _body _length _most _in_last _begun _noted _back"

    def __init__(self, segments: CondensedSegments, global_map: GlobalMap) -> None:
        self._segments = segments
        self._table = global_map.table
        self._map = global_map
        self._landmark = self._body = np.zeros(0, dtype=np.int64)
        self._points, self._weight = np.zeros((0, 3)), np.zeros(0)
        self._length = 1
        self._most = BODIES
        self._in_last = 0
        self._begun = LEAST
        self._noted = 0
        self._back = 0

    def advance(self) -> bool:
        """Take a step, if it is worth while; tell whether it was taken."""
        self._note()
        if self._back <= BACK or GROWTH * self._begun >= self._noted:
            return False
        self._begun, self._back = self._noted, 0
        self._step(*self._bodies())
        return True

    def complete(self) -> None:
        """Take a step over all there is, as no more is to come."""
        self._note()
        rows = self._segments.rows
        if LEAST < self._noted <= WHOLE:
            landmark = self._table.landmark_of[rows.landmark]
            self._step(landmark, rows.points, rows.n_seen.astype(np.float64), rows.segment)
        elif self._noted > LEAST:
            self._step(*self._bodies())

    def _note(self) -> None:
        """Note which landmarks came back into view after a long time; add to the bodies."""
        rows = self._segments.rows
        first = int(np.searchsorted(rows.segment, self._noted))
        for segment in range(self._noted, rows.n_segments):
            end = int(np.searchsorted(rows.segment, segment, side="right"))
            landmark = self._table.landmark_of[rows.landmark[first:end]]
            last = self._table.last_segment[landmark]
            self._back += int(((last != NONE) & (last < segment - LEAST)).sum())
            self._table.last_segment[landmark] = segment
            weight = SEEN[rows.visible[first:end]].astype(np.float64)
            self._add((landmark, rows.points[first:end], weight))
            first = end
        self._noted = rows.n_segments

    def _add(self, seen: Seen) -> None:
        """Lay a segment on the last body, or let it be a body, where that is full or far off."""
        n_bodies = int(self._body[-1]) + 1 if len(self._body) else 0
        together = None
        if n_bodies and self._in_last < self._length:
            last = self._body == n_bodies - 1
            own = self._landmark[last], self._points[last], self._weight[last]
            together = laid_together(own, seen)
        if together is None:
            self._extend(len(self._body), n_bodies, seen)
            self._in_last = 1
        else:
            self._extend(len(self._body) - int(last.sum()), n_bodies - 1, together)
            self._in_last += 1
        if n_bodies >= self._most:
            self._join()

    def _extend(self, kept: int, body: int, seen: Seen) -> None:
        """Put a body behind so many rows."""
        landmark, points, weight = seen
        before = self._points[:kept] if kept else points[:0]
        self._landmark = np.append(self._landmark[:kept], landmark)
        self._points = np.concatenate([before, points])
        self._weight = np.append(self._weight[:kept], weight)
        self._body = np.append(self._body[:kept], np.full(len(landmark), body))

    def _join(self) -> None:
        """Lay each two bodies in a row together, where they share enough."""
        begin = np.searchsorted(self._body, np.arange(self._body[-1] + 2))
        whole = self._landmark, self._points, self._weight
        bodies = [
            (whole[0][at], whole[1][at], whole[2][at])
            for at in (slice(*of) for of in pairwise(begin))
        ]
        kept = 0
        self._extend(0, 0, (whole[0][:0], whole[1][:0], whole[2][:0]))
        for k in range(0, len(bodies), 2):
            together = laid_together(*bodies[k : k + 2]) if k + 1 < len(bodies) else None
            for seen in bodies[k : k + 2] if together is None else [together]:
                self._extend(len(self._body), kept, seen)
                kept += 1
        # What shares too little is not tried again with each segment.
        self._length *= 2 if kept < len(bodies) else 1
        self._most = max(BODIES, 2 * kept)

    def _bodies(self) -> tuple[Ints, Floats, Floats, Ints]:
        landmark = self._table.landmark_of[self._landmark]
        return landmark, self._points, self._weight, self._body

    def _step(self, landmark: Ints, points: Floats, seen: Floats, body: Ints) -> None:
        """Take a Gauss-Newton step for the submap that is in view, if there is one.

        Parameters
        ----------
        landmark : (n,) int64
        points : (n, d) float64, frame of the body, metres
        seen : (n,) float64
            Observations behind each.
        body : (n,) int64, ascending
        """
        submaps = self._table.submap[landmark]
        mapped = submaps[submaps != NONE]
        if not len(mapped):
            return
        submap = int(mapped[-1])
        rows = np.flatnonzero(submaps == submap)
        there, at = self._table.position[landmark[rows]], body[rows]
        n = int(at[-1]) + 1
        R, t, fixed, weight = fit_robust_each(points[rows], there, seen[rows], at, n)
        placed = place_each(R, t, at, points[rows])
        on = np.flatnonzero(fixed[at])
        bodies, place = numbered(at[on])
        if len(bodies) < 2:
            return
        rows, members = rows[on], numbered(landmark[rows[on]])
        joint = JointRows(
            points[rows],
            np.zeros(len(rows), dtype=np.uint8),
            seen[rows],
            place,
            members[1],
            members[0],
            bodies,
            rows,
        )
        self.move(submap, joint, placed[on], weight[on])

    def move(self, submap: int, rows: JointRows, placed: Floats, weight: Floats) -> None:
        """Move the landmarks, and what was mapped meanwhile along with the latest body.

        A step that leaves the neighbourhood in which it holds, as wrong matches make it, is not
        taken.
        """
        positions, members = self._table.position, rows.landmarks
        level = levels_of(rows.begin, rows.landmark, len(members))[1]
        problem = FreeLandmarks(rows, size_of(positions[members]), level)
        start = Laid(problem.means(placed, weight), placed)
        found = gauss_newton(problem, start, lambda _: weight, 1).state
        moves = found.positions - start.positions
        extent = np.ptp(positions[members], axis=0).max()
        if not np.abs(moves).max() <= SOUND * extent:
            return
        is_other = self._table.submap == submap
        is_other[members] = False
        others = np.flatnonzero(is_other)
        latest = rows.segment == rows.segment[-1]
        R, t = fit_rigid(placed[latest], found.placed[latest])
        self._map.move(others, positions[others] @ R.T + t)
        self._map.move(members, positions[members] + moves)


def laid_together(one: Seen, other: Seen) -> Seen | None:
    """Lay what was seen in one stretch on that of another; None where they share too little."""
    _, mine, its = np.intersect1d(one[0], other[0], return_indices=True)
    if len(mine) < one[1].shape[1]:
        return None
    counts = np.minimum(one[2][mine], other[2][its])
    at = np.zeros(len(mine), dtype=np.int64)
    R, t, fixed, _ = fit_robust_each(other[1][its], one[1][mine], counts, at, 1)
    if not fixed[0]:
        return None
    landmark, of = np.unique(np.append(one[0], other[0]), return_inverse=True)
    weight = np.append(one[2], other[2])
    placed = np.concatenate([one[1], other[1] @ R[0].T + t[0]])
    total = np.bincount(of, weights=weight).astype(np.float64)
    means = sums_each(weight[:, None] * placed, of, len(landmark)) / total[:, None]
    return landmark, means, total
