"""Rebuilding of a refined map with known ids that its observations contradict."""

from __future__ import annotations

import numpy as np

from relmap.core.gaps import is_bridged
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.confirming import found_rest, seen_in, without_namesakes
from relmap.core.refinement.extending import extend_submaps
from relmap.core.refinement.joint import CONFIRMED
from relmap.core.refinement.misread import take_off_misread
from relmap.core.refining import refine_map, refine_submaps
from relmap.core.state.table import NONE

CLEARLY, WHOLE, MOST = 0.8, 0.95, 0.5
"""Largest ratio of the contradictions of a rebuilt map to those before for it to be kept, and least
ratios of the numbers of mapped landmarks, without those that share an id, and of all: an empty map
contradicts nothing."""
OFF = 10.0
"""Noise of a refined map, relative to that within segments, above which it is wrong: least squares
has put what ids mix up in the middle, and few observations stand out."""
MISREAD = 0.01
"""Fraction of the observations contradicting their ids above which some ids are wrong; without
wrong ids less than this occurs."""
PLACES = (
    *("position", "weight", "settled_position", "settled_weight"),
    *("submap", "dynamic", "highest_level"),
)
"""Columns of the landmarks that rebuilding changes."""


def rebuild(engine: RelativeMapper) -> None:
    """Rebuild a map that confirmed observations contradict, or that is off; keep it if better.

    Observations whose id was seen elsewhere, among other landmarks, place nothing.
    """
    table, before = engine.table, sum(one.n_contradicting for one in engine.refined)
    n_wrong = len(engine.association.overruled) + sum(one.n_outliers for one in engine.refined)
    is_doubtful = before and n_wrong >= MISREAD * table.observations.sum()
    rows = engine.rows
    was_off = _is_off(engine, rows.noise_m)
    if is_bridged(engine) or not (is_doubtful or was_off):
        return
    kept = {name: getattr(table, name).copy() for name in PLACES}
    refined, odometry = engine.refined, engine.odometry
    mapped = table.submap != NONE
    own, shared = without_namesakes(rows, CONFIRMED)
    sure = seen_in(own, CONFIRMED)
    table.take_off_map(np.flatnonzero(mapped))
    found_rest(engine.map, sure)
    engine.refined = refine_submaps(engine, sure)
    if extend_submaps(engine.map, sure):
        engine.refined = refine_submaps(engine, sure)
    # Single observations place nothing: a few wrong ones would again join what is apart.
    extend_submaps(engine.map, seen_in(own, CONFIRMED - 1), table.submap == NONE)
    refine_map(engine)
    take_off_misread(engine.map, rows, few=np.inf)
    refine_map(engine)
    least = MOST * np.sum(mapped)
    mapped[shared] = False
    is_whole = np.sum(table.submap != NONE) >= max(WHOLE * np.sum(mapped), least)
    after = sum(one.n_contradicting for one in engine.refined)
    is_better = is_doubtful and after <= CLEARLY * before
    if not (is_whole and (is_better or (was_off and not _is_off(engine, rows.noise_m)))):
        for name, values in kept.items():
            getattr(table, name)[:] = values
        engine.refined, engine.odometry = refined, odometry


def _is_off(engine: RelativeMapper, noise_m: float) -> bool:
    """Return whether the largest submap fits far worse than `noise_m`, metres, explains."""
    largest = max(engine.refined, key=lambda one: len(one.landmarks), default=None)
    if largest is None:
        return False
    return bool(largest.noise_m > OFF * noise_m and not largest.is_exact)
