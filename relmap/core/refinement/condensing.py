"""Condensed segments: short stretches of the run, summarised once.

The run is divided into consecutive segments of a few iterations. Before the iterations of a segment
are forgotten, they are aligned to each other by least squares, independently of groups. What is
kept is the mean position of each landmark, the iterations in which it was seen, and the pose of
each iteration in the segment. This is sufficient for the joint least squares of `refinement`: near
the optimum of a segment, the sum of squares of its observations depends only on the landmark
positions and the visibility.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.motions import transforms
from relmap.core.state.growing import GrowingArray
from relmap.core.state.store import ObservationStore

ROOM = 2**22
"""Initial capacity, in rows of segments."""
LENGTH = 8
"""Iterations in a segment: one bit each in the landmarks' visibility."""
RECENT = 64
"""Number of earlier segments that give the usual noise: few observations may agree by chance."""
NOWHERE = -1
"""Marks an iteration that saw too little to belong to a segment."""

SEEN = np.array([number.bit_count() for number in range(1 << LENGTH)])
"""Number of iterations in each visibility pattern."""


@dataclass(frozen=True, eq=False)
class SegmentRows:
    """Condensed segments as a structure of arrays: one row per landmark and segment.

    `landmark` (n,): number at the time of observation, which merging may have changed; `segment`
    (n,), ascending; `points` (n, d), segment frame, metres; `visible` (n,): bit k: seen in
    iteration ``first_iteration + k`` of its segment; `first_iteration` (s,); `squares` (s,), square
    metres: sum of the squared deviations of a segment's observations from its points, without
    landmarks known to move, and `freedoms` (s,), its degrees of freedom; `iteration_segment` (i,):
    segment of each iteration, or `NOWHERE`; `R` (i, d, d), `t` (i, d), metres: pose of each
    iteration, robot frame to segment frame.
    """

    landmark: Ints
    segment: Ints
    points: Floats
    visible: NDArray[np.uint8]
    first_iteration: Ints
    squares: Floats
    freedoms: Ints
    iteration_segment: Ints
    R: Floats
    t: Floats

    def only(self, kept: Ints) -> SegmentRows:
        """Return some of the rows (k,), by ascending segment, and all segments and iterations."""
        names = "landmark", "segment", "points", "visible"
        return replace(self, **{name: getattr(self, name)[kept] for name in names})

    @property
    def n_seen(self) -> Ints:
        """Number of observations behind each row; (n,)."""
        return SEEN[self.visible]

    @property
    def sightings(self) -> tuple[Ints, Ints]:
        """Row and iteration of each single observation, by row; (k,) each."""
        row, bit = np.nonzero((self.visible[:, None] >> np.arange(LENGTH)) & 1)
        return row, self.first_iteration[self.segment[row]] + bit

    @property
    def noise_m(self) -> float:
        """Standard deviation of an observed coordinate within segments, metres; NaN if unknown."""
        return _noise_of(self.squares, self.freedoms)

    @property
    def n_segments(self) -> int:
        """Number of segments."""
        return len(self.squares)

    @property
    def base(self) -> Ints:
        """First iteration that belongs to each segment; (s,)."""
        inside = np.flatnonzero(self.iteration_segment != NOWHERE)
        return inside[np.unique(self.iteration_segment[inside], return_index=True)[1]]

    @property
    def poses(self) -> Floats:
        """Pose of each iteration in the frame of its segment, metres; (i, 4, 4)."""
        return transforms(self.R, self.t)


