"""Refinement during mapping, at bounded cost.

A chain of groups is nearly optimal until landmarks are re-observed after a long time; the
accumulated drift must then be distributed over the map. So when enough landmarks are back in view,
one Gauss-Newton step is taken for the whole map. Condensed segments are merged into a bounded
number of rigid bodies, which get longer with the run, so that the cost of a step is bounded. The
landmarks that they share are eliminated.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid, place_each, sums_each
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.geometry.robust import fit_robust_each
from relmap.core.linalg.threads import one_thread
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SEEN, CondensedSegments
from relmap.core.refinement.equations import HOLD
from relmap.core.refinement.rows import numbered
from relmap.core.state.table import NONE

SLICE_EVERY = 8
"""Minimum iterations between attempts."""
GROWTH = 1.15
"""Factor by which the run must have grown since the last step."""
SOUND = 0.1
"""Largest movement of a landmark in a step, as a fraction of the extent of the map."""
BACK = 16
"""Landmarks that must be back in view before a step is worthwhile."""
LEAST = 16
"""Minimum number of segments before the first step, and of segments out of sight for a landmark to
close a loop."""
BODIES = 32
"""Maximum number of bodies; beyond it, pairs of consecutive bodies are merged."""
WHOLE = 400
"""Segments up to which each is a separate body in the last step, which is not time-critical."""


@dataclass(frozen=True, eq=False)
class Body:
    """Segments merged into one rigid body.

    `landmark` (n,); `points` (n, d), metres: their positions, frame of the body; `weight` (n,):
    number of observations of each; `n_segments`: number of segments.
    """

    landmark: Ints
    points: Floats
    weight: Floats
    n_segments: int = 1


class LiveRefinement:
    """Keeps the live map near the optimum of all observations so far."""

    _bodies: list[Body]
    STATE = "_bodies _length _most _begun _noted _back"

    def __init__(self, segments: CondensedSegments, global_map: GlobalMap) -> None:
        self._segments = segments
        self._table = global_map.table
        self._map = global_map
        self._bodies = []
        self._length = 1
        self._most = BODIES
        self._begun = LEAST
        self._noted = 0
        self._back = 0

    def advance(self) -> bool:
        """Take a step if worthwhile; return whether it was taken."""
        self._note()
        if self._back <= BACK or GROWTH * self._begun >= self._noted:
            return False
        self._begun, self._back = self._noted, 0
        with one_thread():
            self._step(*self._rows())
        return True

    def complete(self) -> None:
        """Take a step over everything, as no more scans will come."""
        self._note()
        rows = self._segments.rows
        if LEAST < self._noted <= WHOLE:
            landmark = self._table.landmark_of[rows.landmark]
            self._step(landmark, rows.points, rows.n_seen.astype(np.float64), rows.segment)
        elif self._noted > LEAST:
            self._step(*self._rows())

    def _note(self) -> None:
        """Record which landmarks came back into view after a long time; extend the bodies."""
        rows = self._segments.rows
        first = int(rows.segment.searchsorted(self._noted))
        for segment in range(self._noted, rows.n_segments):
            end = int(rows.segment.searchsorted(segment, side="right"))
            landmark = self._table.landmark_of[rows.landmark[first:end]]
            last = self._table.last_segment[landmark]
            self._back += int(np.count_nonzero((last != NONE) & (last < segment - LEAST)))
            self._table.last_segment[landmark] = segment
            weight = SEEN[rows.visible[first:end]].astype(np.float64)
            self._add(Body(landmark, rows.points[first:end].copy(), weight))
            first = end
        self._noted = rows.n_segments

    def _add(self, seen: Body) -> None:
        """Add a segment, and merge the last two bodies while they are as long as each other.

        Up to the length of a body. So a segment is merged again only when its body doubles.
        """
        self._bodies.append(seen)
        while len(self._bodies) > 1:
            one, other = self._bodies[-2:]
            if one.n_segments != other.n_segments or 2 * one.n_segments > self._length:
                break
            together = merged(one, other)
            if together is None:
                break
            self._bodies[-2:] = [together]
        if len(self._bodies) >= self._most:
            self._join()

    def _join(self) -> None:
        """Merge pairs of consecutive bodies that share enough landmarks."""
        before, self._bodies = self._bodies, []
        for k in range(0, len(before), 2):
            pair = before[k : k + 2]
            together = merged(*pair) if len(pair) == 2 else None
            self._bodies += pair if together is None else [together]
        # Pairs that share too little are not retried with each segment.
        self._length *= 2 if len(self._bodies) < len(before) else 1
        self._most = max(BODIES, 2 * len(self._bodies))

    def _rows(self) -> tuple[Ints, Floats, Floats, Ints]:
        """Return landmarks, points, weights and bodies of all rows, as `_step` takes them."""
        bodies = self._bodies
        landmark = self._table.landmark_of[np.concatenate([body.landmark for body in bodies])]
        points = np.concatenate([body.points for body in bodies])
        weight = np.concatenate([body.weight for body in bodies])
        sizes = [len(body.landmark) for body in bodies]
        return landmark, points, weight, np.repeat(np.arange(len(bodies)), sizes)

    def _step(self, landmark: Ints, points: Floats, seen: Floats, body: Ints) -> None:
        """Take a Gauss-Newton step for the submap in view, if there is one.

        `landmark` (n,); `points` (n, d), frame of the body, metres; `seen` (n,): number of
        observations of each; `body` (n,), ascending.
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
        on = np.flatnonzero(fixed[at])
        bodies, place = numbered(at[on])
        if len(bodies) < 2:
            return
        placed = place_each(R, t, at[on], points[rows[on]])
        members, of = numbered(landmark[rows[on]])
        self.move(submap, members, placed, seen[rows[on]] * weight[on], of, place)

    def move(
        self, submap: int, members: Ints, placed: Floats, weight: Floats, of: Ints, body: Ints
    ) -> None:
        """Move the landmarks; landmarks mapped in the meantime move with the latest body.

        A step outside the range of validity of the linearisation, as wrong matches cause, is
        rejected. `members` (m,): landmarks; the others as for `after_step`.
        """
        positions, after = self._table.position, after_step(placed, weight, of, body)
        total = np.bincount(of, weights=weight)[:, None]
        moves = sums_each(weight[:, None] * (after - placed), of, len(members)) / total
        extent = np.ptp(positions[members], axis=0).max()
        if not np.abs(moves).max() <= SOUND * extent:
            return
        is_other = self._table.submap == submap
        is_other[members] = False
        others = np.flatnonzero(is_other)
        latest = body == body[-1]
        R, t = fit_rigid(placed[latest], after[latest])
        self._map.move(others, positions[others] @ R.T + t)
        self._map.move(members, positions[members] + moves)


