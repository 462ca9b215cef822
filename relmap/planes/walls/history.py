"""A view of all observations of walls, and of the motions from scan to scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.links import CROSSING, spread
from relmap.planes.motions import inverse
from relmap.planes.odometry.steps import MotionFactors, Steps

CROSSINGS = 2.0
"""Spread of the directions of the walls that two consecutive scans share below which the motion
between them is kept as an equation: along a corridor, ends of walls seen at a grazing angle would
determine the motion alone, and they are wrong by up to half a metre."""
LINK_M, LINK_RAD = 0.07, 0.015
"""Standard deviations of such a motion."""
WEAK_M, WEAK_RAD = 0.1, 0.05
"""The same for a weak link. Otherwise a run of them can shrink or grow without limit (a simulated
building with 15 people was off by 0.64 m instead of 0.03 m)."""
BENT_M, BENT_RAD = 0.014, 0.003
"""The same for a link that beams prefer to the step of a refined map: less, to outweigh the wall
that bends it."""


@dataclass(frozen=True, eq=False)
class PlaneHistory:
    """Columns of the observation store (Fig. 3), and registration results of each scan.

    `iteration` (n,), ascending; `plane` (n,): number of the wall at the time of observation; `ends`
    (n, 2, 2), robot frame, metres: its right and left end; `sd` (n,), metres: standard deviation of
    the distance of its midpoint; `z_extent` (n, 2), metres: lowest and highest z; `corner` (n, 2):
    corner at either end, -1 if the end is not static.

    `motion` (i, 3): from the previous robot frame to that of each iteration: yaw, x, y;
    approximate; `submap` (i,): submap of each iteration, -1 for none; `odometry`: if available and
    accepted; `measured` (i,): which motions are determined in all directions; `spacing_rad`: angle
    between the beams of the laser, 0 if unknown; `same` (k, 2): numbers that are the same wall,
    according to links found later; `bent` (b,): iterations at which a refined map was bent,
    ascending: their motions are kept as equations; `kept`: a scan of the map to which a log was
    added, -1 for none.
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
    spacing_rad: float = 0.0
    same: Ints = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    bent: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    kept: int = -1

    @property
    def n_iterations(self) -> int:
        """Number of scans, including those without walls."""
        return len(self.motion)

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First iteration and end of each submap, those with most iterations first.

        A map to which a log was added is before all others. Iterations in between may belong to
        other submaps or none.
        """
        own = np.flatnonzero(self.submap >= 0)
        number, first, count = np.unique(self.submap[own], return_index=True, return_counts=True)
        last = len(own) - 1 - np.unique(self.submap[own][::-1], return_index=True)[1]
        spans = np.column_stack([own[first], own[last] + 1])
        other = number != (self.submap[self.kept] if self.kept >= 0 else -1)
        return [(a, b) for a, b in spans[np.lexsort((number, -count, other))].tolist()]

    def factors(self, iterations: Ints) -> MotionFactors:
        """Return the equations for the motions between some iterations (k,).

        They are those of odometry, if there is any, and motions between scans that share few walls
        that cross, or where a refined map was bent.
        """
        factors = self._links(iterations)
        if self.odometry and self.odometry.needed.any():
            return self.odometry.between(iterations).and_those(factors)
        return factors

    def _links(self, iterations: Ints) -> MotionFactors:
        """Return the motions between some consecutive iterations; see `factors`."""
        if self.measured is None:
            return MotionFactors()
        before, after = iterations[:-1], iterations[1:]
        sure = self.measured[after] & ~np.isin(after, self.weak_links)
        bent = np.isin(after, self.bent)
        known = (self.hardly_crossed[after] | bent) & (after == before + 1)
        if self.odometry:
            known &= ~self.odometry.needed[after]
        pairs = np.flatnonzero(known & (self.submap[before] == self.submap[after]))
        steps = inverse(self.motion[after[pairs]])
        sd = np.where(sure[pairs, None], (LINK_RAD, LINK_M), (WEAK_RAD, WEAK_M))
        sd[bent[pairs]] = BENT_RAD, BENT_M
        return MotionFactors(np.column_stack([pairs, pairs + 1]), steps, sd)

    @cached_property
    def _before(self) -> tuple[Ints, Ints]:
        """Rows of walls that the scan before shows too, and their rows there."""
        n_planes = int(self.plane.max(initial=-1)) + 1
        plane = first_of(n_planes, self.same)[self.plane]
        key = self.iteration * n_planes + plane
        order = np.argsort(key, kind="stable")
        before = np.searchsorted(key[order], key - n_planes).clip(max=max(len(key) - 1, 0))
        row = np.flatnonzero((self.iteration > 0) & (key[order][before] == key - n_planes))
        return row, order[before[row]]

    @property
    def in_common(self) -> Bools:
        """Whether each observed wall (n,) was seen in the scan before."""
        common = np.zeros(len(self.plane), dtype=np.bool_)
        common[self._before[0]] = True
        return common

    @cached_property
    def _shared(self) -> tuple[Floats, Bools]:
        """Spread (i,) of the directions of walls in common with the scan before; common corners."""
        n, (row, other) = self.n_iterations, self._before
        iteration = self.iteration[row]
        corner = self.corner[row]
        both = ((corner >= 0) & (corner == self.corner[other])).any(axis=1)
        along = self.ends[row, 1] - self.ends[row, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        return spread(along, iteration, n), np.bincount(iteration[both], minlength=n) > 0

    @property
    def hardly_crossed(self) -> Bools:
        """Whether few walls that each scan (i,) shares with the one before cross."""
        return self._shared[0] < CROSSINGS

    @cached_property
    def weak_links(self) -> Ints:
        """Iterations (k,) whose motion since the previous one relies on the motion model.

        The two scans share no static corner and no two crossing walls; constant motion is assumed
        in the undetermined direction. There is no link where a submap begins.
        """
        crossing, held = self._shared
        weak = ~held & (crossing < CROSSING)
        same = np.diff(self.submap) == 0
        return np.flatnonzero(weak[1:] & same & (self.submap[1:] >= 0)) + 1

    @cached_property
    def places(self) -> Ints:
        """Number of the place of each end (n, 2): ends of one scan that coincide have one."""
        scan, (x, y) = np.repeat(self.iteration, 2), self.ends.reshape(-1, 2).T
        order = np.lexsort((scan, y, x))
        is_new = np.zeros(len(order), dtype=np.bool_)
        for key in (scan, x, y):
            is_new[1:] |= np.diff(key[order]) != 0
        places = np.empty(len(order), dtype=np.int64)
        places[order] = np.cumsum(is_new)
        return places.reshape(-1, 2)

    def own(self, span: tuple[int, int]) -> Bools:
        """Return which iterations (k,) of the span of a submap belong to it."""
        return np.asarray(self.submap[slice(*span)] == self.submap[span[0]])


def first_of(n: int, pairs: Ints) -> Ints:
    """Return for each of n walls the first wall joined to it by pairs (k, 2)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    n_parts, part = connected_components(graph, directed=False)
    first = np.full(n_parts, n)
    np.minimum.at(first, part, np.arange(n))
    return np.asarray(first[part])
