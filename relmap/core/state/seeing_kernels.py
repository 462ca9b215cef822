"""Recording which landmarks a scan shows, compiled; see `schedule`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Ints
from relmap.core.linalg.compiling import compiled

Columns = tuple[Ints, Ints, Ints, Bools, Ints]
"""Of the landmark table: last, observations, in_interval, is_gone, begin."""


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
def see(
    columns: Columns, landmarks: Ints, in_view: Ints, iteration: int, max_missed: int
) -> tuple[Ints, Ints, Ints]:
    """Record that landmarks (k,) are seen; return those in view, those that left, and arrived.

    `in_view` (n,): those in view before; each leaves when it is missed more often than allowed.
    """
    last, observations, in_interval, is_gone, begin = columns
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
    for one in in_view:
        if iteration - last[one] <= max_missed:
            now[n_now], n_now = one, n_now + 1
        else:
            left[n_left], n_left = one, n_left + 1
    for k in range(n_arrived):
        now[n_now + k] = arrived[k]
    return now[: n_now + n_arrived], left[:n_left], arrived[:n_arrived]


@compiled
def due(
    in_interval: Ints, level: Ints, landmarks: Ints, thresholds: Ints, every: int
) -> tuple[Ints, Ints]:
    """Return the landmarks (k,) whose level is below that of their observations, and that level.

    Only those with a multiple of so many observations.
    """
    most, n = len(landmarks), 0
    found, levels = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    for one in landmarks:
        if in_interval[one] % every == 0:
            reached = 0
            for threshold in thresholds:
                reached += in_interval[one] >= threshold
            if reached > level[one]:
                found[n], levels[n], n = one, reached, n + 1
    return found[:n], levels[:n]
