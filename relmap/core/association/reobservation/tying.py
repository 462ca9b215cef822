"""Joining submaps that show the same place.

Without ids, a stretch that cannot be matched to earlier scans starts a new submap. Some of these
return to places in other submaps. Neighbourhoods of one submap are searched for in all others at
once, and a certain match joins the two.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import nearest
from relmap.core.association.placement import Placement
from relmap.core.association.reobservation.evidence import LOCAL_DRIFT
from relmap.core.association.reobservation.recognition import BY_CHANCE, CLEAR, ENOUGH, PlaceFinder
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
    for submap in submaps[known][np.argsort(sizes[known], kind="stable")].tolist():
        found = _found_elsewhere(table, submap, noise_m, drift, shapes)
        if found is not None:
            other, placement = found
            global_map.tie(submap, other, placement.R, placement.t)
            yield np.flatnonzero(table.submap == other)


def _found_elsewhere(
    table: LandmarkState, submap: int, noise_m: float, drift: float, shapes: Shapes
) -> tuple[int, Placement] | None:
    """Return the submap that shows a place of this one, and the placement of this one in it."""
    own = np.flatnonzero(table.submap == submap)
    others = np.flatnonzero((table.submap != submap) & (table.submap != NONE))
    if not len(others):
        return None
    positions, shifts, number = _laid_out(table, others)
    finder, back = (
        PlaceFinder(there, noise_m, drift) for there in (positions, table.position[own])
    )
    for around in neighbourhoods(table.position[own]):
        points = table.position[own[around]]
        places = finder.places(points)
        found = [finder.landmarks_at(place.apply(points)) for place in places]
        hits = [np.unique(at[at >= 0]) for at in found]
        in_submaps = [np.unique(number[hit]) for hit in hits]
        if not places or len(in_submaps[0]) > 1:
            continue
        other = int(in_submaps[0][0])
        rivals = [place for place, of in zip(places, in_submaps, strict=True) if other in of]
        # What looks like another place in the same submap may be a third one.
        elsewhere = finder.elsewhere(points, rivals)
        elsewhere = max(elsewhere, back.elsewhere(points, back.places(points)))
        searches = len(own) + len(others)
        sure = finder.by_chance(len(points), len(hits[0]), elsewhere, searches) <= BY_CHANCE
        clear = elsewhere <= CLEAR * places[0].n_agreeing
        mine, its = around[found[0] >= 0], found[0][found[0] >= 0]
        if not (sure and clear):
            continue
        close = shapes.agree(own[mine], others[its])
        if close is None:
            averaged = table.weight[np.stack([own[mine], others[its]])]
            close = finder.is_close(table.position[own[mine]], its, averaged, n_maps=2)
        if close:
            return other, replace(places[0], t=places[0].t - shifts[other])
    return None


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
