"""Recording which landmarks a scan shows, compiled; see `schedule`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Bytes, Counts, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.state.schedule import FEW

Columns = tuple[Ints, Ints, Counts, Bools, Counts, Bytes, Floats]
"""Of the landmark table: last, observations, in_interval, is_gone, begin, level, weight."""


@compiled
def enter(columns: tuple[Ints, Ints, Ints], tracks: Ints, iteration: int) -> Ints:
    """Record that tracks (k,) are seen in this iteration; return the landmarks that they are.

    `columns`, of the landmark table: landmark_of, track_end, track_observations.
    """
    landmark_of, track_end, track_observations = columns
    landmarks = np.empty(len(tracks), dtype=np.int64)
    for k in range(len(tracks)):
        track_observations[tracks[k]] += track_end[tracks[k]] != iteration
        track_end[tracks[k]] = iteration
        landmarks[k] = landmark_of[tracks[k]]
    return landmarks


@compiled
def due(
    columns: tuple[Counts, Bytes, Floats],
    landmarks: Ints,
    thresholds: Ints,
    every: int,
    few: float,
    in_view: Ints,
) -> tuple[Ints, Ints]:
    """Return the landmarks (k,) whose level is below that of their observations, and that level.

    Only those with a multiple of so many observations. Level 1 waits while at most a few of those
    `in_view` (n,), as a fraction, have no position. `columns`, of the landmark table: in_interval,
    level, weight.
    """
    in_interval, level, weight = columns
    most, n, least = len(landmarks), 0, few * len(in_view)
    found, levels = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    for one in in_view:
        least -= weight[one] == 0
    for one in landmarks:
        if in_interval[one] % every == 0:
            reached = 0
            for threshold in thresholds:
                reached += in_interval[one] >= threshold
            if reached > level[one] and (reached > 1 or least < 0):
                found[n], levels[n], n = one, reached, n + 1
    return found[:n], levels[:n]


@helper
def _earliest(begin: Counts, landmarks: Ints, end: int) -> int:
    """Return the first iteration of the intervals of landmarks (k,); `end` if there are none."""
    for one in landmarks:
        end = min(end, begin[one])
    return end


@compiled
def see(
    columns: Columns,
    landmarks: Ints,
    waiting: tuple[Ints, Ints],
    iteration: int,
    max_missed: int,
    thresholds: Ints,
) -> tuple[Ints, Ints, Ints, Ints, int]:
    """Record that landmarks (k,) are seen.

    `waiting`: those in view before (n,), each of which leaves when it is missed more often than
    allowed, and those that left (g,). Returns both as they are now, those that left now, those that
    have become due, and the first iteration of the intervals of all that are in view or have left.
    """
    last, observations, in_interval, is_gone, begin, level, weight = columns
    in_view, before = waiting
    n, n_left, n_arrived = len(in_view), 0, 0
    arrived, left = np.empty(len(landmarks), dtype=np.int64), np.empty(n, dtype=np.int64)
    for one in landmarks:
        if iteration - last[one] > max_missed + 1:
            arrived[n_arrived], n_arrived = one, n_arrived + 1
            if not is_gone[one]:
                begin[one], in_interval[one] = iteration, 0
            is_gone[one] = False
        if last[one] != iteration:
            observations[one] += 1
            in_interval[one] += 1
        last[one] = iteration
    now, n_now = np.empty(n + n_arrived, dtype=np.int64), 0
    gone, n_gone = np.empty(len(before) + n, dtype=np.int64), 0
    for one in before:
        if is_gone[one]:
            gone[n_gone], n_gone = one, n_gone + 1
    for one in in_view:
        if iteration - last[one] <= max_missed:
            now[n_now], n_now = one, n_now + 1
        else:
            left[n_left], gone[n_gone], is_gone[one] = one, one, True
            n_left, n_gone = n_left + 1, n_gone + 1
    for k in range(n_arrived):
        now[n_now + k] = arrived[k]
    now, gone = now[: n_now + n_arrived], gone[:n_gone]
    first = _earliest(begin, gone, _earliest(begin, now, iteration + 1))
    own = in_interval, level, weight
    ready, _ = due(own, landmarks, thresholds, thresholds[0], FEW, now)
    return now, gone, left[:n_left], ready, first
