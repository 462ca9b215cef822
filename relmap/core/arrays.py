"""Short names for array types; docstrings give shapes and units."""

from __future__ import annotations

from typing import Any

import numpy as np

# Written out because saved states inspect these types, and `NDArray` differs from numpy 2.5 on.
Floats = np.ndarray[tuple[Any, ...], np.dtype[np.float64]]
Singles = np.ndarray[tuple[Any, ...], np.dtype[np.float32]]
Ints = np.ndarray[tuple[Any, ...], np.dtype[np.int64]]
# Columns of landmarks: levels, and numbers below 2^31, such as those of iterations.
Counts = np.ndarray[tuple[Any, ...], np.dtype[np.int32]]
Bytes = np.ndarray[tuple[Any, ...], np.dtype[np.int8]]
Bools = np.ndarray[tuple[Any, ...], np.dtype[np.bool_]]


FEW = 2**14
"""Number of pairs below which all are compared."""


def evenly(n: int, most: int) -> Ints:
    """Return at most `most` of n rows, evenly chosen."""
    return np.linspace(0, n - 1, min(most, n)).astype(np.int64)


def positions_of(keys: Ints, wanted: Ints) -> Ints:
    """Return the index of each wanted number (n,) among the keys (m,), -1 if missing."""
    if not len(keys):
        return np.full(len(wanted), -1)
    order = np.argsort(keys, kind="stable")
    at = order[np.searchsorted(keys[order], wanted).clip(0, len(keys) - 1)]
    return np.where(keys[at] == wanted, at, -1)


def among(values: Ints, others: Ints) -> Bools:
    """Return which of values (n,) are among others (m,)."""
    if len(values) * len(others) > FEW:
        return np.isin(values, others)
    return np.asarray((values[:, None] == others).any(axis=1))  # a tenth of the time of `isin`


def entries(values: Ints, at: Ints) -> Ints:
    """Return the entries of values at places (any shape); -1 stays."""
    found = values.take(at)
    if at.size and at.item(at.argmin()) < 0:  # seldom, and `np.where` takes several times as long
        found[at < 0] = -1
    return found
