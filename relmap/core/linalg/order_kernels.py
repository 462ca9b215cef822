"""Order statistics, compiled."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper


@helper
def smallest(values: Floats, k: int) -> float:
    """Return the k-th smallest, from 0, of values (n,), which are permuted.

    Hoare's "find" (Algorithm 65, CACM 1961).
    """
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return float(values[k])


@helper
def median(values: Floats) -> float:
    """Return the median of values (n,), which are permuted."""
    n = len(values)
    return (smallest(values, (n - 1) // 2) + smallest(values, n // 2)) / 2


@helper
def ordered(values: Floats | Ints) -> Ints:
    """Return the stable sorting order (n,) of values, ascending (merge sort)."""
    n, width = len(values), 1
    order, merged = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for i in range(n):
        order[i] = i
    while width < n:
        for begin in range(0, n, 2 * width):
            middle, end = min(begin + width, n), min(begin + 2 * width, n)
            a, b = begin, middle
            for k in range(begin, end):
                if a < middle and (b == end or values[order[a]] <= values[order[b]]):
                    merged[k], a = order[a], a + 1
                else:
                    merged[k], b = order[b], b + 1
        order, merged, width = merged, order, 2 * width
    return order


@helper
def _in_sets(of: Ints, values: Floats) -> tuple[Ints, Floats]:
    """Return the start of each set 0, 1, ..., and the values (n,) ordered by set."""
    n = 0
    for k in of:
        n = max(n, k + 1)
    begin, in_sets = np.zeros(n + 1, dtype=np.int64), np.empty(len(values))
    for k in of:
        begin[k + 1] += 1
    for k in range(n):
        begin[k + 1] += begin[k]
    at = begin.copy()
    for i in range(len(values)):
        in_sets[at[of[i]]] = values[i]
        at[of[i]] += 1
    return begin, in_sets


@compiled
def medians(of: Ints, values: Floats) -> Floats:
    """Return the lower median of the values (n,) of each set 0, 1, ...; none may be empty."""
    begin, in_sets = _in_sets(of, values)
    found = np.empty(len(begin) - 1)
    for k in range(len(found)):
        own = in_sets[begin[k] : begin[k + 1]]
        found[k] = smallest(own, (len(own) - 1) // 2)
    return found


@compiled
def quantiles(of: Ints, values: Floats, share: float) -> Floats:
    """Return the quantile of the values (n,) of each set 0, 1, ..., interpolated as in numpy."""
    begin, in_sets = _in_sets(of, values)
    found = np.empty(len(begin) - 1)
    for k in range(len(found)):
        own = in_sets[begin[k] : begin[k + 1]]
        place = share * (len(own) - 1)
        below = int(place)
        low = smallest(own, below)
        high = smallest(own, min(below + 1, len(own) - 1))
        found[k] = (1 - (place - below)) * low + (place - below) * high
    return found
