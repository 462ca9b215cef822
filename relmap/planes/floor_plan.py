"""The floor plan: the walls of a submap that are there, each of them once and as long as it is.

A wall is drawn where scans saw it and beams ended on it rather than went through; the poses serve
to judge that, not to place anything.  Where two walls look the same way side by side, the one that
was seen more stands.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.planes.assembly import OFTEN, WallNumbers
from relmap.planes.beams import BeamStore
from relmap.planes.history import PlaneHistory
from relmap.planes.plan_evidence import BIN_M, Stretches, stretches_of
from relmap.planes.plan_pieces import SHORTEST_M, Pieces, met, with_corners, without_clutter
from relmap.planes.plan_walls import drawn_walls
from relmap.planes.regrouping import regrouped
from relmap.planes.submaps import WallSubmap

SEEN = 3
"""Sights of a stretch of a wall that is there; the one seen most has as many as a wall needs."""
AGAINST = 0.7
"""Beams that say no wall is there, for each that ends on it, that are believed."""
SOLID = 0.7
"""Least share of the beams towards a wall that must end on it."""
GAP_M = 0.5
"""A gap longer than this is one, though no beam went through."""
DOUBLED_M, PARALLEL = 0.12, np.cos(np.deg2rad(12.0))
"""A wall is the double of another that is no farther off and turned by no more (cosine)."""


def floor_plan(
    submap: WallSubmap,
    numbers: WallNumbers,
    history: PlaneHistory,
    beams: BeamStore,
    moving: NDArray[np.bool_],
) -> tuple[WallSubmap, WallNumbers, NDArray[np.int64]]:
    """Return a submap with the walls of its floor plan alone; one without walls as it is.

    Parameters
    ----------
    submap : WallSubmap
    numbers : WallNumbers
        The association in it.
    history : PlaneHistory
    beams : BeamStore
        Where there are none, what scans saw of walls has to do.
    moving : (p,) bool
        Plane tracks that move.

    Returns
    -------
    submap : WallSubmap
    numbers : WallNumbers
    moved : (m,) int64
        Tracks that turned out to have moved.
    """
    if submap.assembled is None:
        return submap, numbers, np.empty(0, dtype=np.int64)
    walls, numbers, moved = regrouped(submap, numbers, history, moving)
    stretches = stretches_of(walls, submap.poses, submap.span, beams)
    pieces = with_corners(_pieces(stretches, _standing(stretches)), walls)
    pieces = without_clutter(met(pieces, stretches), stretches)
    drawn, numbers = drawn_walls(walls, pieces, numbers, history)
    return WallSubmap.of(submap.span, submap.poses, drawn, submap.refined), numbers, moved


def _standing(walls: Stretches) -> NDArray[np.bool_]:
    """Tell where walls are (b,): seen, not seen through, and not the double of a stronger one."""
    hits, against = _around(walls.hits, 1), _around(walls.against, 1)
    no_wall = (against > AGAINST * hits) & (against > 1)
    there = (walls.seen >= SEEN) & ~no_wall
    if walls.hits.any():
        there &= _around(walls.hits, 2) > 0
    doubled = _doubled(walls, there)
    there &= ~doubled
    return there | _small_gaps(walls, there, no_wall | doubled)


def _around(counts: NDArray[np.int64], beside: int) -> NDArray[np.int64]:
    """Return counts with those of some stretches on either side; rims keep walls apart."""
    return np.asarray(np.convolve(counts, np.ones(2 * beside + 1, dtype=np.int64), "same"))


def _doubled(walls: Stretches, there: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell where a wall (b,) lies beside another that looks the same way and was seen more."""
    wall, half = walls.wall, BIN_M * np.diff(walls.first) / 2
    points = walls.base[wall] + walls.place[:, None] * walls.along[wall]
    middle = walls.base + (walls.low + half)[:, None] * walls.along
    seen = np.bincount(wall, np.where(there, walls.seen, 0), minlength=len(half))
    beside_m = DOUBLED_M + half * np.sqrt(1 - PARALLEL**2)
    doubled, order = np.zeros(len(wall), dtype=np.bool_), np.argsort(-seen, kind="stable")
    for rank, k in enumerate(order.tolist()):
        others, own = order[:rank], slice(walls.first[k], walls.first[k + 1])
        offset = middle[others] - middle[k]
        near = np.abs(offset @ walls.along[k]) < half[others] + half[k]
        near &= np.abs(offset @ walls.normal[k]) < beside_m[others]
        near &= walls.normal[others] @ walls.normal[k] > PARALLEL
        for other in others[near].tolist():
            off = points[own] - walls.base[other]
            at = ((off @ walls.along[other] - walls.low[other]) / BIN_M).astype(np.int64)
            at = walls.first[other] + np.clip(at, 0, np.diff(walls.first)[other] - 1)
            beside = np.abs(off @ walls.normal[other]) < DOUBLED_M
            doubled[own] |= there[at] & ~doubled[at] & beside
    return doubled


def _small_gaps(
    walls: Stretches, there: NDArray[np.bool_], known: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Tell which stretches (b,) are gaps within a wall of which it is not known that they are."""
    begin, end = _runs(~there & ~known)
    inside = (begin > 0) & (end < len(there)) & (BIN_M * (end - begin) <= GAP_M)
    begin, end = begin[inside], end[inside]
    inside = there[begin - 1] & there[end] & (walls.wall[begin - 1] == walls.wall[end])
    change = np.zeros(len(there) + 1, dtype=np.int64)
    change[begin[inside]] = 1
    change[end[inside]] = -1
    return np.asarray(np.cumsum(change)[:-1] > 0)


def _runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where runs of True begin and where they end."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return edges[::2], edges[1::2]


def _pieces(walls: Stretches, there: NDArray[np.bool_]) -> Pieces:
    """Return the parts of walls that are there, without those that are hardly so."""
    begin, end = _runs(there)
    sums = [np.append(0, np.cumsum(counts)) for counts in (walls.hits, walls.against)]
    hits, against = (total[end] - total[begin] for total in sums)
    bounds = np.column_stack([begin, end]).ravel()
    most = np.maximum.reduceat(np.append(walls.seen, 0), bounds)[::2] if len(begin) else begin
    kept = (hits >= SOLID * (hits + against)) & (most >= OFTEN)
    kept &= BIN_M * (end - begin) >= SHORTEST_M
    begin, end = begin[kept], end[kept]
    low = walls.place[begin] - BIN_M / 2
    reach = np.column_stack([low, low + BIN_M * (end - begin)])
    return Pieces(walls.wall[begin], reach, np.full((len(begin), 2), -1))
