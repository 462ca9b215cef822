"""Group growth: members x common interval (Fig. 11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.grouping.chart import PointChart


@dataclass(frozen=True, eq=False)
class Group:
    """Landmarks of a chart that were all visible in each iteration of a common interval.

    `rows` (g,): rows of the members in the chart; `columns` (i,), ascending: columns of the common
    interval in the chart.
    """

    rows: Ints
    columns: Ints


def grow_group(
    chart: PointChart, candidates: Ints, weights: Floats, min_members: int, min_shared: int
) -> Group | None:
    """Grow a group down the sorted chart to the largest members x common interval (Fig. 11).

    Among equal common intervals the better mapped landmarks come first, so that the group shares as
    many landmarks with the map as possible.  The paper stops at the first landmark that does not
    enlarge the area; here the largest area of the whole chart is taken.

    `candidates` (c,): rows of the chart that may become members. `weights` (n,): iterations
    averaged into the position of each landmark of the chart; 0 if unmapped. `min_members`: minimum
    size of a group. `min_shared`: minimum number of mapped landmarks in it; 0 for the first group
    of a map. Returns None if the chart contains no such group.
    """
    if len(candidates) < min_members:
        return None
    order = candidates[chart.sorted_by_common_interval(candidates, weights[candidates])]
    together = np.logical_and.accumulate(chart.visible[order], axis=0)
    size = np.arange(1, len(order) + 1)
    shared = np.cumsum(weights[order] > 0)
    area = np.where((size >= min_members) & (shared >= min_shared), size * together.sum(axis=1), 0)
    best = int(np.argmax(area))
    if area[best] == 0:
        return None
    return Group(order[: best + 1], np.flatnonzero(together[best]))
