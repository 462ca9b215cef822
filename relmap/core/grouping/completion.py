"""From the common interval to everything seen around it.

A group's relative map rests on the iterations in which all its members were visible (section III).
Landmarks missed now and then would leave little of it.  So every other iteration of the chart is
fitted, by least squares, to the relative map, and everything seen in it is averaged as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class RelativeMap:
    """Average locations of landmarks relative to one another.

    Attributes
    ----------
    landmarks : (n,) int64
    positions : (n, d) float64, group frame, metres
    variance : (n,) float64, square metres
        Of a coordinate, over the iterations averaged but the one farthest off; NaN where fewer
        than three are averaged.
    amplified : (n,) float64
        What that variance is, in units of the noise's, for a landmark at rest: 1 and what the fit
        of an iteration to the reference adds, the more the farther the landmark is from it.
    used : (n, i) bool
        The observations behind it: landmarks by iterations.
    iterations : (i,) int64, ascending
    R : (i, d, d) float64
    t : (i, d) float64, metres
        Where each iteration lies: robot frame to group frame.
    fixed : (i,) bool
        Whether an iteration is fixed by what was seen in it.
    common_interval : (c,) int64, ascending
        Iterations that show all members of the group that it began with.
    given : (n,) float64, square metres, optional
        Variance of an observed coordinate, where covariances came with the observations.
    """

    landmarks: Ints
    positions: Floats
    variance: Floats
    amplified: Floats
    used: Bools
    iterations: Ints
    R: Floats
    t: Floats
    fixed: Bools
    common_interval: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    given: Floats | None = None

    @property
    def n_used(self) -> Ints:
        """Number of observations behind each position; (n,)."""
        return np.asarray(self.used.sum(axis=1))

    def only(self, rows: Bools) -> RelativeMap:
        """Return the map of some of its landmarks."""
        return replace(
            self,
            landmarks=self.landmarks[rows],
            positions=self.positions[rows],
            variance=self.variance[rows],
            amplified=self.amplified[rows],
            used=self.used[rows],
            given=None if self.given is None else self.given[rows],
        )


def complete(landmarks: Ints, iterations: Ints, block: Floats, reference: Floats) -> RelativeMap:
    """Average a whole chart in the frame of a relative map of some of it.

    Parameters
    ----------
    landmarks : (n,) int64
    iterations : (i,) int64
    block : (n, i, d) float64, robot frame, metres
        Observations of the landmarks in the iterations; NaN where one was not seen.
    reference : (n, d) float64, group frame, metres
        The relative map to fit to; NaN for landmarks outside it.

    Returns
    -------
    RelativeMap
        Of the landmarks seen in an iteration that the reference fixes.
    """
    from relmap.core.grouping.averaging_kernels import place_iterations

    seen = np.isfinite(block[:, :, 0])
    R, t, fixed, positions, squares, amplified = place_iterations(block, reference)
    used = seen & fixed
    there = used.any(axis=1)
    used, positions, squares = used[there], positions[there], squares[there]
    freedoms = block.shape[2] * (used.sum(axis=1) - 2)
    variance = np.divide(squares, freedoms, out=np.full(len(used), np.nan), where=freedoms > 0)
    return RelativeMap(
        landmarks[there], positions, variance, amplified[there], used, iterations, R, t, fixed
    )
