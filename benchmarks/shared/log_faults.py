"""Faults of the world and of sensors, applied to a log of landmarks with ids; one function each.

Each function takes a log and returns a new one. False observations are placed at positions of other
observations, so that they are plausible. A share is a fraction of all observations, in [0, 1]; a
`RelmapError` is raised if it is not, or if ids needed by a fault are missing.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog


def gross_outliers(log: ObservationLog, share: float, rng: np.random.Generator) -> ObservationLog:
    """Move a fraction of the observations to positions of others: right ids at wrong positions."""
    wrong = _drawn(log, share, rng)
    points = log.points_robot.copy()
    points[wrong] = log.points_robot[rng.integers(len(points), size=len(wrong))]
    return replace(log, points_robot=points)


def missed_detections(
    log: ObservationLog, share: float, rng: np.random.Generator
) -> ObservationLog:
    """Remove a fraction of the observations."""
    return _rows(log, np.delete(np.arange(len(log.iteration)), _drawn(log, share, rng)))


def ghosts(log: ObservationLog, share: float, rng: np.random.Generator) -> ObservationLog:
    """Add false observations, as a fraction of all, each with its own id."""
    seen_with = _drawn(log, share, rng)
    n = len(seen_with)
    places = log.points_robot[rng.integers(len(log.points_robot), size=n)]
    return _joined(log, seen_with, places, _new_ids(log) + np.arange(n))


def duplicated_landmarks(
    log: ObservationLog, landmarks: Ints, sigma_m: float, rng: np.random.Generator
) -> ObservationLog:
    """Report landmarks (k,) twice whenever they are seen, the second time under another id.

    `sigma_m`: standard deviation of the difference between the two, per coordinate, metres.
    """
    rows = np.flatnonzero(np.isin(_ids(log), landmarks))
    noise = rng.normal(0.0, sigma_m, (len(rows), log.points_robot.shape[1]))
    again = _new_ids(log) + np.searchsorted(np.sort(landmarks), _ids(log)[rows])
    return _joined(log, rows, log.points_robot[rows] + noise, again)


def mirrored_scan(log: ObservationLog, iteration: int) -> ObservationLog:
    """Swap left and right in one iteration."""
    points = log.points_robot.copy()
    points[log.iteration == iteration, 1] *= -1
    return replace(log, points_robot=points)


def lost_scans(log: ObservationLog, first: int, count: int) -> ObservationLog:
    """Remove all observations of `count` iterations."""
    return _rows(log, np.flatnonzero(~_within(log, first, count)))


def few_landmarks(log: ObservationLog, first: int, count: int, few: int = 2) -> ObservationLog:
    """Keep only the `few` longest known landmarks in each of `count` iterations."""
    ids, begun = np.unique(_ids(log), return_index=True)
    age = begun[np.searchsorted(ids, _ids(log))]
    order = np.lexsort((age, log.iteration))
    starts = np.searchsorted(log.iteration, log.iteration[order])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - starts
    return _rows(log, np.flatnonzero(~_within(log, first, count) | (rank < few)))


def big_step(log: ObservationLog, first: int, steps: int) -> ObservationLog:
    """Make the robot move several steps at once after the iteration `first`."""
    skipped = (log.iteration > first) & (log.iteration < first + steps)
    kept = _rows(log, np.flatnonzero(~skipped))
    later = kept.iteration > first
    iteration = np.where(later, kept.iteration - (steps - 1), kept.iteration)
    end = log.end_iteration - (steps - 1)
    numbers = np.arange(log.first_iteration, log.end_iteration)
    left = np.flatnonzero((numbers <= first) | (numbers >= first + steps))
    odometry = None if log.odometry is None else composed(log.odometry, left)
    return replace(kept, iteration=iteration, end_iteration=end, odometry=odometry)


def time_backwards(log: ObservationLog, first: int, count: int) -> ObservationLog:
    """Reverse `count` iterations, as if a buffer were emptied from the wrong end."""
    within = _within(log, first, count)
    iteration = np.where(within, 2 * first + count - 1 - log.iteration, log.iteration)
    order = np.argsort(iteration, kind="stable")
    return replace(_rows(log, order), iteration=iteration[order])


def composed(odometry: Floats, kept: Ints) -> Floats:
    """Return the motions (m, 4, 4) between kept iterations (m,), ascending, from all (k, 4, 4)."""
    found = np.full((len(kept), 4, 4), np.nan)
    for row, (begin, end) in enumerate(pairwise(kept.tolist()), 1):
        found[row] = np.eye(4)
        for motion in odometry[begin + 1 : end + 1]:
            found[row] = found[row] @ motion
    return found


def _drawn(log: ObservationLog, share: float, rng: np.random.Generator) -> Ints:
    """Draw a fraction of the observations, in ascending order."""
    if not 0 <= share <= 1:
        raise RelmapError(f"share is {share}; it must lie in [0, 1]")
    n = len(log.iteration)
    return np.sort(rng.choice(n, round(share * n), replace=False))


def _within(log: ObservationLog, first: int, count: int) -> Bools:
    return (log.iteration >= first) & (log.iteration < first + count)


def _ids(log: ObservationLog) -> Ints:
    if log.ids is None:
        raise RelmapError("the log has no ids, and a fault that concerns landmarks needs them")
    return log.ids


def _new_ids(log: ObservationLog) -> int:
    return int(_ids(log).max(initial=-1)) + 1


def _rows(log: ObservationLog, rows: Ints) -> ObservationLog:
    """Return some observations, renumbered."""
    return replace(
        log,
        points_robot=log.points_robot[rows],
        iteration=log.iteration[rows],
        rows=np.arange(len(rows)),
        ids=None if log.ids is None else log.ids[rows],
        covariances=None if log.covariances is None else log.covariances[rows],
    )


def _joined(log: ObservationLog, beside: Ints, points: Floats, ids: Ints) -> ObservationLog:
    """Add observations to the iterations of others in given rows."""
    everything = replace(
        log,
        points_robot=np.concatenate([log.points_robot, points]),
        iteration=np.concatenate([log.iteration, log.iteration[beside]]),
        covariances=None,
        ids=np.concatenate([_ids(log), ids]),
    )
    return _rows(everything, np.argsort(everything.iteration, kind="stable"))
