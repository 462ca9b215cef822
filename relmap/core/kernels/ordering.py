"""Order statistics, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled


@compiled
def smallest(values: NDArray[np.float64], k: int) -> float:
    """Return the k-th smallest, from 0, of values (n,); they change places.

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


@compiled
def median(values: NDArray[np.float64]) -> float:
    """Return the median of values (n,); they change places."""
    n = len(values)
    return (smallest(values, (n - 1) // 2) + smallest(values, n // 2)) / 2
