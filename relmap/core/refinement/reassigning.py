"""Assigning each observation of a refined map anew, where the noise makes single matches ambiguous.

Tracks that were matched scan by scan mix neighbouring landmarks there, and what they mix is mapped
where nothing is, or twice. The poses of a refined map are more accurate than any observation, so
all observations near a landmark are compared in one frame: where landmarks are, and how many, is a
mixture with known noise in which a scan shows each landmark at most once. It is fitted with whole
assignments (Celeux and Govaert, 1992), from several starts, as its optima are local.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import nearest
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.observations import Observations, observations_of
from relmap.core.refinement.powers import PowerSolution
from relmap.core.state.table import NONE

ROUNDS = 2
"""Number of times the observations are assigned and the map is solved for."""
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


@dataclass
class _Mixture:
    """Observations in the frame of the map, and the landmarks to which they are assigned.

    `placed` (n, d), of scans (n,), ascending, and `positions` (m, d), both in standard deviations
    of an observation; `own` (n,): landmark of each observation, or `NONE`; `exists` (m,).
    """

    placed: Floats
    scan: Ints
    own: Ints
    positions: Floats
    exists: Bools

    def fit(self) -> None:
        """Fit each landmark together with those around."""
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
                self._fit(some, rows, np.concatenate([scans[j] for j in around[k]]))
        found = np.flatnonzero(self.own != NONE)
        off = self.placed[found] - self.positions[self.own[found]]
        self.own[found[np.sum(off**2, axis=1) > LIMIT]] = NONE

    def _fit(self, some: Ints, rows: Ints, shown: Ints) -> None:
        """Fit some landmarks (k,), given rows of observations.

        `shown`: scans that show the landmarks around, once for each of them.
        """
        import relmap.core.refinement.reassigning_kernels as kernels

        scans, begin = np.unique(self.scan[rows], return_index=True)
        every, times = np.unique(shown, return_counts=True)
        n_around = min(AROUND, len(self.positions))
        share = (np.minimum(times, n_around) + 0.5) / (n_around + 1)
        cost, odds = -np.log1p(-share).sum(), np.full(len(scans), -np.log(2 * n_around + 1))
        at = np.searchsorted(every, scans).clip(0, len(every) - 1)
        odds = np.where(every[at] == scans, np.log(share / (1 - share))[at], odds)
        begin, placed = np.append(begin, len(rows)), self.placed[rows]
        fits = []
        for start in self._starts(some, rows, begin):
            means, found = start.copy(), np.full(len(rows), NONE)
            likelihood = kernels.fit_few(placed, begin, odds, cost, LIMIT, means, found)
            fits.append((likelihood, means, found))
        self._take(some, rows, *max(fits, key=lambda fit: fit[0])[1:])

    def _starts(self, some: Ints, rows: Ints, begin: Ints) -> list[Floats]:
        """Return positions (j, d) of landmarks, at most as many as `some`, to start from."""
        now, placed = self.positions[some[self.exists[some]]], self.placed[rows]
        fewer = [np.delete(now, k, axis=0) for k in range(len(now))] if len(now) > 1 else []
        fullest = np.argsort(-np.diff(begin), kind="stable")[:STARTS]
        shown = [placed[begin[k] : begin[k + 1]] for k in fullest]
        return [now, *fewer, *(points for points in shown if len(points) <= len(some))]

    def _take(self, some: Ints, rows: Ints, means: Floats, found: Ints) -> None:
        """Take over a fit; the landmarks keep the numbers of most of their observations."""
        from scipy.optimize import linear_sum_assignment

        both = (found != NONE) & (self.own[rows] != NONE)
        shared = np.zeros((len(means), len(some)))
        np.add.at(shared, (found[both], np.searchsorted(some, self.own[rows[both]])), 1)
        number = np.full(len(means) + 1, NONE)  # the last one is that of no landmark
        number[:-1] = some[linear_sum_assignment(shared, maximize=True)[1]]
        self.own[rows] = number[found]
        self.exists[some] = False
        self.exists[number[:-1]] = True
        self.positions[number[:-1]] = means


def reassign(refined: Refined, points: Floats, seen: Ints, when: Ints) -> tuple[Refined, Ints]:
    """Return a refined submap with each observation assigned anew to a landmark of it.

    Landmarks that explain no more than one observation are left out; the submap stays as it is if
    single scans, or what is left, do not determine it. The covariances are those of the refined
    submap.

    `points` (n, d), robot frame, metres; `seen` (n,): landmark of each observation; `when` (n,),
    ascending: its iteration. Returns also the landmarks (n,) to which they are assigned, or `NONE`.
    """
    m, noise_m, positions = len(refined.landmarks), refined.noise_m, refined.positions
    at = np.searchsorted(refined.landmarks, seen).clip(0, m - 1)
    own = np.where(refined.landmarks[at] == seen, at, NONE)
    before, exists = own, np.ones(m, dtype=np.bool_)
    found = _of_landmarks(points, own, when, positions)
    for _ in range(ROUNDS if noise_m > 0 and len(found.points) else 0):
        rows, scan, placed = _placed(found, points, when, positions)
        mixture = _Mixture(placed / noise_m, scan, own[rows], positions / noise_m, exists)
        mixture.fit()
        own = np.full(len(points), NONE)
        own[rows], positions = mixture.own, mixture.positions * noise_m
        found = _of_landmarks(points, own, when, positions)
        if not len(found.points):
            break
        positions = PowerSolution.of(found, positions).towards(2).state.positions
    exists &= np.bincount(found.landmark, minlength=m) > 1
    if exists.sum() <= points.shape[1]:
        return refined, np.append(refined.landmarks, NONE)[before]
    R, t = fit_rigid(positions[exists], refined.positions[exists])
    moved = replace(refined.only(exists), positions=positions[exists] @ R.T + t)
    return moved, np.append(refined.landmarks, NONE)[own]


def _of_landmarks(points: Floats, own: Ints, when: Ints, positions: Floats) -> Observations:
    return observations_of(points, own, when, np.arange(len(positions)), positions)[0]


def _placed(
    found: Observations, points: Floats, when: Ints, positions: Floats
) -> tuple[Ints, Ints, Floats]:
    """Return the rows (k,) of the scans that landmarks determine, these scans, and the positions.

    `found`: the observations of landmarks; of the others, too, the positions (k, d) in the frame of
    the map are returned.
    """
    R, t, fixed = found.placed_on(positions)
    at = np.searchsorted(found.iterations, when).clip(0, len(fixed) - 1)
    rows = np.flatnonzero((found.iterations[at] == when) & fixed[at])
    scan = at[rows]
    return rows, scan, np.einsum("nij,nj->ni", R[scan], points[rows]) + t[scan]
