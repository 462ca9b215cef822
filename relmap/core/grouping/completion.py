"""From the common interval to the whole chart.

A group's relative map rests on the iterations in which all its members were visible (section III).
With missed detections few such iterations remain. So every other iteration of the chart is fitted
to the relative map by least squares, and its observations are averaged as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.grouping.chart import PointChart

ROUNDS = 6
"""Maximum number of refits of a relative map as it grows."""
AMPLE = 1.5
"""Growth factor of the well-placed part of the chart that triggers a refit."""
PLENTY, NEARLY = 100, 0.95
"""Number of well-placed members, and their fraction of a chart, for which it is not refitted."""
SOLID = 1.0
"""Largest variance of a position used in a fit, relative to that of an observation."""


@dataclass(eq=False)
class RelativeMap:
    """Average locations of landmarks relative to one another.

    `landmarks` (n,); `positions` (n, d), group frame, metres; `variance` (n,), square metres: of a
    coordinate over the averaged iterations, without the largest deviation; NaN if fewer than three
    are averaged; `amplified` (n,): expected ratio of that to the noise variance for a static
    landmark: 1 plus the contribution of fitting the iteration to the reference, which grows with
    the distance; `used` (n, i): the averaged observations, and `n_used` (n,), their number;
    `iterations` (i,), ascending; `R` (i, d, d), `t` (i, d), metres: pose of each, robot frame to
    group frame; `common_interval` (c,), ascending: iterations that show all members of the initial
    group; `given` (n,), square metres: variance of an observed coordinate, if covariances are.
    """

    landmarks: Ints
    positions: Floats
    variance: Floats
    amplified: Floats
    used: Bools
    n_used: Ints
    iterations: Ints
    R: Floats
    t: Floats
    common_interval: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    given: Floats | None = None

    def only(self, rows: Bools) -> RelativeMap:
        """Return the map restricted to some of its landmarks."""
        if np.count_nonzero(rows) == len(rows):
            return self
        names = "landmarks", "positions", "variance", "amplified", "used", "n_used"
        at = rows.nonzero()[0]  # `take` is several times as fast as indexing by a mask
        own = {name: getattr(self, name).take(at, axis=0) for name in names}
        return replace(self, **own, given=None if self.given is None else self.given[rows])


def complete(chart: PointChart, reference: Floats, moves: Bools, noise_m: float) -> RelativeMap:
    """Average a whole chart in the frame of a relative map of some of its landmarks.

    With few members the rotation of the far end of the chart is poorly determined: landmarks placed
    accurately enough are used for the fit too, repeatedly, from the relative map outwards.

    `reference` (n, d), group frame, metres, changed: the relative map to fit to; NaN for others;
    `moves` (n,): landmarks known to move; `noise_m`: standard deviation of a static landmark; NaN
    if unknown. Returns the map of the landmarks seen in an iteration whose pose the reference
    determines.
    """
    import relmap.core.grouping.averaging_kernels as kernels

    block, seen, given = chart.points_robot, chart.iterations, chart.variance
    found = kernels.completed(block, reference, moves, given, noise_m)
    R, t, used, n_used, mean, variance, amplified = found
    own = chart.landmarks, mean, variance, amplified, used, n_used
    return RelativeMap(*own, seen, R, t, given=given).only(n_used > 0)
