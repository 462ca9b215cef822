"""Arrays that grow at the end, and shrink at the front, in amortised constant time."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


class GrowingArray(Generic[Scalar]):
    """A numpy array that doubles its room when it is full.

    Parameters
    ----------
    width : tuple of int
        Shape of one row; ``()`` for a column of scalars.
    dtype : numpy dtype
    """

    def __init__(self, dtype: DTypeLike, width: tuple[int, ...] = ()) -> None:
        self._rows: NDArray[Any] = np.empty((16, *width), dtype=dtype)
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
        end = self._end + len(rows)
        if end > len(self._rows):
            # Room is made at the front first: what was dropped there is no longer needed.
            n = len(self)
            enough = n + len(rows) <= len(self._rows) // 2
            size = len(self._rows) if enough else max(n + len(rows), 2 * len(self._rows))
            room = np.empty((size, *self._rows.shape[1:]), self._rows.dtype)
            room[:n] = self.values
            self._rows, self._begin, self._end, end = room, 0, n, n + len(rows)
        self._rows[self._end : end] = rows
        self._end = end

    def drop(self, n: int) -> None:
        """Forget the first `n` rows."""
        self._begin += n

    def resize(self, n: int, fill: Any) -> None:
        """Grow to `n` rows, the new ones filled with `fill`."""
        if n > len(self):
            self.extend(np.full((n - len(self), *self._rows.shape[1:]), fill, self._rows.dtype))
