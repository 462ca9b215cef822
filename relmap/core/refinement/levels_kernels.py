"""Levels of a breadth-first search, compiled; see `relmap.core.refinement.rows.levels_of`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Ints
from relmap.core.linalg.compiling import compiled
from relmap.core.linalg.small_kernels import unset


@compiled
def breadth_first(
    start: int, begin: Ints, landmark: Ints, entry_begin: Ints, entry: Ints, segment: Ints
) -> tuple[Ints, Ints]:
    """Return breadth-first levels of landmarks (m,) and segments (s,) from one landmark on.

    `entry` lists the rows of each landmark, from `entry_begin` (m + 1,) on.  Unreachable nodes get
    levels of their own, after the others.
    """
    m = len(entry_begin) - 1
    of_landmark, of_segment = unset(m), unset(len(begin) - 1)
    queue, tail, head, base = np.empty(m, dtype=np.int64), 0, 0, 0
    while tail < m or head < tail:
        if head == tail:
            while of_landmark[start] >= 0:
                start = (start + 1) % m
            of_landmark[start] = base
            queue[tail] = start
            tail += 1
        here = queue[head]
        head += 1
        level = of_landmark[here]
        base = level + 1
        for e in range(entry_begin[here], entry_begin[here + 1]):
            s = segment[entry[e]]
            if of_segment[s] >= 0:
                continue
            of_segment[s] = level
            for row in range(begin[s], begin[s + 1]):
                if of_landmark[landmark[row]] < 0:
                    of_landmark[landmark[row]] = level + 1
                    queue[tail] = landmark[row]
                    tail += 1
    return of_landmark, of_segment
