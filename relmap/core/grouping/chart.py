"""The point chart: landmarks by iterations in which they were visible (Figs 9 and 10).

A group grows down the sorted chart to the largest members x common interval (Fig. 11).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.state.store import ObservationStore


@dataclass(frozen=True, eq=False)
class PointChart:
    """Observations of landmarks in the iterations in which one of them, the seed, was visible.

    `landmarks` (n,): the seed first, then all that were visible together with it at least once.
    `iterations` (i,), ascending: the iterations in which the seed was visible. `points_robot`
    (n, i, d), robot frame, metres: observations; NaN where missing. `variance` (n,), square metres:
    variance of an observed coordinate, if covariances are given.
    """

    landmarks: Ints
    iterations: Ints
    points_robot: Floats
    variance: Floats | None = None

    @classmethod
    def around(cls, seed: int, store: ObservationStore, begin: int, end: int) -> PointChart:
        """Chart the landmarks visible with `seed` in iterations `begin` to `end` (Fig. 9)."""
        return cls(*store.seen_with(seed, begin, end))

    def only(self, rows: Bools) -> PointChart:
        """Return the chart restricted to some of its landmarks, including the seed."""
        variance = None if self.variance is None else self.variance[rows]
        own = self.landmarks[rows], self.iterations, self.points_robot[rows]
        return PointChart(*own, variance)

    @cached_property
    def visible(self) -> Bools:
        """Which landmarks each iteration shows; (n, i)."""
        return np.isfinite(self.points_robot[:, :, 0])

    @cached_property
    def counted(self) -> tuple[Ints, float]:
        """The common intervals (n,), and the largest coordinate, metres."""
        import relmap.core.grouping.binning_kernels as kernels

        return kernels.counted(self.points_robot)

    @property
    def common_interval(self) -> Ints:
        """Number of iterations each landmark shares with the seed; (n,)."""
        return self.counted[0]


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
    import relmap.core.grouping.chart_kernels as kernels

    if len(candidates) < min_members:
        return None
    fewest = min_members, min_shared
    found = kernels.grown(chart.points_robot, candidates, chart.common_interval, weights, fewest)
    return Group(*found) if len(found[0]) else None
