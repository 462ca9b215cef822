"""Joining submaps that show the same place.

Without ids, a stretch that cannot be matched to earlier scans starts a new submap. Some of these
return to places in other submaps. Neighbourhoods of one submap are searched for in all others at
once, and a certain match joins the two. So are whole submaps, whose common part may be small, where
the covariances of both tell how closely it must agree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints, evenly
from relmap.core.association.base import nearest
from relmap.core.association.placement import Placement
from relmap.core.association.reobservation.evidence import LOCAL_DRIFT
from relmap.core.association.reobservation.recognition import (
    BY_CHANCE,
    CLEAR,
    ENOUGH,
    SHARE,
    SIGMAS,
    PlaceFinder,
    triangles,
)
from relmap.core.association.reobservation.shapes import Shapes
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.joint import Refined
from relmap.core.state.table import NONE, LandmarkState

NEIGHBOURHOOD = 20
"""Number of landmarks in a neighbourhood."""
OVERLAP = 3
"""One in this many landmarks starts a neighbourhood even if it lies within another."""
APART = 4.0
"""Spacing at which submaps are laid out side by side, in sizes of the largest."""
TRIANGLES = 2000
"""Number of triangles of a submap that are compared, evenly chosen."""
WIDER, REGULAR = 4.0, 3.0
"""Wider tolerance of the sides of triangles, relative to that within which they are alike; and how
many times as many as in random worlds are alike where patterns repeat."""
NEARBY, FEWEST, SHARP = 0.85, 7, 0.1
"""Where patterns repeat, the fraction of the landmarks near those found that must be found, and how
many at least, as places that look alike differ in some; and the noise, in spacings, below which a
pattern is seen."""


def tie_submaps(
    global_map: GlobalMap,
    noise_m: float,
    drift: float = LOCAL_DRIFT,
    refined: Sequence[Refined] = (),
) -> Iterator[Ints]:
    """Join submaps that show the same place.

    `noise_m`: standard deviation of an observed coordinate; `drift`: variance of the drift of the
    map nearby, relative to that of an observation; `refined`: refined submaps, whose covariances
    decide, where known, how closely places must agree. Yields (k,): the landmarks of a submap that
    was just joined by another. Duplicates should be merged before the next search.
    """
    table, shapes = global_map.table, Shapes(refined, drift)
    submaps, sizes = np.unique(table.submap, return_counts=True)
    known = (submaps != NONE) & (sizes >= ENOUGH)

    @cache
    def regular() -> bool:
        return is_regular([(table.position[table.submap == k], noise_m) for k in submaps[known]])

    for submap in submaps[known][np.argsort(sizes[known], kind="stable")].tolist():
        found = _found_elsewhere(table, submap, noise_m, drift, shapes, regular)
        if found is not None:
            other, placement = found
            global_map.tie(submap, other, placement.R, placement.t)
            yield np.flatnonzero(table.submap == other)


def _found_elsewhere(
    table: LandmarkState,
    submap: int,
    noise_m: float,
    drift: float,
    shapes: Shapes,
    regular: Callable[[], bool],
) -> tuple[int, Placement] | None:
    """Return the submap that shows a place of this one, and the placement of this one in it."""
    own = np.flatnonzero(table.submap == submap)
    if not np.any((table.submap != submap) & (table.submap != NONE)):
        return None
    search = _Search(table, own, noise_m, drift, shapes, regular)
    each = (search.found(around, SHARE) for around in neighbourhoods(table.position[own]))
    found = next((one for one in each if one is not None), None)
    if found is None and shapes.know(own):
        found = search.found(np.arange(len(own)), share=0.0)
    return found


class _Search:
    """Searches places of a submap, of landmarks `own` (m,), in all other submaps."""

    def __init__(
        self,
        table: LandmarkState,
        own: Ints,
        noise_m: float,
        drift: float,
        shapes: Shapes,
        regular: Callable[[], bool],
    ) -> None:
        self._table, self._own, self._shapes = table, own, shapes
        self._others = np.flatnonzero(
            (table.submap != table.submap[own[0]]) & (table.submap != NONE)
        )
        positions, self._shifts, self._submap = _laid_out(table, self._others)
        self._finder, self._back = (
            PlaceFinder(there, noise_m, drift) for there in (positions, table.position[own])
        )
        # Noise that is large relative to the spacing makes any pattern look regular.
        self._regular = regular if noise_m < SHARP * self._finder.spacing_m else lambda: False

    def found(self, around: Ints, share: float) -> tuple[int, Placement] | None:
        """Return the submap that shows a place, landmarks (k,), and its placement there.

        At least a `share` of the landmarks; if 0, the covariances must be known.
        """
        finder, points = self._finder, self._table.position[self._own[around]]
        places = finder.places(points, share=share)
        found = [finder.landmarks_at(place.apply(points)) for place in places]
        hits = [np.unique(at[at >= 0]) for at in found]
        in_submaps = [np.unique(self._submap[hit]) for hit in hits]
        if not places or len(in_submaps[0]) > 1:
            return None
        other = int(in_submaps[0][0])
        rivals = [place for place, of in zip(places, in_submaps, strict=True) if other in of]
        # What looks like another place in the same submap may be a third one.
        back = self._back.elsewhere(points, self._back.places(points, share=share))
        elsewhere = max(finder.elsewhere(points, rivals), back)
        searches = len(self._own) + len(self._others)
        sure = finder.by_chance(len(points), len(hits[0]), elsewhere, searches) <= BY_CHANCE
        clear = elsewhere <= CLEAR * places[0].n_agreeing
        mine, its = self._own[around[found[0] >= 0]], found[0][found[0] >= 0]
        if not (sure and clear and self._fit(mine, its, share)):
            return None
        if self._regular() and not self._is_covered(places[0], other):
            return None
        return other, replace(places[0], t=places[0].t - self._shifts[other])

    def _is_covered(self, place: Placement, other: int) -> bool:
        """Return whether nearly all landmarks of both submaps around those found agree."""
        finder, own = self._finder, place.apply(self._table.position[self._own])
        its = self._table.position[self._others[self._submap == other]] + self._shifts[other]
        found = own[finder.landmarks_at(own) >= 0]
        around = [
            int(np.sum(nearest(cKDTree(found), each, 1)[0] <= finder.spacing_m))
            for each in (own, its)
        ]
        return len(found) >= max(FEWEST, NEARBY * max(around))

    def _fit(self, mine: Ints, its: Ints, share: float) -> bool:
        """Return whether landmarks (k,) are arranged as those in other submaps, rows (k,)."""
        others = self._others[its]
        agree = self._shapes.agree(mine, others)
        if agree is not None or not share:
            return bool(agree)
        averaged = self._table.weight[np.stack([mine, others])]
        return self._finder.is_close(self._table.position[mine], its, averaged, n_maps=2)


def _laid_out(table: LandmarkState, landmarks: Ints) -> tuple[Floats, dict[int, Floats], Ints]:
    """Return landmarks (n, d), their submaps side by side, the shifts, and the submaps (n,)."""
    positions, of = table.position[landmarks].copy(), table.submap[landmarks]
    size_m = float(np.max(np.abs(positions)))
    shifts = {}
    for k, submap in enumerate(np.unique(of).tolist()):
        shifts[submap] = np.zeros(positions.shape[1])
        shifts[submap][0] = APART * size_m * k
        positions[of == submap] += shifts[submap]
    return positions, shifts, of


def neighbourhoods(positions: Floats) -> Iterator[Ints]:
    """Yield the nearest landmarks (k,) to some of those at positions (n, d), covering all."""
    tree, had = cKDTree(positions), np.zeros(len(positions), dtype=bool)
    rank = min(NEIGHBOURHOOD, len(positions))
    for k in range(len(positions)):
        if not had[k]:
            around = nearest(tree, positions[k : k + 1], rank)[1][0]
            had[around[: max(1, rank // OVERLAP)]] = True
            yield around


def is_regular(submaps: Sequence[tuple[Floats, float]]) -> bool:
    """Return whether landmarks repeat patterns: far more of their triangles are nearly alike.

    The sides of random triangles differ by so little as rarely as by more, relative to the volume.
    `submaps`: positions (m, d) of each, and the standard deviation of an observed coordinate.
    """
    n_alike, n_near = 0, 0
    for positions, noise_m in submaps:
        corners, sides = triangles(positions)
        if len(corners) < 2:
            continue
        rows = evenly(len(corners), TRIANGLES)
        corners, sides = corners[rows], sides[rows]
        tolerance_m = SIGMAS * noise_m
        pairs = cKDTree(sides).query_pairs(WIDER * tolerance_m, output_type="ndarray")
        # Two tracks of one landmark form triangles that are alike in the same place.
        middle, longest_m = positions[corners].mean(axis=1)[pairs], sides[pairs[:, 0], -1]
        apart = np.linalg.norm(middle[:, 0] - middle[:, 1], axis=1) > longest_m / 2
        off = np.diff(sides[pairs[apart]], axis=1)
        n_alike += int(np.sum(np.linalg.norm(off, axis=2) <= tolerance_m))
        n_near += len(off)
    return n_alike + 0.5 > REGULAR * (n_near / WIDER**3 + 0.5)
