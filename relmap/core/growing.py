"""Arrays that grow at the end, and shrink at the front, in amortised constant time."""

from __future__ import annotations

import itertools
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


class GrowingArray(Generic[Scalar]):
    """A numpy array that doubles its room when it is full.

    Parameters
    ----------
    dtype : numpy dtype
    width : tuple of int
        Shape of one row; ``()`` for a column of scalars.
    """

    _sizes = itertools.cycle(range(16, 32))

    def __init__(self, dtype: DTypeLike, width: tuple[int, ...] = ()) -> None:
        # Of different sizes, so that arrays that grow together are not full in the same iteration.
        self._rows: NDArray[Any] = np.empty((next(self._sizes), *width), dtype=dtype)
        self._begin = 0
        self._end = 0

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._end - self._begin

    @property
    def values(self) -> NDArray[Scalar]:
        """The rows (n, *width), a view that stays valid until the next `extend`."""
        return self._rows[self._begin : self._end]

    def extend(self, rows: NDArray[Any]) -> None:
        """Append rows (k, *width)."""
        self._make_room(len(rows))
        self._rows[self._end : self._end + len(rows)] = rows
        self._end += len(rows)

    def drop(self, n: int) -> None:
        """Forget the first `n` rows."""
        self._begin += n

    def resize(self, n: int, fill: Any) -> None:
        """Grow to `n` rows, the new ones filled with `fill`."""
        more = n - len(self)
        if more > 0:
            self._make_room(more)
            self._rows[self._end : self._end + more] = fill
            self._end += more

    def _make_room(self, more: int) -> None:
        end = self._end + more
        if end > len(self._rows):
            # Room is made at the front first: what was dropped there is no longer needed.
            n = len(self)
            enough = n + more <= len(self._rows) // 2
            size = len(self._rows) if enough else max(n + more, 2 * len(self._rows))
            room = np.empty((size, *self._rows.shape[1:]), self._rows.dtype)
            room[:n] = self.values
            self._rows, self._begin, self._end = room, 0, n
