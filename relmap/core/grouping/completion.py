"""From the common interval to the whole chart.

A group's relative map rests on the iterations in which all its members were visible (section III).
With missed detections few such iterations remain. So every other iteration of the chart is fitted
to the relative map by least squares, and its observations are averaged as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints


@dataclass(eq=False)
class RelativeMap:
    """Average locations of landmarks relative to one another.

    Attributes
    ----------
    landmarks : (n,) int64
    positions : (n, d) float64, group frame, metres
    variance : (n,) float64, square metres
        Variance of a coordinate over the averaged iterations, without the largest deviation; NaN if
        fewer than three are averaged.
    amplified : (n,) float64
        Expected ratio of that variance to the noise variance for a static landmark: 1 plus the
        contribution of fitting the iteration to the reference, which grows with the distance.
    used : (n, i) bool
        The averaged observations: landmarks by iterations.
    n_used : (n,) int64
        Number of observations behind each position.
    iterations : (i,) int64, ascending
    R : (i, d, d) float64
    t : (i, d) float64, metres
        Pose of each iteration: robot frame to group frame.
    common_interval : (c,) int64, ascending
        Iterations that show all members of the initial group.
    given : (n,) float64, square metres, optional
        Variance of an observed coordinate, if covariances are given.
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
        return replace(
            self,
            landmarks=self.landmarks[rows],
            positions=self.positions[rows],
            variance=self.variance[rows],
            amplified=self.amplified[rows],
            used=self.used[rows],
            n_used=self.n_used[rows],
            given=None if self.given is None else self.given[rows],
        )


def complete(landmarks: Ints, iterations: Ints, block: Floats, reference: Floats) -> RelativeMap:
    """Average a whole chart in the frame of a relative map of some of its landmarks.

    `landmarks` (n,); `iterations` (i,); `block` (n, i, d), robot frame, metres: observations of the
    landmarks in the iterations; NaN where missing. `reference` (n, d), group frame, metres: the
    relative map to fit to; NaN for other landmarks. Returns the map of the landmarks seen in an
    iteration whose pose the reference determines.
    """
    import relmap.core.grouping.averaging_kernels as kernels

    R, t, used, n_used, positions, variance, amplified = kernels.place_iterations(block, reference)
    whole = RelativeMap(landmarks, positions, variance, amplified, used, n_used, iterations, R, t)
    return whole.only(n_used > 0)
