"""Assigning each observation of a refined map anew, where the noise makes single matches ambiguous.

Tracks that were matched scan by scan mix neighbouring landmarks there, and what they mix is mapped
where nothing is, or twice. The poses of a refined map are more accurate than any observation, so
all observations near a landmark are compared in one frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.mixture import Mixture
from relmap.core.refinement.observations import Observations, observations_of
from relmap.core.refinement.powers import PowerSolution
from relmap.core.state.table import NONE

ROUNDS = 2
"""Number of times the observations are assigned and the map is solved for."""


@dataclass
class _Assigned:
    """All observations, and the landmarks of a submap to which they are assigned.

    `points` (n, d), robot frame, and `positions` (m, d), metres; `when` (n,), ascending: iteration
    of each observation; `own` (n,): landmark, or `NONE`; `exists` (m,).
    """

    points: Floats
    when: Ints
    own: Ints
    positions: Floats
    noise_m: float
    exists: Bools

    def of_landmarks(self) -> Observations:
        """Return the observations of landmarks in scans that these determine."""
        every = np.arange(len(self.positions))
        return observations_of(self.points, self.own, self.when, every, self.positions)[0]

    def assign(self) -> Observations:
        """Assign the observations anew, and solve for the map; return those of landmarks."""
        rows, mixture = self._mixture()
        mixture.fit()
        self.own = np.full(len(self.points), NONE)
        self.own[rows], self.positions = mixture.own, mixture.positions * self.noise_m
        found = self.of_landmarks()
        if len(found.points):
            self.positions = PowerSolution.of(found, self.positions).towards(2).state.positions
        return found

    def settle(self, found: Observations) -> None:
        """Move the landmarks to the likeliest positions, with the noise as it is then."""
        d, n = self.points.shape[1], found.points.size
        known = d * self.exists.sum() + d * (d + 1) // 2 * len(found.iterations)
        square = self._mixture()[1].settled()[1] * n / max(n - known, 1)
        self.noise_m *= np.sqrt(square)
        self.positions = self._mixture()[1].settled()[0] * self.noise_m

    def _mixture(self) -> tuple[Ints, Mixture]:
        """Return the rows (k,) of the scans that landmarks determine, and where they are."""
        found = self.of_landmarks()
        R, t, fixed = found.placed_on(self.positions)
        at = np.searchsorted(found.iterations, self.when).clip(0, len(fixed) - 1)
        rows = np.flatnonzero((found.iterations[at] == self.when) & fixed[at])
        scan, unit = at[rows], self.noise_m
        placed = np.einsum("nij,nj->ni", R[scan], self.points[rows]) + t[scan]
        own, positions = self.own[rows], self.positions / unit
        return rows, Mixture(placed / unit, scan, own, positions, self.exists)


def reassign(refined: Refined, points: Floats, seen: Ints, when: Ints) -> tuple[Refined, Ints]:
    """Return a refined submap with each observation assigned anew to a landmark of it.

    Landmarks that explain no more than one observation are left out; the submap stays as it is if
    single scans, or what is left, do not determine it. The covariances are those of the refined
    submap.

    `points` (n, d), robot frame, metres; `seen` (n,): landmark of each observation; `when` (n,),
    ascending: its iteration. Returns also the landmarks (n,) to which they are assigned, or `NONE`.
    """
    m, names = len(refined.landmarks), np.append(refined.landmarks, NONE)
    at = np.searchsorted(refined.landmarks, seen).clip(0, m - 1)
    before, exists = np.where(refined.landmarks[at] == seen, at, NONE), np.ones(m, dtype=np.bool_)
    new = _Assigned(points, when, before, refined.positions, refined.noise_m, exists)
    found = new.of_landmarks()
    for _ in range(ROUNDS if refined.noise_m > 0 else 0):
        found = new.assign() if len(found.points) else found
    exists &= np.bincount(found.landmark, minlength=m) > 1
    if exists.sum() <= points.shape[1]:
        return refined, names[before]
    if refined.noise_m > 0:
        new.settle(found)
    R, t = fit_rigid(new.positions[exists], refined.positions[exists])
    moved = replace(refined.only(exists), positions=new.positions[exists] @ R.T + t)
    return moved, names[new.own]
