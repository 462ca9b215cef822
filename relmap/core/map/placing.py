"""Adding a group's relative map to the global map, and ending intervals of landmarks that left."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.grouping.completion import RelativeMap
from relmap.core.grouping.dynamics import FEWEST

if TYPE_CHECKING:
    from relmap.core.mapper import RelativeMapper


def place(
    engine: RelativeMapper, submap: int, level: int, placed: Floats, relative: RelativeMap
) -> Ints:
    """Add a relative map for the landmarks for which it is the best group.

    `level`: the pass: 1, 2 or 3; `placed` (n, d), frame of the submap, metres: the relative map,
    aligned. Returns (k,): the newly mapped landmarks.
    """
    landmarks = relative.landmarks
    engine.map.join(submap, landmarks, placed)
    limits = level, *engine.schedule.limits
    whole = engine.levels.take(relative, submap, placed, limits)
    if level == 3:
        _close(engine, whole)
    return landmarks[engine.table.weight[landmarks] > 0]


def leave_out_moving(engine: RelativeMapper, landmarks: Ints) -> None:
    """Remove those of landmarks (k,) that are dynamic from the map."""
    moving = landmarks[engine.table.dynamic[landmarks]]
    if len(moving):
        engine.table.take_off_map(moving)
        engine.levels.leave(moving)
        engine.schedule.begin_anew(moving, engine.store.n_iterations)


def next_last_pass(engine: RelativeMapper) -> int | None:
    """Return the next landmark that needs its last pass; None if there is none yet.

    Landmarks that need none are closed at once, so that they do not delay the others.
    """
    waited = engine.schedule.waited(engine.store.n_iterations)
    if not len(waited):
        return None
    needed = needs_last_pass(engine, waited)
    if not needed.all():
        be_done_with(engine, waited[~needed])
    waited = waited[needed]
    # The group of the landmark seen longest serves most of the others.
    return int(waited[np.argmax(engine.table.in_interval[waited])]) if len(waited) else None


def needs_last_pass(engine: RelativeMapper, landmarks: Ints) -> Bools:
    """Return which landmarks are static and have enough stored observations for a group; (n,).

    A short remainder of an interval that was split needs no separate group.
    """
    table = engine.table
    enough = np.where(table.weight[landmarks] > 0, engine.config.group_after, FEWEST)
    needed = table.in_interval[landmarks] >= enough
    needed &= table.last[landmarks] >= engine.store.first_iteration
    return np.asarray(needed & ~table.dynamic[landmarks])


def be_done_with(engine: RelativeMapper, gone: Ints) -> None:
    """Close the intervals of landmarks that have left.

    Those never placed are dynamic if they moved when last tested.
    """
    table = engine.table
    table.dynamic[gone[(table.weight[gone] == 0) & table.restless[gone]]] = True
    _close(engine, gone)


def _close(engine: RelativeMapper, landmarks: Ints) -> None:
    """End the interval of landmarks: their current positions are settled."""
    engine.table.settle(landmarks)
    engine.levels.close(landmarks)
    engine.schedule.begin_anew(landmarks, engine.store.n_iterations)
