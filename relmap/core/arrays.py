"""Short names for array types; docstrings give shapes and units."""

from __future__ import annotations

from typing import Any

import numpy as np

# Written out because saved states inspect these types, and `NDArray` differs from numpy 2.5 on.
Floats = np.ndarray[tuple[Any, ...], np.dtype[np.float64]]
Singles = np.ndarray[tuple[Any, ...], np.dtype[np.float32]]
Ints = np.ndarray[tuple[Any, ...], np.dtype[np.int64]]
Bools = np.ndarray[tuple[Any, ...], np.dtype[np.bool_]]
