"""A view of all observations of walls, and of the motions from scan to scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.motion_factors import MotionFactors
from relmap.planes.motions import inverse
from relmap.planes.steps import Steps

LONG_M = 0.5
"""Measured motions over longer steps are kept as equations: few walls stay in view, and along a
corridor these alone leave a map free to stretch. Edmonton's largest submap: 0.348 -> 0.104 m."""
LINK_M, LINK_RAD = 0.07, 0.015
"""Standard deviations of such a motion."""


@dataclass(frozen=True, eq=False)
class PlaneHistory:
    """Columns of the observation store (Fig. 3), and registration results of each scan.

    Attributes
    ----------
    iteration : (n,) int64, ascending
    plane : (n,) int64
        Number of the wall at the time of observation.
    ends : (n, 2, 2) float64, robot frame, metres
        Its right and left end.
    sd : (n,) float64, metres
        Standard deviation of the distance of its midpoint.
    z_extent : (n, 2) float64, metres
        Lowest and highest z.
    corner : (n, 2) int64
        Corner at either end; -1 if the end is not static.
    motion : (i, 3) float64
        From the previous robot frame to that of each iteration: yaw, x, y; approximate.
    submap : (i,) int64
        Submap of each iteration; -1 for none.
    odometry : Steps, optional
        Odometry, if available and accepted.
    measured : (i,) bool, optional
        Which motions are determined in all directions.
    """

    iteration: Ints
    plane: Ints
    ends: Floats
    sd: Floats
    z_extent: Floats
    corner: Ints
    motion: Floats
    submap: Ints
    odometry: Steps | None = None
    measured: Bools | None = None

    @property
    def n_iterations(self) -> int:
        """Number of scans, including those without walls."""
        return len(self.motion)

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First iteration and end of each submap, those with most iterations first.

        Iterations in between may belong to other submaps or none.
        """
        own = np.flatnonzero(self.submap >= 0)
        number, first, count = np.unique(self.submap[own], return_index=True, return_counts=True)
        last = len(own) - 1 - np.unique(self.submap[own][::-1], return_index=True)[1]
        spans = np.column_stack([own[first], own[last] + 1])
        return [(a, b) for a, b in spans[np.lexsort((number, -count))].tolist()]

    def factors(self, iterations: Ints) -> MotionFactors:
        """Return the equations for the motions between some iterations (k,).

        They are those of odometry, if there is any, else the measured motions over long steps.
        """
        if self.odometry:
            return self.odometry.between(iterations)
        if self.measured is None:
            return MotionFactors()
        before, after = iterations[:-1], iterations[1:]
        long = np.hypot(*self.motion[after, 1:].T) > LONG_M
        known = long & self.measured[after] & (after == before + 1)
        pairs = np.flatnonzero(known & (self.submap[before] == self.submap[after]))
        steps = np.array([inverse(motion) for motion in self.motion[after[pairs]]])
        sd = np.tile([LINK_RAD, LINK_M], (len(pairs), 1))
        return MotionFactors(np.column_stack([pairs, pairs + 1]), steps.reshape(-1, 3), sd)

    def own(self, span: tuple[int, int]) -> Bools:
        """Return which iterations (k,) of the span of a submap belong to it."""
        return np.asarray(self.submap[slice(*span)] == self.submap[span[0]])

    def within(self, span: tuple[int, int]) -> Ints:
        """Return the rows of the iterations of a submap, by its span."""
        begin, end = np.searchsorted(self.iteration, span).tolist()
        own = self.own(span)[self.iteration[begin:end] - span[0]]
        return np.arange(begin, end)[own]
