"""Localising a scan of walls in a map.

Placements in which many walls of the scan lie on walls of the map (`wall_tie`) are scored by its
beams. A placement is accepted only if it explains the scan and no other one scores nearly as well.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
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


def place_among(seen: PlaneObservation, ends: Floats) -> Place:
    """Localise a scan among walls (w, 2, 2), map frame, metres: right and left end of each.

    `seen`: with its beams; without them no placement is accepted.
    """
    every = 1 + len(seen.beams.points) // BEAMS
    points = seen.beams.points[::every].astype(np.float64)
    near = np.abs(seen.ends).max(axis=(1, 2), initial=0.0) <= FAR_M
    ties = wall_ties(seen.ends[near], ends)[:PLACES] if _may_hold(ends, points) else []
    nowhere = np.full((4, 4), np.nan)
    if not ties:
        return Place(nowhere, 0)
    on, through = np.array([_beams_on(ends, tie, points, seen.beams.origin) for tie in ties]).T
    overlap_m, explained = np.array([tie.length_m for tie in ties]), on - through
    share = overlap_m / float(seen.size[near].sum())
    best, is_few = int(np.argmax(explained + share)), int(near.sum()) < FEW
    fits = _may_fit(share[best], explained[best], through[best], is_few)
    if overlap_m[best] < LEAST_M or not fits:
        return Place(nowhere, 0)
    others, own = np.delete(explained + share, best), explained[best] + share[best]
    has_rival = others.max(initial=0.0) > RIVAL_PLACE * own
    if not is_few and through[best] <= NO_BEAM and explained[best] >= NEARLY_ALL:
        lead = explained[best] - np.delete(explained, best).max(initial=0.0)
        has_rival &= lead < AHEAD
    if ties[best].across < ACROSS or has_rival:
        return Place(nowhere, 2)
    return Place(ties[best].matrix, 1)


def _may_hold(ends: Floats, points: Floats) -> bool:
    """Return whether as many points (n, 2) as must end on walls lie as close together."""
    if not (len(points) and len(ends)):
        return False
    across_m = np.linalg.norm(np.ptp(ends.reshape(-1, 2), axis=0)) + 3 * ENDS_M
    n, at = max(int(LOW_EXPLAINED * len(points)), 1), np.sort(points, axis=0)
    closest_m = (at[n - 1 :] - at[: len(at) - n + 1]).min(axis=0)
    return bool((closest_m <= across_m).all())


def _beams_on(ends: Floats, tie: WallTie, points: Floats, origin: Floats) -> tuple[float, float]:
    """Return the fractions of beams that end on walls, and that go through one.

    The beams go from `origin` (2,) to `points` (n, 2), robot frame.
    """
    from relmap.planes.scans.loose_kernels import on_walls

    origin, points = tie.R @ origin + tie.t, points @ tie.R.T + tie.t
    beam, wall, to_wall = points - origin, ends[:, 1] - ends[:, 0], ends[:, 0] - origin
    length, size = np.hypot(*beam.T), np.hypot(*wall.T)
    crossing = beam[:, :1] * wall[:, 1] - beam[:, 1:] * wall[:, 0]
    crossing[crossing == 0.0] = np.nan
    along_beam = (to_wall[:, 0] * wall[:, 1] - to_wall[:, 1] * wall[:, 0]) / crossing
    along_wall = to_wall[:, 0] * beam[:, 1:] - to_wall[:, 1] * beam[:, :1]
    at_m = along_wall / crossing * size
    met = (along_beam > 0) & (along_beam * length[:, None] < length[:, None] - BEYOND_M)
    through = (met & (at_m > RIM_M) & (at_m < size - RIM_M)).any(axis=1)
    return float(on_walls(points, ends, ENDS_M).mean()), float(through.mean())


def _may_fit(share: float, explained: float, through: float, is_few: bool) -> bool:
    """Return whether a placement explains a scan, if no other one scores nearly as well.

    By the fraction of its walls that lie on walls of the map, of its beams that end on walls, minus
    that of beams through one, and the latter; and whether it has few walls.
    """
    fits = share >= SHARE and explained >= EXPLAINED
    if is_few:
        return fits and explained >= WHOLLY
    low = share >= LOW_SHARE and explained >= LOW_EXPLAINED
    return fits or (low and through <= THROUGH)
