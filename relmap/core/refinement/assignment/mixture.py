"""Landmarks, and how many, by all observations near them: a mixture with known noise.

A scan shows each landmark at most once. The mixture is fitted with whole assignments (Celeux and
Govaert, 1992), from several starts, as its optima are local.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import nearest
from relmap.core.state.table import NONE

REACH, BEYOND = 4.0, 1.0
"""Standard deviations within which landmarks are fitted together, and how much farther away their
observations may be."""
MOST = 6
"""Maximum number of landmarks fitted together."""
STARTS = 4
"""Number of scans whose observations are tried as landmarks."""
AROUND = 8
"""Number of landmarks around from which it is learnt how likely a scan shows one."""
LIMIT = 12.25
"""Squared distance of an observation, in variances, that fits no better than none."""


class _Group(NamedTuple):
    """A landmark and those around (k,), and the rows (n,) of the observations near them.

    `begin` (s + 1,): where the rows of each scan begin, and the end; `odds` (s,): log odds that it
    shows a landmark here; `cost`: of a landmark, whether seen or not.
    """

    landmark: int
    some: Ints
    rows: Ints
    begin: Ints
    odds: Floats
    cost: float


@dataclass
class Mixture:
    """Observations in the frame of the map, and the landmarks to which they are assigned.

    `placed` (n, d), of scans (n,), ascending, and `positions` (m, d), both in the usual standard
    deviation; differences multiplied by `metric` (n, d, d) are in that of the observation; `own`
    (n,): landmark of each observation, or `NONE`; `exists` (m,).
    """

    placed: Floats
    metric: Floats
    scan: Ints
    own: Ints
    positions: Floats
    exists: Bools

    def fit(self) -> None:
        """Fit each landmark together with those around; those that the map lacks come last."""
        for group in self._groups():
            self._fit(group)
        found = np.flatnonzero(self.own != NONE)
        apart = self.placed[found] - self.positions[self.own[found]]
        off = np.sum(np.einsum("nij,nj->ni", self.metric[found], apart) ** 2, axis=1)
        self.own[found[off > LIMIT]] = NONE

    def settled(self) -> tuple[Floats, float]:
        """Return the likeliest positions (m, d) over all assignments, and the mean squared error.

        The means of the best assignments are biased apart where landmarks are closer to each other
        than the noise. The error is that of a coordinate.
        """
        import relmap.core.refinement.assignment.mixture_kernels as kernels

        settled, errors = self.positions.copy(), np.zeros(2)
        for landmark, some, rows, begin, odds, _ in self._groups():
            others = some[self.exists[some]]
            means, placed, metric = self.positions[others], self.placed[rows], self.metric[rows]
            errors += kernels.settle_few(placed, metric, begin, odds, means)
            own = others == landmark
            settled[others[own]] = means[own]
        return settled, errors[0] / (errors[1] * self.placed.shape[1])

    def _groups(self) -> Iterator[_Group]:
        m, tree = len(self.positions), cKDTree(self.positions)
        order = np.argsort(self.own, kind="stable")
        scans = np.split(self.scan[order], np.searchsorted(self.own[order], np.arange(m)))[1:]
        around = nearest(tree, self.positions, min(AROUND, m))[1]
        near = tree.query_ball_point(self.positions, REACH)
        seen = cKDTree(self.placed).query_ball_point(self.positions, REACH + BEYOND)
        for k in range(m):
            apart = np.sum((self.positions[near[k]] - self.positions[k]) ** 2, axis=1)
            some = np.sort(np.array(near[k])[np.argsort(apart, kind="stable")[:MOST]])
            rows = np.sort(np.array(seen[k], dtype=np.int64))
            rows = rows[np.isin(self.own[rows], [NONE, *some])]
            if self.exists[some].any() and len(rows):
                shown = np.concatenate([scans[j] for j in around[k]])
                yield _Group(k, some, rows, *self._shown(rows, shown))

    def _shown(self, rows: Ints, shown: Ints) -> tuple[Ints, Floats, float]:
        """Return where the rows of each scan begin, its log odds, and the cost of a landmark.

        `shown`: scans that show the landmarks around, once for each of them.
        """
        scans, begin = np.unique(self.scan[rows], return_index=True)
        every, times = np.unique(shown, return_counts=True)
        n_around = min(AROUND, len(self.positions))
        share = (np.minimum(times, n_around) + 0.5) / (n_around + 1)
        odds = np.full(len(scans), -np.log(2 * n_around + 1))
        at = np.searchsorted(every, scans).clip(0, len(every) - 1)
        odds = np.where(every[at] == scans, np.log(share / (1 - share))[at], odds)
        return np.append(begin, len(rows)), odds, -np.log1p(-share).sum()

    def _fit(self, group: _Group) -> None:
        import relmap.core.refinement.assignment.mixture_kernels as kernels

        _, some, rows, begin, odds, cost = group
        placed, metric, fits = self.placed[rows], self.metric[rows], []
        for start in self._starts(some, rows, begin):
            means, found = start.copy(), np.full(len(rows), NONE)
            likelihood = kernels.fit_few(placed, metric, begin, odds, cost, means, found)
            fits.append((likelihood, means, found))
        self._take(some, rows, *max(fits, key=lambda fit: fit[0])[1:])

    def _starts(self, some: Ints, rows: Ints, begin: Ints) -> list[Floats]:
        """Return positions (j, d) of landmarks, at most one more than `some`, to start from."""
        now, placed = self.positions[some[self.exists[some]]], self.placed[rows]
        fewer = [np.delete(now, k, axis=0) for k in range(len(now))] if len(now) > 1 else []
        fullest = np.argsort(-np.diff(begin), kind="stable")[:STARTS]
        shown = [placed[begin[k] : begin[k + 1]] for k in fullest]
        most = min(len(some) + 1, MOST)
        return [now, *fewer, *(points for points in shown if len(points) <= most)]

    def _take(self, some: Ints, rows: Ints, means: Floats, found: Ints) -> None:
        """Take over a fit; the landmarks keep the numbers of most of their observations.

        If there is one more than before, it is added.
        """
        from scipy.optimize import linear_sum_assignment

        if len(means) > len(some):
            some = np.append(some, len(self.positions))
            self.positions = np.append(self.positions, means[:1], axis=0)
            self.exists = np.append(self.exists, False)
        both = (found != NONE) & (self.own[rows] != NONE)
        shared = np.zeros((len(means), len(some)))
        np.add.at(shared, (found[both], np.searchsorted(some, self.own[rows[both]])), 1)
        number = np.full(len(means) + 1, NONE)  # the last one is that of no landmark
        number[:-1] = some[linear_sum_assignment(shared, maximize=True)[1]]
        self.own[rows] = number[found]
        self.exists[some] = False
        self.exists[number[:-1]] = True
        self.positions[number[:-1]] = means
