"""Localising a scan of walls in a map.

Placements in which many walls of the scan lie on walls of the map (`wall_tie`) are scored by its
beams. A placement is accepted only if it explains the scan and no other one scores nearly as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.mapper import Place
from relmap.planes.places.wall_tie import ACROSS, WallTie, wall_ties
from relmap.planes.scans.observation import PlaneObservation

PLACES = 12
"""Placements that are scored, those with the longest matched walls first."""
BEAMS = 400
"""Approximate number of beams used for scoring."""
ENDS_M = 0.1
"""Maximum distance of the end of a beam from the wall it ends on."""
BEYOND_M, RIM_M = 0.3, 0.1
"""A beam that continues this far behind a wall, away from the ends of the wall, contradicts it."""
LEAST_M, SHARE, EXPLAINED = 3.0, 0.5, 0.7
"""Length of wall, and fraction of the walls of the scan, that must lie on walls of the map; and
minimum fraction of beams that end on walls, minus the fraction that go through one."""
LOW_SHARE, LOW_EXPLAINED, THROUGH = 0.3, 0.5, 0.02
"""The same for a placement without rival if at most this fraction of the beams goes through walls:
a map lacks what clutters a room, and what moved."""
FEW, WHOLLY = 5, 0.9
"""A scan of fewer than `FEW` walls must be explained to the fraction `WHOLLY`: many places have a
few walls alike."""
FAR_M = 500.0
"""Maximum distance of the walls of a scan that are compared: no laser sees farther."""
RIVAL_PLACE = 0.58
"""Maximum score of another placement, as a fraction of the best."""
NEARLY_ALL, NO_BEAM, AHEAD = 0.9, 0.005, 0.3
"""A placement that explains this fraction of the beams, with no beam through a wall, need only
explain a fraction `AHEAD` more than any other: alike rooms share most of their walls."""


@dataclass(frozen=True, eq=False)
class JudgedPlaces:
    """Placements of a scan in a map.

    `explained`, `through` (k,): fraction of the beams that end on walls, minus that of beams
    through one, and the latter; `overlap_m` (k,): length of the walls of the scan that lie on walls
    of the map, out of `length_m` of `n_walls`.
    """

    ties: list[WallTie]
    explained: Floats
    through: Floats
    overlap_m: Floats
    length_m: float
    n_walls: int

    @property
    def share(self) -> Floats:
        """Fraction of the walls of the scan that lie on walls of the map, (k,)."""
        return self.overlap_m / self.length_m

    @property
    def worth(self) -> Floats:
        """Score of each placement, (k,)."""
        return self.explained + self.share

    @property
    def may_fit(self) -> Bools:
        """Which placements (k,) explain the scan, if no other one scores nearly as well."""
        long, explained = self.overlap_m >= LEAST_M, self.explained
        fits = long & (self.share >= SHARE) & (explained >= EXPLAINED)
        if self.n_walls < FEW:
            return fits & (explained >= WHOLLY)
        low = long & (self.share >= LOW_SHARE) & (explained >= LOW_EXPLAINED)
        return fits | low & (self.through <= THROUGH)

    def has_rival(self, best: int) -> bool:
        """Return whether another placement scores nearly as well as the best one."""
        is_whole = self.n_walls >= FEW and self.through[best] <= NO_BEAM
        if is_whole and self.explained[best] >= NEARLY_ALL:
            lead = self.explained[best] - np.delete(self.explained, best).max(initial=0.0)
            if lead >= AHEAD:
                return False
        others = np.delete(self.worth, best).max(initial=0.0)
        return bool(others > RIVAL_PLACE * self.worth[best])


class WallFinder:
    """Finds scans among the walls of a map.

    `ends` (w, 2, 2), map frame, metres: right and left end of each wall, as seen from its front.
    """

    def __init__(self, ends: Floats) -> None:
        self._ends = np.ascontiguousarray(ends)

    def find(self, seen: PlaneObservation) -> Place:
        """Localise a scan.

        `seen`: with its beams; without them no placement is accepted.
        """
        nowhere = np.full((4, 4), np.nan)
        judged = self._judged(seen)
        best = int(np.argmax(judged.worth)) if judged.ties else -1
        if best < 0 or not judged.may_fit[best]:
            return Place(nowhere, 0)
        if judged.ties[best].across < ACROSS or judged.has_rival(best):
            return Place(nowhere, 2)
        return Place(judged.ties[best].matrix, 1)

    def _judged(self, seen: PlaneObservation) -> JudgedPlaces:
        """Return the likely placements of a scan."""
        every = 1 + len(seen.beams.points) // BEAMS
        points = seen.beams.points[::every].astype(np.float64)
        near = np.abs(seen.ends).max(axis=(1, 2), initial=0.0) <= FAR_M
        ties = wall_ties(seen.ends[near], self._ends)[:PLACES] if self._may_hold(points) else []
        beams = [self._beams(tie, points, seen.beams.origin) for tie in ties]
        on, through = np.array(beams).reshape(-1, 2).T
        overlap_m = np.array([tie.length_m for tie in ties])
        length_m, n_walls = float(seen.size[near].sum()), int(near.sum())
        return JudgedPlaces(ties, on - through, through, overlap_m, length_m, n_walls)

    def _may_hold(self, points: Floats) -> bool:
        """Return whether as many points (n, 2) as must end on walls lie as close together."""
        if not (len(points) and len(self._ends)):
            return False
        across_m = np.linalg.norm(np.ptp(self._ends.reshape(-1, 2), axis=0)) + 3 * ENDS_M
        n, at = max(int(LOW_EXPLAINED * len(points)), 1), np.sort(points, axis=0)
        closest_m = (at[n - 1 :] - at[: len(at) - n + 1]).min(axis=0)
        return bool((closest_m <= across_m).all())

    def _beams(self, tie: WallTie, points: Floats, origin: Floats) -> tuple[float, float]:
        """Return the fractions of beams that end on walls, and that go through one.

        The beams go from `origin` (2,) to `points` (n, 2), robot frame.
        """
        from relmap.planes.scans.loose_kernels import on_walls

        points = points @ tie.R.T + tie.t
        on = on_walls(points, self._ends, ENDS_M)
        return float(on.mean()), float(self._through(tie.R @ origin + tie.t, points).mean())

    def _through(self, origin: Floats, points: Floats) -> Floats:
        """Return which beams from the origin (2,) to points (n, 2) go through a wall."""
        beam, wall = points - origin, self._ends[:, 1] - self._ends[:, 0]
        length, size = np.hypot(*beam.T), np.hypot(*wall.T)
        to_wall = self._ends[:, 0] - origin
        crossing = beam[:, :1] * wall[:, 1] - beam[:, 1:] * wall[:, 0]
        crossing[crossing == 0.0] = np.nan
        along_beam = (to_wall[:, 0] * wall[:, 1] - to_wall[:, 1] * wall[:, 0]) / crossing
        along_wall = to_wall[:, 0] * beam[:, 1:] - to_wall[:, 1] * beam[:, :1]
        at_m = along_wall / crossing * size
        met = (along_beam > 0) & (along_beam * length[:, None] < length[:, None] - BEYOND_M)
        return np.asarray((met & (at_m > RIM_M) & (at_m < size - RIM_M)).any(axis=1))
