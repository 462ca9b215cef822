"""Assigning each observation of a refined map anew, where the noise makes single matches ambiguous.

Tracks that were matched scan by scan mix neighbouring landmarks there, and what they mix is mapped
where nothing is, or twice. The poses of a refined map are more accurate than any observation, so
all observations near a landmark are compared in one frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.refinement.assignment.mixture import Mixture
from relmap.core.refinement.chain.chain_data import Chained
from relmap.core.refinement.chain.weighed import solve_weighed
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.observations import observations_of
from relmap.core.refinement.powers import Placed, PowerSolution
from relmap.core.state.table import NONE

ROUNDS = 2
"""Number of times the observations are assigned and the map is solved for."""


@dataclass
class _Assigned:
    """All observations, and the landmarks of a submap to which they are assigned.

    `points` (n, d), robot frame, and `positions` (m, d), metres; `when` (n,), ascending: iteration
    of each observation; `own` (n,): landmark, or `NONE`; `noise` (n, d, d): covariances, relative
    to the variance `noise_m`^2, or None if they are equal.
    """

    points: Floats
    when: Ints
    own: Ints
    noise: Floats | None
    noise_m: float
    positions: Floats

    def solve(self) -> bool:
        """Solve for the map and the poses; return whether observations determine them."""
        (m, d), at = self.positions.shape, self.positions
        found, rows = observations_of(self.points, self.own, self.when, np.arange(m), at)
        seen = np.bincount(found.landmark, minlength=m)
        self.exists, some = seen > 1, np.flatnonzero(seen)
        if self.exists.sum() <= d:
            return False
        found = replace(found, landmark=np.searchsorted(some, found.landmark))
        state: Placed | Chained
        if self.noise is None:
            state = PowerSolution.of(found, at[some]).towards(2).state
        else:
            noise = self.noise[rows] * self.noise_m**2
            state = solve_weighed(found, noise, at[some], 0)[1].state
        at[some], self._R, self._t = state.positions, state.R, state.t
        self._iterations = found.iterations
        return True

    def assign(self) -> None:
        """Assign the observations of iterations with known poses anew."""
        rows, mixture = self._mixture()
        mixture.fit()
        self.own = np.full(len(self.points), NONE)
        self.own[rows], self.positions = mixture.own, mixture.positions * self.noise_m

    def settle(self) -> None:
        """Move the landmarks to the likeliest positions, with the noise as it is then."""
        mixture, d = self._mixture()[1], self.points.shape[1]
        n = d * np.count_nonzero(mixture.own != NONE)
        known = d * self.exists.sum() + d * (d + 1) // 2 * len(self._iterations)
        self.noise_m *= np.sqrt(mixture.settled()[1] * n / max(n - known, 1))
        self.positions = self._mixture()[1].settled()[0] * self.noise_m

    def _mixture(self) -> tuple[Ints, Mixture]:
        """Return the rows (n,) of the iterations with known poses, and where they are."""
        at = np.searchsorted(self._iterations, self.when).clip(0, len(self._iterations) - 1)
        rows = np.flatnonzero(self._iterations[at] == self.when)
        scan, R, unit = at[rows], self._R[at[rows]], self.noise_m
        placed = np.einsum("nij,nj->ni", R, self.points[rows]) + self._t[scan]
        metric = np.swapaxes(R, 1, 2)
        if self.noise is not None:
            metric = np.linalg.inv(np.linalg.cholesky(self.noise[rows])) @ metric
        own, positions = self.own[rows], self.positions / unit
        return rows, Mixture(placed / unit, metric, scan, own, positions, self.exists)


def reassign(
    refined: Refined, points: Floats, seen: Ints, when: Ints, covariances: Floats | None
) -> Refined:
    """Return a refined submap with each observation assigned anew to a landmark of it.

    Landmarks that explain no more than one observation are left out, and so are those that were
    added, which have no track. The submap stays as it is if single scans, or what is left, do not
    determine it. The covariances are those of the refined submap. Parameters as of `reassigned`.
    """
    new, determined = _assigned(refined, points, seen, when, covariances)
    if not determined:
        return refined
    new.settle()
    exists = new.exists[: len(refined.landmarks)]
    moved = new.positions[: len(exists)][exists]
    R, t = fit_rigid(moved, refined.positions[exists])
    return replace(refined.only(exists), positions=moved @ R.T + t)


def reassigned(
    refined: Refined, points: Floats, seen: Ints, when: Ints, covariances: Floats | None
) -> Ints:
    """Return the landmarks (n,) of a refined submap to which observations are assigned, or `NONE`.

    `points` (n, d), robot frame, metres; `seen` (n,): landmark of each observation; `when` (n,),
    ascending: its iteration; `covariances` (n, d, d), square metres, or None if the noise is
    equal.
    """
    new, _ = _assigned(refined, points, seen, when, covariances)
    landmarks = np.full(len(new.positions) + 1, NONE)  # the last one is that of no landmark
    landmarks[: len(refined.landmarks)] = refined.landmarks
    return landmarks[new.own]


def _assigned(
    refined: Refined, points: Floats, seen: Ints, when: Ints, covariances: Floats | None
) -> tuple[_Assigned, bool]:
    """Return a new assignment, or the former one, and whether single scans determine it."""
    at = np.searchsorted(refined.landmarks, seen).clip(0, len(refined.landmarks) - 1)
    own, noise_m, noise = np.where(refined.landmarks[at] == seen, at, NONE), refined.noise_m, None
    if covariances is not None:
        variance = np.trace(covariances, axis1=1, axis2=2).mean() / points.shape[1]
        noise_m, noise = float(np.sqrt(variance)), covariances / variance
    new = _Assigned(points, when, own, noise, noise_m, refined.positions.copy())
    determined = noise_m > 0 and new.solve()
    for _ in range(ROUNDS if determined else 0):
        new.assign()
        if not new.solve():
            new.own = own
            return new, False
    return new, determined
