"""What is done with the whole map, when no scan is to come for now."""

from __future__ import annotations

import numpy as np

from relmap.core.association.loops import LoopFinder
from relmap.core.association.merging import merge_doubles
from relmap.core.association.tying import tie_submaps
from relmap.core.grouping.chart import PointChart
from relmap.core.map.bending import bend
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.by_submap import refine_submaps
from relmap.core.refinement.extending import extend_submaps
from relmap.core.turns import group_or_found, last_pass, placed_first


def finish(engine: RelativeMapper) -> None:
    """Group what is still in view and not mapped yet, and what has left for the last time."""
    for seed in engine.schedule.in_view.tolist():
        if engine.table.weight[seed] == 0:
            group_or_found(engine, seed, 1)
    engine.schedule.end()
    gone = engine.schedule.gone
    for seed in gone[np.argsort(-engine.table.in_interval[gone], kind="stable")].tolist():
        if engine.table.is_gone[seed]:
            last_pass(engine, seed)
    if engine.association.is_known:
        extend_submaps(engine.map, engine.rows)


def found_late(engine: RelativeMapper, begin: int, end: int) -> None:
    """Found a submap in iterations that are still stored and of which no group placed any.

    Where nothing is in view for long, nobody is due before it has left.
    """
    landmarks = engine.table.now(engine.store.seen(begin, end)[0])
    if not len(landmarks) or (engine.table.weight[landmarks] > 0).any():
        return
    chart = PointChart.around(int(np.bincount(landmarks).argmax()), engine.store, begin, end)
    first = placed_first(engine, chart)
    if first is not None:
        placed, relative = first
        weights = relative.n_used.astype(np.float64)
        engine.map.place(engine.map.new_submap(), relative.landmarks, placed, weights)


def tie(engine: RelativeMapper) -> None:
    """Tie submaps that show the same place, close loops, and merge what was seen again."""
    noise_m = engine.averaging.noise.sigma_m
    for _ in tie_submaps(engine.map, noise_m):
        merge_doubles(engine.table, engine.merger, engine.merge)
    finder = LoopFinder(engine.table, noise_m)
    while (loop := finder.next()) is not None:
        bend(engine.map, engine.rows, loop.pairs, loop.placement.R, loop.placement.t)
        engine.merge_pairs(loop.pairs)
        merge_doubles(engine.table, engine.merger, engine.merge)


def refine(engine: RelativeMapper) -> None:
    """Bring all landmarks to where all observations agree best, by joint least squares.

    Without ids, landmarks that then lie where older ones do that they may be are merged.
    """
    kept = engine.store if engine.config.keep_observations else None
    engine.refined = refine_submaps(engine.map, engine.rows, kept, engine.weighed)
    again = engine.association.is_known and extend_submaps(engine.map, engine.rows)
    merged = not engine.association.has_ids and merge_doubles(
        engine.table, engine.merger, engine.merge
    )
    if again or merged:
        engine.refined = refine_submaps(engine.map, engine.rows, kept, engine.weighed)
    engine.merger.look_again()
