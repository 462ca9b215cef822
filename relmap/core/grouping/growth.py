"""Group growth: members x common interval (Fig. 11)."""

from __future__ import annotations

from dataclasses import dataclass

from relmap.core.arrays import Floats, Ints
from relmap.core.grouping.chart import PointChart


@dataclass(frozen=True, eq=False)
class Group:
    """Landmarks of a chart that were all visible in each iteration of a common interval.

    `rows` (g,): rows of the members in the chart; `columns` (i,), ascending: columns of the common
    interval in the chart; `points_robot` (g, i, d), robot frame, metres: their observations.
    """

    rows: Ints
    columns: Ints
    points_robot: Floats


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
    from relmap.core.grouping.chart_kernels import grown

    if len(candidates) < min_members:
        return None
    fewest = min_members, min_shared
    found = grown(chart.points_robot, candidates, chart.common_interval, weights, fewest)
    return Group(*found) if len(found[0]) else None
