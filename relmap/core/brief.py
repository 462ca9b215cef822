"""Short texts of records that hold arrays."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import fields
from typing import Any

import numpy as np

LONGEST = 60
"""Maximum number of characters of a value that is shown in full."""


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
