"""Which landmarks take their positions from a group, compiled; see `levels`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled

Counts = tuple[Ints, Ints, Ints, Ints, Ints]
"""Of the landmark table: submap, group, level, highest_level, averaged."""
Places = tuple[Floats, Floats, Floats, Floats]
"""Of the landmark table: position, weight, settled_position, settled_weight."""


@compiled
def take(
    columns: Counts,
    places: Places,
    submap: int,
    landmarks: Ints,
    placed: Floats,
    offered: tuple[Ints, Ints],
    number: int,
) -> tuple[Bools, Ints]:
    """Place the landmarks (n,) for which a group is the best at `placed` (n, d) of a submap.

    `offered`: the level that each reaches, and the number of observations averaged; `number`: of
    the group. Positions are averaged with the settled ones. Returns which are placed (n,), and the
    groups that they had before.
    """
    submap_of, group, level, highest, averaged = columns
    position, weight, settled_position, settled_weight = places
    levels, counts = offered
    best, n = np.zeros(len(landmarks), dtype=np.bool_), 0
    before = np.empty(len(landmarks), dtype=np.int64)
    for k in range(len(landmarks)):
        one = landmarks[k]
        if counts[k] > averaged[one]:
            best[k] = levels[k] >= level[one]
        else:
            best[k] = levels[k] > level[one] and counts[k] > 0
        if best[k]:
            if submap_of[one] != submap:
                settled_weight[one] = 0.0
            weight[one] = settled_weight[one] + counts[k]
            share = counts[k] / weight[one]
            for a in range(placed.shape[1]):
                settled = settled_position[one, a]
                position[one, a] = settled + share * (placed[k, a] - settled)
            before[n], n = group[one], n + 1
            submap_of[one], group[one], level[one] = submap, number, levels[k]
            highest[one], averaged[one] = max(highest[one], levels[k]), counts[k]
    return best, before[:n]