def merged(one: Body, other: Body) -> Body | None:
    """Align one body to another and merge them; None if they share too little."""
    import relmap.core.refinement.live_kernels as kernels

    (n, d), listed = one.points.shape, np.concatenate([one.landmark, other.landmark])
    landmark, of, (mine, its) = kernels.united(listed, listed.argsort(kind="stable"), n)
    if len(mine) < d:
        return None
    its = its - n
    counts = np.minimum(one.weight[mine], other.weight[its])
    R, t, fixed, _ = fit_robust_each(other.points[its], one.points[mine], counts, 0 * mine, 1)
    if not fixed[0]:
        return None
    weight = np.concatenate([one.weight, other.weight])
    placed = np.concatenate([one.points, other.points @ R[0].T + t[0]])
    means, total = kernels.averages(placed, weight, of, len(landmark))
    return Body(landmark, means, total, one.n_segments + other.n_segments)


def after_step(points: Floats, weight: Floats, landmark: Ints, body: Ints) -> Floats:
    """Return the points (n, d) of bodies after one Gauss-Newton step of their placements.

    A landmark is at the weighted mean of its points. The first body is fixed. Since Jacobians are
    linear in the points, sums of their products follow from second moments. A step that increases
    the cost is not taken: without noise it would follow rounding errors.

    `points` (n, d), map frame, metres; `weight` (n,); `landmark` (n,): 0 to m - 1; `body` (n,),
    ascending: 0 to b - 1.
    """
    from relmap.core.refinement.live_kernels import moments_between

    b, d, q = int(body[-1]) + 1, points.shape[1], 3 * points.shape[1] - 3
    centre = sums_each(points, body, b) / np.bincount(body)[:, None]
    away = points - centre[body]
    total = np.bincount(landmark, weights=weight).astype(np.float64)
    pull, cost = _pulls(points, weight, total, landmark)
    columns = np.column_stack([away, np.ones(len(away))])  # the Jacobians are linear in them
    constant = derivatives(np.zeros((1, d)))
    by_step = np.concatenate([derivatives(np.eye(d)) - constant, constant])
    ends = np.searchsorted(body, np.arange(b + 1)).tolist()
    force = np.stack([columns[i:j].T @ pull[i:j] for i, j in pairwise(ends)])
    right = np.einsum("npa,pau->nu", force, by_step).ravel()
    begin = np.append(0, np.cumsum(np.bincount(landmark)))
    order = np.argsort(landmark, kind="stable")
    moments = moments_between(columns, weight, body, begin, order, b)
    products = np.einsum("pau,qav->pquv", by_step, by_step).reshape((d + 1) ** 2, q * q)
    matrix = (moments.reshape(b * b, -1) @ products).reshape(b, b, q, q)
    matrix = matrix.swapaxes(1, 2).reshape(b * q, b * q)
    least = HOLD[1] + HOLD[0] * matrix.diagonal().max()
    free = matrix[q:, q:] + least * np.eye(b * q - q)
    steps = np.append(np.zeros(q), np.linalg.solve(free, right[q:])).reshape(b, q)
    after = place_each(rotations(steps[:, :-d]), steps[:, -d:], body, away) + centre[body]
    return after if _pulls(after, weight, total, landmark)[1] <= cost else points


def _pulls(points: Floats, weight: Floats, total: Floats, landmark: Ints) -> tuple[Floats, float]:
    """Return the weighted vectors (n, d) from points to the means of their landmarks, and the cost.

    The cost is the weighted sum of the squared distances.
    """
    means = sums_each(weight[:, None] * points, landmark, len(total)) / total[:, None]
    apart = means[landmark] - points
    pull = weight[:, None] * apart
    return pull, float(np.sum(pull * apart))
