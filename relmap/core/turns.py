"""What is done in which iteration: one costly step in each, in turns, so that none stalls."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from relmap.core.refinement.live import SLICE_EVERY

if TYPE_CHECKING:
    from relmap.core.mapper import RelativeMapper


def take_turns(engine: RelativeMapper, seen: NDArray[np.int64], left: NDArray[np.int64]) -> None:
    """Group, group for the last time, forget, or refine the live map.

    Parameters
    ----------
    engine : RelativeMapper
    seen, left : (k,) int64
        Landmarks seen in this iteration, and those that have left the view with it.
    """
    engine.schedule.note_due(seen)
    engine.merger.leave(left)
    engine.merger.go_on()
    steps = (_group_next, _last_pass_next, _forget, _refine_next)
    turn = engine.store.n_iterations
    for k in range(len(steps)):
        if steps[(turn + k) % len(steps)](engine):
            break


def finish(engine: RelativeMapper) -> None:
    """Group what is still in view and not mapped yet, and what has left for the last time."""
    for seed in engine.schedule.in_view.tolist():
        if engine.table.weight[seed] == 0:
            _group_or_found(engine, seed, 1)
    engine.schedule.end()
    gone = engine.schedule.gone
    for seed in gone[np.argsort(-engine.table.in_interval[gone], kind="stable")].tolist():
        if engine.table.is_gone[seed]:
            _last_pass(engine, seed)


def _group_next(engine: RelativeMapper) -> bool:
    """Group whoever was seen often enough since the last time; tell whether somebody was."""
    due = engine.schedule.next_due()
    if due is None or engine.table.dynamic[due[0]]:
        return False
    _group_or_found(engine, *due)
    return True


def _last_pass_next(engine: RelativeMapper) -> bool:
    """Group whoever is seen no longer over the whole interval; tell whether somebody was."""
    seed = engine.placing.next_last_pass()
    if seed is not None:
        _last_pass(engine, seed)
    return seed is not None


def _forget(engine: RelativeMapper) -> bool:
    """Forget observations that no group needs any more; tell whether there were any."""
    return engine.forget()


def _refine_next(engine: RelativeMapper) -> bool:
    """Refine the live map; tell whether there was anything to do.

    Not in every iteration, so that a typical one takes no longer.
    """
    if not engine.config.refine_live or engine.store.n_iterations % SLICE_EVERY:
        return False
    refined = engine.live.advance()
    if refined:
        engine.merger.look_again()
    return refined


def _group_or_found(engine: RelativeMapper, seed: int, level: int) -> None:
    placed = engine.group(seed, level)
    if len(placed):
        _merge_seen_again(engine, placed)
    elif engine.table.weight[seed] == 0:
        engine.found_submap(seed, level)


def _last_pass(engine: RelativeMapper, seed: int) -> None:
    """Group a landmark over its whole interval, and look for a last time who it is."""
    placed = np.empty(0, dtype=np.int64)
    if engine.placing.needs_last_pass(np.array([seed]))[0]:
        placed = engine.group(seed, 3)
    if engine.table.is_gone[seed]:
        engine.placing.be_done_with(np.array([seed]))
    if len(placed):
        _merge_seen_again(engine, placed)
    engine.merger.leave(np.array([seed]))


def _merge_seen_again(engine: RelativeMapper, placed: NDArray[np.int64]) -> None:
    if not engine.has_ids:
        engine.merge(placed)
