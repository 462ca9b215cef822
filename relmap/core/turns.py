"""Scheduling: one costly step per iteration, so that no iteration stalls."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.grouping.chart import PointChart
from relmap.core.grouping.completion import RelativeMap
from relmap.core.map.placing import be_done_with, needs_last_pass, next_last_pass, place
from relmap.core.refinement.live import SLICE_EVERY

if TYPE_CHECKING:
    from relmap.core.mapper import RelativeMapper


def take_turns(engine: RelativeMapper, left: Ints) -> None:
    """Group, group for the last time, forget, or refine the live map.

    `left` (k,): landmarks that left the view in this iteration.
    """
    engine.merger.leave(left)
    engine.merger.go_on()
    steps = (_group_next, _last_pass_next, _forget, _refine_next)
    first = engine.store.n_iterations % len(steps)
    for step in steps[first:] + steps[:first]:
        if step(engine):
            break


def _group_next(engine: RelativeMapper) -> bool:
    """Group landmarks with enough new observations; return whether there were any."""
    due = engine.schedule.next_due()
    if due is None or engine.table.dynamic[due[0]]:
        return False
    group_or_found(engine, *due)
    return True


def _last_pass_next(engine: RelativeMapper) -> bool:
    """Run the last pass for landmarks that left, over the whole interval; return if any did."""
    seed = next_last_pass(engine)
    if seed is not None:
        last_pass(engine, seed)
    return seed is not None


def _forget(engine: RelativeMapper) -> bool:
    """Condense and forget observations that no group needs; return whether there were any."""
    before = engine.schedule.needed_from(engine.store.n_iterations)
    condensed = engine.segments.condense(engine.store, before, engine.table.dynamic)
    engine.store.forget(min(before, engine.segments.end))
    return condensed


def _refine_next(engine: RelativeMapper) -> bool:
    """Refine the live map; return whether there was anything to do.

    It is not run in every iteration, to keep typical iterations fast.
    """
    if not engine.config.refine_live or engine.store.n_iterations % SLICE_EVERY:
        return False
    refined = engine.live.advance()
    if refined:
        engine.merger.look_again()
    return refined


def group_or_found(engine: RelativeMapper, seed: int, level: int) -> None:
    """Group a landmark; if it cannot be aligned and has no position yet, start a submap."""
    placed = engine.group(seed, level)
    if len(placed):
        _merge_seen_again(engine, placed)
    elif engine.table.weight[seed] == 0:
        found_submap(engine, seed, level)


def found_submap(engine: RelativeMapper, seed: int, level: int) -> None:
    """Begin the map, or a new submap if the landmarks in view do not suffice to continue.

    Its frame is the robot frame of the first iteration of the group.
    """
    fixes = engine.model.min_shared(engine.table.dimension)
    mapped_in_view = np.sum(engine.table.weight[engine.schedule.in_view] > 0)
    if mapped_in_view >= fixes or engine.table.dynamic[seed]:
        return
    first = placed_first(engine, engine.chart(seed))
    if first is not None:
        placed, relative = first
        place(engine, engine.map.new_submap(), level, placed, relative)


def placed_first(engine: RelativeMapper, chart: PointChart) -> tuple[Floats, RelativeMap] | None:
    """Return a relative map of a chart, and its positions in the robot frame that saw it first.

    None if no group can be grown.
    """
    if not len(chart.iterations):
        return None
    chart = chart.only(chart.visible[:, 0])
    relative = engine.relative_map(chart, np.zeros(len(chart.landmarks)), 0)
    if relative is None:
        return None
    first = chart.points_robot[np.isin(chart.landmarks, relative.landmarks), 0]
    if len(first) <= engine.model.min_shared(engine.table.dimension):
        return None
    R, t = fit_rigid(relative.positions, first)
    return relative.positions @ R.T + t, relative


def last_pass(engine: RelativeMapper, seed: int) -> None:
    """Group a landmark over its whole interval, and try a last time to recognise it."""
    placed = np.empty(0, dtype=np.int64)
    if needs_last_pass(engine, np.array([seed]))[0]:
        placed = engine.group(seed, 3)
    if engine.table.is_gone[seed]:
        be_done_with(engine, np.array([seed]))
    if len(placed):
        _merge_seen_again(engine, placed)
    engine.merger.leave(np.array([seed]))


def _merge_seen_again(engine: RelativeMapper, placed: Ints) -> None:
    if not engine.association.has_ids:
        engine.merge(placed, engine.averaging.noise.sigma_m)