class CondensedSegments:
    """Condenses iterations as they leave the store; each observation counts exactly once.

    `noise_spread`: as for `Averaging`. Where it is larger than 1, noise explains most outliers.
    """

    STATE = " ".join(f"_{field.name}" for field in fields(SegmentRows))

    def __init__(self, noise_spread: float = 1.0) -> None:
        self._noise_spread = noise_spread
        self._landmark: GrowingArray[np.int64] = GrowingArray(np.int64, room=ROOM)
        self._segment: GrowingArray[np.int64] = GrowingArray(np.int64, room=ROOM)
        self._points: GrowingArray[np.float64] = GrowingArray(np.float64, (0,), ROOM)
        self._visible: GrowingArray[np.uint8] = GrowingArray(np.uint8, room=ROOM)
        self._first_iteration: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._squares: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._freedoms: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._iteration_segment: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._R: GrowingArray[np.float64] = GrowingArray(np.float64, (0, 0))
        self._t: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))

    @property
    def end(self) -> int:
        """The first iteration that is not condensed yet."""
        return len(self._iteration_segment)

    @property
    def rows(self) -> SegmentRows:
        """All condensed rows, as views that are valid until more are added."""
        arrays = (getattr(self, f"_{field.name}") for field in fields(SegmentRows))
        return SegmentRows(*(array.values for array in arrays))

    def condense(self, store: ObservationStore, before: int, dynamic: Bools) -> bool:
        """Condense the next segment if it is complete before an iteration; return whether.

        `store`: contains the iterations from `end` on. `dynamic` (m,): landmarks known to move;
        they do not influence the poses of the iterations.
        """
        if self.end + LENGTH > before:
            return False
        self._condense(store, self.end + LENGTH, dynamic)
        return True

    def with_rest(self, store: ObservationStore, dynamic: Bools) -> SegmentRows:
        """Return the rows of all iterations, including those still in the store.

        The latter are condensed anew each time: the last segment may be incomplete.
        """
        whole = deepcopy(self)
        while whole.end < store.n_iterations:
            whole._condense(store, min(whole.end + LENGTH, store.n_iterations), dynamic)
        return whole.rows

    def _condense(self, store: ObservationStore, end: int, dynamic: Bools) -> None:
        import relmap.core.refinement.segment_kernels as kernels

        begin, k, d = self.end, end - self.end, store.dimension
        self._make_room(k, d)
        present, _, block = store.seen_with(-1, begin, end)
        steady = ~dynamic[store.now(present)]
        moves = np.count_nonzero(steady) < len(steady)
        own, landmarks = (block[steady], present[steady]) if moves else (block, present)
        free = np.ones(k, dtype=bool)
        while np.count_nonzero(free):
            joined, R, t, seen, is_doubtful = kernels.align_iterations(own, free)
            if is_doubtful and self._noise_spread > 1:
                kernels.trim_outliers(own, seen, joined, R, t)
            elif is_doubtful:
                import relmap.core.refinement.robust_segment_kernels as robust

                recent = slice(-RECENT, None)
                usual_m = _noise_of(self._squares.values[recent], self._freedoms.values[recent])
                joined, R, t = robust.align_robustly(own, seen, joined, np.nan_to_num(usual_m))
            points, visible, squares, freedoms = kernels.condensed(own, joined, R, t, seen)
            if not np.count_nonzero(joined):
                break
            free &= ~joined
            is_sound = np.isfinite(squares)  # no gross outliers displaced the iterations
            self._squares.append(squares if is_sound else 0.0)
            self._freedoms.append(freedoms if is_sound else 0)
            at = begin + np.flatnonzero(joined)
            self._iteration_segment.values[at] = len(self._squares) - 1
            self._R.values[at], self._t.values[at] = R[joined], t[joined]
            self._enter(begin, landmarks, points, visible)
            if moves:
                self._enter(begin, present[~steady], *_means(block[~steady], joined, R, t))

    def _enter(
        self, begin: int, landmarks: Ints, points: Floats, visible: NDArray[np.uint8]
    ) -> None:
        """Append rows of the latest segment."""
        there = visible.nonzero()[0]  # `take` is several times as fast as indexing by a mask
        self._landmark.extend(landmarks.take(there))
        self._segment.resize(len(self._landmark), len(self._squares) - 1)
        self._points.extend(points.take(there, axis=0))
        self._visible.extend(visible.take(there))
        if len(self._first_iteration) < len(self._squares):
            self._first_iteration.append(begin)

    def _make_room(self, k: int, d: int) -> None:
        """Reserve space for k more iterations, in d dimensions from now on."""
        if self._t.values.shape[1] != d:
            self._points = GrowingArray(np.float64, (d,), ROOM)
            self._R, self._t = GrowingArray(np.float64, (d, d)), GrowingArray(np.float64, (d,))
        self._iteration_segment.resize(self.end + k, NOWHERE)
        self._R.resize(self.end, np.nan)
        self._t.resize(self.end, np.nan)


def _noise_of(squares: Floats, freedoms: Ints) -> float:
    """Return the standard deviation of a coordinate, metres, of segments (s,); NaN if unknown."""
    some = freedoms > 0
    if not np.any(some):
        return np.nan
    # The median of chi-square over its mean (Wilson and Hilferty, 1931).
    typical = freedoms[some] * (1 - 2 / (9 * freedoms[some])) ** 3
    return float(np.sqrt(np.median(squares[some] / typical)))


def seen_from_first(rows: SegmentRows) -> tuple[Ints, Floats, Ints, Floats]:
    """Return segments as scans, each made in the first iteration of its segment.

    Landmarks (n,), positions (n, d), robot frame, metres, iterations (n,), ascending, and numbers
    of observations (n,).
    """
    at = rows.base[rows.segment]
    location = np.einsum("nji,nj->ni", rows.R[at], rows.points - rows.t[at])
    order = np.argsort(at, kind="stable")
    n_seen = rows.n_seen[order].astype(np.float64)
    return rows.landmark[order], location[order], at[order], n_seen


def _means(block: Floats, joined: Bools, R: Floats, t: Floats) -> tuple[Floats, NDArray[np.uint8]]:
    """Return mean positions (n, d) and visibility (n,) of landmarks not used in the fit."""
    seen = np.isfinite(block[:, :, 0]) & joined
    placed = np.where(seen[:, :, None], np.einsum("kab,nkb->nka", R, block) + t, 0.0)
    means = placed.sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
    seen &= np.isfinite(means).all(axis=1)[:, None]
    return means, np.packbits(seen, axis=1, bitorder="little")[:, 0]
