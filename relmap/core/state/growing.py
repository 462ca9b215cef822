"""Arrays that grow at the end, and shrink at the front, in amortised constant time."""

from __future__ import annotations

import itertools
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


FEW = 16
"""Initial rows of an array, and initial growth factor of its capacity."""
MANY = 2**18
"""Capacity, once an array is large, of one that lasts as long as the map."""


class GrowingArray(Generic[Scalar]):
    """A numpy array that grows when it is full.

    Copying a large array is slow, but unused capacity costs no memory: the operating system
    allocates pages on first write. So the capacity grows in large steps up to the expected size,
    and doubles from there.

    `dtype`: numpy dtype. `width`: shape of one row, ``()`` for a column of scalars; the first rows
    added may have another one. `room`: approximate number of expected rows.
    """

    _sixteenths = itertools.cycle(range(16, 32))

    def __init__(self, dtype: DTypeLike, width: tuple[int, ...] = (), room: int = MANY) -> None:
        # Different sizes, so that arrays that grow together are not full in the same iteration.
        self._expected = room * next(self._sixteenths) // 16
        self._rows: NDArray[Any] = np.empty((min(FEW, room), *width), dtype=dtype)
        self._begin = 0
        self._end = 0

    def hold(self, rows: NDArray[Any]) -> None:
        """Replace the rows by others (n, *width), which are not copied."""
        self._rows, self._begin, self._end = rows, 0, len(rows)

    def __getstate__(self) -> dict[str, Any]:
        """Copy only the used part."""
        rows = {"_rows": self.values.copy(), "_begin": 0, "_end": len(self)}
        return rows | {"_expected": self._expected}

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._end - self._begin

    @property
    def values(self) -> NDArray[Scalar]:
        """The rows (n, *width), a view that is valid until the next `extend`."""
        return self._rows[self._begin : self._end]

    def extend(self, rows: NDArray[Any]) -> None:
        """Append rows (k, *width)."""
        n = len(rows)
        if not self._end and rows.shape[1:] != self._rows.shape[1:]:
            self._rows = np.empty((len(self._rows), *rows.shape[1:]), self._rows.dtype)
        if self._end + n > len(self._rows):
            self._make_room(n)
        self._rows[self._end : self._end + n] = rows
        self._end += n

    def append(self, row: Any) -> None:
        """Append one row."""
        if self._end == len(self._rows):
            self._make_room(1)
        self._rows[self._end] = row
        self._end += 1

    def drop(self, n: int) -> None:
        """Drop the first `n` rows."""
        self._begin += n

    def resize(self, n: int, fill: Any) -> None:
        """Grow to `n` rows, the new ones filled with `fill`."""
        more = n - len(self)
        if more > 0:
            if self._end + more > len(self._rows):
                self._make_room(more)
            self._rows[self._end : self._end + more] = fill
            self._end += more

    def _make_room(self, more: int) -> None:
        # Space is reclaimed at the front first, where rows were dropped.
        n = len(self)
        size = len(self._rows)
        if n + more > size // 2:
            larger = max(2 * size, min(FEW * size, self._expected))
            size = max(n + more, larger)
        room = np.empty((size, *self._rows.shape[1:]), self._rows.dtype)
        room[:n] = self.values
        self._rows, self._begin, self._end = room, 0, n
