"""Arrays that grow at the end in amortised constant time."""

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
        self._n = 0

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._n

    @property
    def values(self) -> NDArray[Scalar]:
        """The rows (n, *width), a view that stays valid until the next `extend`."""
        return self._rows[: self._n]

    def extend(self, rows: NDArray[Any]) -> None:
        """Append rows (k, *width)."""
        needed = self._n + len(rows)
        if needed > len(self._rows):
            room = np.empty(
                (max(needed, 2 * len(self._rows)), *self._rows.shape[1:]), self._rows.dtype
            )
            room[: self._n] = self._rows[: self._n]
            self._rows = room
        self._rows[self._n : needed] = rows
        self._n = needed

    def resize(self, n: int, fill: Any) -> None:
        """Grow to `n` rows, the new ones filled with `fill`."""
        if n > self._n:
            self.extend(np.full((n - self._n, *self._rows.shape[1:]), fill, self._rows.dtype))
