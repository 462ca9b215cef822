"""Which landmarks of a relative map rest, and which move, compiled; see `dynamics`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Counts, Floats, Ints
from relmap.core.grouping.dynamics import ENOUGH, EXACT, FEWEST, LIMIT, STILL, STRIKES
from relmap.core.linalg.compiling import compiled
from relmap.core.state.table import NONE

Columns = tuple[Bools, Counts, Counts, Bools, Counts, Counts, Counts]
"""Of the landmark table: restless, strikes, struck_until, dynamic, tested_until, moved_until,
moving_bin."""


@compiled
def steady(
    positions: Floats, variance: Floats, amplified: Floats, given: Floats | None, noise_m: float
) -> Bools:
    """Return which positions (n, d) vary no more than noise explains; see `dynamics.rests`."""
    (n, d), largest = positions.shape, 0.0
    for k in range(n):
        for a in range(d):  # NaN is never larger
            largest = abs(positions[k, a]) if abs(positions[k, a]) > largest else largest
    exact_m = EXACT * (np.sqrt(d) * largest)
    noise = (exact_m if exact_m > noise_m else noise_m) ** 2
    still = np.empty(n, dtype=np.bool_)
    for k in range(n):
        own = noise if given is None else max(noise, given[k])
        still[k] = (0.0 if np.isnan(variance[k]) else variance[k]) <= LIMIT * own * amplified[k]
    return still


@compiled
def tested(
    columns: Columns, landmarks: Ints, still: Bools, used: Bools, n_used: Ints, iterations: Ints
) -> Bools:
    """Update which landmarks (n,) move, given which are still; see `dynamics.DynamicStatus.test`.

    `used` (n, i): observations averaged; `n_used` (n,): how many; `iterations` (i,). Returns
    which tested ones are at rest (n,).
    """
    restless, strikes, struck_until, dynamic, tested_until, moved_until, moving_bin = columns
    n, m = used.shape
    rests = np.empty(n, dtype=np.bool_)
    for k in range(n):
        one, first, last, fresh = landmarks[k], m, m - 1, 0
        for i in range(m):
            if used[k, i]:
                first, last = min(first, i), i
                fresh += iterations[i] > struck_until[one]
        begin, end = iterations[first % m], iterations[last]
        restless[one] = not still[k] and n_used[k] >= FEWEST
        is_tested = n_used[k] >= ENOUGH
        moves = is_tested and not still[k]
        if is_tested and fresh >= FEWEST:
            strikes[one] = strikes[one] + 1 if moves else 0
            struck_until[one] = iterations[m - 1] if moves else struck_until[one]
        dynamic[one] |= strikes[one] >= STRIKES
        moved_until[one] += max(begin - 1 - tested_until[one], 0)
        tested_until[one] = max(tested_until[one], end)
        if moves:
            moved_until[one] = end
        elif is_tested and end - moved_until[one] > STILL:
            dynamic[one], moving_bin[one] = False, NONE
        rests[k] = n_used[k] >= FEWEST and still[k] and not dynamic[one]
    return rests
