"""Tables of columns and records of arrays: as text, as HTML, and for pandas."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from dataclasses import fields
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError

AXES = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
PLANE = (*NORMAL, "offset")
NAMES: dict[str, tuple[str, ...]] = {
    "landmark_ids": ("landmark",),
    "position": AXES,
    "positions": AXES,
    "centre": AXES,
    "covariances": tuple(f"c{a}{b}" for a in AXES for b in AXES),
    "covariance": tuple(f"c_{a}_{b}" for a in PLANE for b in PLANE),
    "midpoint": AXES,
    "normal": NORMAL,
    "ends": ("x0", "y0", "x1", "y1"),
    "z_extent": ("z0", "z1"),
    "corner": ("corner0", "corner1"),
    "end_type": ("end0", "end1"),
}
"""Column names of some fields in the files of a result; the others use the field name."""
SHOWN = 10
"""Rows shown in a notebook."""
LONGEST = 60
"""Maximum number of characters of a value that is shown in full."""


class Table:
    """A dataclass of arrays with one row for each of n items."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self._arrays()))[1])

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns (n,) under their names in the files of a result."""
        found: dict[str, NDArray[Any]] = {}
        for name, values in self._arrays():
            if len(values) == len(self):  # covariances may be unknown; they then have no rows
                names = NAMES.get(name, (name,))
                flat = values.reshape(len(self), int(np.prod(values.shape[1:], dtype=int)))
                found |= dict(zip(names, flat.T, strict=False))
        return found

    def to_dataframe(self) -> Any:
        """Return the columns as a `pandas.DataFrame`.

        Raises `RelmapError` if pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise RelmapError("a DataFrame needs pandas: pip install 'relmap[pandas]'") from None
        return pd.DataFrame(self.columns())

    def __repr__(self) -> str:
        columns = self.columns()
        kinds, counts = np.unique(columns.get("status", []), return_counts=True)
        tally = (f"{n} {kind}" for kind, n in zip(kinds, counts.tolist(), strict=True))
        parts = [f"{len(self)} rows", *tally]
        return f"{type(self).__name__}({', '.join(parts)}; {', '.join(columns)})"

    def to_html(self) -> str:
        """Return the first rows as HTML, as notebooks show them."""
        columns = self.columns()
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        rows = (
            "".join(f"<td>{_cell(column[k])}</td>" for column in columns.values())
            for k in range(min(len(self), SHOWN))
        )
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        return f"<p>{escape(repr(self).partition(';')[0])})</p><table><tr>{head}</tr>{body}</table>"

    def _repr_html_(self) -> str:
        return self.to_html()

    def _arrays(self) -> Iterator[tuple[str, NDArray[Any]]]:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                yield field.name, value


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, np.floating) else escape(str(value))


class Brief:
    """A dataclass whose text gives the shapes of its arrays; declare it with ``repr=False``."""

    def __repr__(self) -> str:
        entries: Any = fields(self)  # type: ignore[arg-type]  # of every subclass
        values = ((entry.name, getattr(self, entry.name)) for entry in entries if entry.repr)
        shown = [
            f"{name}={_abbreviated(v)}" for name, v in values if v is not None and not callable(v)
        ]
        return f"{type(self).__name__}({', '.join(shown)})"


def _abbreviated(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape} {value.dtype}"
    text, name = repr(value), type(value).__name__
    if len(text) <= LONGEST or isinstance(value, Brief):
        return text
    return f"{name} of {len(value)}" if isinstance(value, Sized) else f"{name}(...)"
