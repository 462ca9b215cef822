"""Localising a scan of walls in a map.

Placements in which many walls of the scan lie on walls of the map (`wall_tie`) are scored by its
beams. A placement is accepted only if it explains the scan and no other one scores nearly as well.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.mapper import Place
from relmap.planes.places.wall_tie import ACROSS, WallTie, wall_ties
from relmap.planes.scans.observation import PlaneObservation

PLACES = 12
"""Placements that are scored, those with the longest matched walls first."""
BEAMS = 400
"""Approximate number of beams used for scoring."""
NEAR_M = 0.1
"""Maximum distance of the end of a beam from the wall it ends on."""
BEYOND_M, RIM_M = 0.3, 0.1
"""A beam that continues this far behind a wall, away from the ends of the wall, contradicts it."""
LEAST_M, SHARE = 3.0, 0.5
"""Length of wall, and fraction of the walls of the scan, that must lie on walls of the map."""
EXPLAINED = 0.7
"""Minimum fraction of beams that end on walls, minus the fraction that go through one."""
RIVAL = 0.6
"""Maximum score of another placement, as a fraction of the best."""


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
        ties, worth, fits = self._judged(seen)
        best = int(np.argmax(worth)) if len(ties) else -1
        if best < 0 or not fits[best]:
            return Place(nowhere, 0)
        slides = ties[best].across < ACROSS
        if slides or np.delete(worth, best).max(initial=0.0) > RIVAL * worth[best]:
            return Place(nowhere, 2)
        return Place(ties[best].matrix, 1)

    def places(self, seen: PlaneObservation) -> Floats:
        """Return all poses ``T_map_robot`` (k, 4, 4) that explain a scan and do not slide."""
        ties, _, fits = self._judged(seen)
        held = [ties[k].matrix for k in np.flatnonzero(fits) if ties[k].across >= ACROSS]
        return np.array(held).reshape(-1, 4, 4)

    def _judged(self, seen: PlaneObservation) -> tuple[list[WallTie], Floats, Bools]:
        """Return the likely placements (k,) of a scan, their scores, and which explain it."""
        ties = wall_ties(seen.ends, self._ends)[:PLACES] if len(seen.beams.points) else []
        length_m = float(seen.size.sum())
        overlap_m = np.array([tie.length_m for tie in ties])
        explained = np.array([self._explained(tie, seen) for tie in ties])
        fits = (explained >= EXPLAINED) & (overlap_m >= max(LEAST_M, SHARE * length_m))
        return ties, explained + overlap_m / length_m, fits

    def _explained(self, tie: WallTie, seen: PlaneObservation) -> float:
        """Return the fraction of beams that end on walls, minus that of beams through one."""
        from relmap.planes.scans.loose_kernels import on_walls

        every = 1 + len(seen.beams.points) // BEAMS
        points = seen.beams.points[::every].astype(np.float64) @ tie.R.T + tie.t
        on = on_walls(points, self._ends, NEAR_M)
        return float(on.mean() - self._through(tie.R @ seen.beams.origin + tie.t, points).mean())

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
