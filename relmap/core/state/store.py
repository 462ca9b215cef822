"""Every landmark's past observations, untransformed (Fig. 3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.state.growing import FEW, MANY, GrowingArray
from relmap.core.state.table import LandmarkState

Rows = dict[str, NDArray[Any]]
"""Columns of observations; each kind has `landmark` and `location`."""
POINTS: Rows = {"landmark": np.empty(0, dtype=np.int64), "location": np.empty((0, 0))}
"""The columns of points, with no rows."""


class Shown(NamedTuple):
    """The static points that some observations show.

    `landmarks` (k,); `points_robot` (k, d), robot frame, metres. `per_row` (n,): number of points
    that each observation shows; None if each shows one.
    """

    landmarks: Ints
    points_robot: Floats
    per_row: Ints | None = None


def shown_points(rows: Rows) -> Shown:
    """Return the points shown by observations of points: the observations themselves."""
    return Shown(rows["landmark"], rows["location"])


class ObservationStore:
    """Observations in the robot frame, untransformed: one row each, in order of iteration.

    The paper keeps a table of iterations per landmark.  Here one structure of arrays holds them in
    order of arrival for all landmarks: a block of members by iterations is gathered in time
    proportional to the number of observations in those iterations, independent of the size of the
    map.

    `columns`: the columns of an observation, without rows. `show`: returns the static points that
    rows show; see `relmap.core.model.LandmarkModel`. `keeps`: whether rows are kept after the last
    group that needs them. `table`: of the landmarks. Rows keep the numbers under which landmarks
    were seen, so that a merge can be undone; they are read as the landmarks of the table.

    Attributes: `first_iteration`: the first one that is not forgotten.
    """

    _columns: dict[str, GrowingArray[Any]]
    STATE = "_columns _offsets _stored_from first_iteration"

    def __init__(
        self,
        columns: Rows | None = None,
        show: Callable[[Rows], Shown] = shown_points,
        keeps: bool = False,
        table: LandmarkState | None = None,
    ) -> None:
        self._keeps = keeps
        self._table = table
        self._show = show
        room = MANY if keeps else FEW
        self._columns = {
            name: GrowingArray(rows.dtype, rows.shape[1:], room)
            for name, rows in (columns or POINTS).items()
        }
        self._offsets: GrowingArray[np.int64] = GrowingArray(np.int64, room=FEW)
        self._offsets.extend(np.zeros(1, dtype=np.int64))
        self._slots: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._stored_from = 0
        self.first_iteration = 0
        self._dimension = 0

    @property
    def dimension(self) -> int:
        """2 in a planar world, 3 in space, 0 before any observation."""
        if not self._dimension:
            none = self.points(self.first_iteration, self.first_iteration)
            self._dimension = int(none.shape[1])
        return self._dimension

    @property
    def n_iterations(self) -> int:
        """Number of iterations, including empty and forgotten ones."""
        return self._stored_from + len(self._offsets) - 1

    @property
    def iterations(self) -> Ints:
        """Iteration of each stored observation; (n,) ascending."""
        return self.between(self._stored_from, self.n_iterations)[1]

    def rows(self, iteration: int) -> slice:
        """Return the rows of one iteration."""
        return self._rows(iteration, iteration + 1)[0]

    def between(self, begin: int, end: int) -> tuple[slice, Ints]:
        """Return the rows of iterations `begin` to `end`, and their iterations."""
        rows, offsets = self._rows(begin, end)
        return rows, np.repeat(np.arange(begin, end), np.diff(offsets))

    def column(self, name: str) -> NDArray[Any]:
        """Return a column (n, ...) of all observations stored, in order of iteration."""
        return self._columns[name].values

    def append(self, landmark: Ints, location: Floats, **others: NDArray[Any]) -> None:
        """Store one iteration: landmarks and locations of n observations, and further columns."""
        if len(landmark):
            for name, values in {"landmark": landmark, "location": location, **others}.items():
                self._columns[name].extend(values)
        self._offsets.append(self._offsets.values[-1] + len(landmark))

    def forget(self, before: int) -> None:
        """Forget the iterations before one; their rows are dropped or kept."""
        n = before - self.first_iteration
        if n <= 0:
            return
        self.first_iteration = before
        if not self._keeps:
            rows = int(self._offsets.values[n] - self._offsets.values[0])
            for column in self._columns.values():
                column.drop(rows)
            self._offsets.drop(n)
            self._stored_from = before

    def now(self, landmarks: Ints) -> Ints:
        """Return the landmarks (n,) that stored numbers stand for after merging."""
        return landmarks if self._table is None else self._table.now(landmarks)

    def seen(self, begin: int, end: int) -> tuple[Ints, Ints]:
        """Return landmark and iteration of every point shown in iterations `begin` to `end`."""
        shown, offsets = self._shown(begin, end)
        seen = self.now(shown.landmarks)
        return seen, np.repeat(np.arange(begin, end), np.diff(offsets))

    def points(self, begin: int, end: int) -> Floats:
        """Return every point (k, d) shown in iterations `begin` to `end`, ordered as in `seen`."""
        return self._shown(begin, end)[0].points_robot

    def seen_with(self, seed: int, begin: int, end: int) -> tuple[Ints, Ints, Floats]:
        """Return all observations of those iterations from `begin` to `end` that show a seed.

        `seed`: -1 for those of all iterations, by the numbers under which they were seen. Returns
        `landmarks` (n,): the seed, then the others, ascending, `iterations` (i,), ascending and
        `block` (n, i, d), robot frame, metres: NaN where missing.
        """
        import relmap.core.grouping.chart_kernels as kernels

        shown, offsets = self._shown(begin, end)
        seen = shown.landmarks if seed < 0 else self.now(shown.landmarks)
        last = int(seen[seen.argmax()]) if len(seen) else -1
        self._slots.resize(max(seed, last) + 1, -1)
        slots = self._slots.values
        landmarks, columns = kernels.seen_with(seen, offsets, seed, slots)
        landmarks[seed >= 0 :].sort(kind="stable")  # of runs that ascend; faster than a loop
        block = kernels.chart_block(seen, shown.points_robot, offsets, landmarks, columns, slots)
        return landmarks, columns + begin, block

    def _rows(self, begin: int, end: int) -> tuple[slice, Ints]:
        """Return the rows of some iterations, and where those of each begin and end."""
        first = begin - self._stored_from
        offsets = self._offsets.values[first : end - self._stored_from + 1]
        base = self._offsets.values[0]
        return slice(int(offsets[0] - base), int(offsets[-1] - base)), offsets - offsets[0]

    def _shown(self, begin: int, end: int) -> tuple[Shown, Ints]:
        """Return the points of some iterations, and where those of each begin and end."""
        rows, offsets = self._rows(begin, end)
        shown = self._show({name: column.values[rows] for name, column in self._columns.items()})
        if shown.per_row is None:
            return shown, offsets
        return shown, np.concatenate([[0], np.cumsum(shown.per_row)])[offsets]
