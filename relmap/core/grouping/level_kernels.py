"""Which landmarks take their positions from a group, compiled; see `levels`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Bytes, Counts, Floats, Ints
from relmap.core.linalg.compiling import compiled

Columns = tuple[Ints, Counts, Bytes, Bytes, Counts, Counts, Counts, Bools]
"""Of the landmark table: submap, group, level, highest_level, averaged; begin, in_interval,
is_gone."""
Places = tuple[Floats, Floats, Floats, Floats]
"""Of the landmark table: position, weight, settled_position, settled_weight."""


@compiled
def reached(
    level: int, n_averaged: int, in_interval: int, is_gone: bool, ripe: float, longest: int
) -> int:
    """Return the level that a group of some level gives to a landmark.

    Level 3 requires the whole interval: the landmark is gone, or has as many observations as are
    `ripe`. A group with less than half of those stored, at most `longest`, gives it only level 1.
    """
    if 2 * n_averaged < min(in_interval, longest):
        return 1
    return level if is_gone or in_interval >= ripe else min(level, 2)


@compiled
def take(
    columns: Columns,
    places: Places,
    submap: int,
    number: int,
    landmarks: Ints,
    placed: Floats,
    seen: tuple[Bools, Ints],
    limits: tuple[int, float, int],
) -> tuple[Ints, Ints]:
    """Place the landmarks (n,) for which a group is the best at `placed` (n, d) of a submap.

    `number`: of the group; `seen`: observations averaged (n, i), and iterations (i,); `limits`: the
    pass, and the last two of `reached`. Positions are averaged with the settled ones. Returns the
    landmarks that are complete, and the groups that those placed had before.
    """
    submap_of, group, level, highest, averaged, begin, in_interval, is_gone = columns
    position, weight, settled_position, settled_weight = places
    before, n = np.empty(len(landmarks), dtype=np.int64), 0
    whole, n_whole = np.empty(len(landmarks), dtype=np.int64), 0
    for k in range(len(landmarks)):
        one, count = landmarks[k], 0
        # If its interval began within the chart, the earlier positions are settled.
        for i in range(len(seen[1])):
            count += seen[0][k, i] and seen[1][i] >= begin[one]
        to = reached(limits[0], count, in_interval[one], is_gone[one], limits[1], limits[2])
        better = to >= level[one] if count > averaged[one] else to > level[one] and count > 0
        if better:
            if submap_of[one] != submap:
                settled_weight[one] = 0.0
            weight[one] = settled_weight[one] + count
            share = count / weight[one]
            for a in range(placed.shape[1]):
                settled = settled_position[one, a]
                position[one, a] = settled + share * (placed[k, a] - settled)
            before[n], n = group[one], n + 1
            submap_of[one], group[one], level[one] = submap, number, to
            highest[one], averaged[one] = max(highest[one], to), count
            if to == 3:
                whole[n_whole], n_whole = one, n_whole + 1
    return whole[:n_whole], before[:n]
