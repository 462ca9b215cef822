"""From the rows of a table to an observation log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.datasets.base import MAX_ITERATION, ObservationLog
from relmap.datasets.scans import in_time_order
from relmap.datasets.table import MAX_EXACT_INTEGER, Column, Table
from relmap.datasets.textfile import warn

MAX_COORDINATE_M = 1e9
"""Upper limit of a coordinate, larger than the range of any sensor."""

MAX_EMPTY_ITERATIONS = 1_000_000
"""Maximum number of iterations without a row: with more, the numbers do not count scans."""

FEWEST_STRIDES = 5
"""Minimum number of iterations with rows, all a multiple apart, for a warning."""


def iteration_column(name: str) -> Column:
    """Return the column of iteration numbers."""
    return Column(name, 0, MAX_ITERATION, integer=True)


def metres_column(name: str, required: bool = True) -> Column:
    """Return a column of coordinates."""
    return Column(name, -MAX_COORDINATE_M, MAX_COORDINATE_M, "metres", required=required)


def from_polar(range_m: Floats, bearing_rad: Floats, elevation_rad: Floats | None = None) -> Floats:
    """Return points, (n, 2) or with elevations (n, 3), metres; x is ahead, y left, z up."""
    level = 1.0 if elevation_rad is None else np.cos(elevation_rad)
    axes = [np.cos(bearing_rad) * level, np.sin(bearing_rad) * level]
    if elevation_rad is not None:
        axes.append(np.sin(elevation_rad))
    return np.asarray(range_m[:, None] * np.column_stack(axes))


def id_column(name: str, required: bool = True) -> Column:
    """Return the column of known associations; negative or empty without an id."""
    limit = MAX_EXACT_INTEGER
    return Column(name, -limit, limit, integer=True, required=required, empty=-1.0)


def assemble_log(
    table: Table,
    iteration_name: str,
    points_robot: Floats,
    ids: Ints | None,
    covariances: Floats | None = None,
) -> ObservationLog:
    """Sort the rows of a table by iteration, keeping their order within one.

    The arguments are points (n, 2) or (n, 3), robot frame, metres, ids (n,) and covariances (n, d,
    d), square metres, of the rows. RelmapError if the iteration numbers have too many gaps, or an
    id occurs twice in one iteration.
    """
    iteration = table.integers(iteration_name)
    order = np.argsort(iteration, kind="stable").astype(np.int64)
    _check_span(table, iteration_name, iteration[order], order)
    _warn_of_stride(table, np.unique(iteration))
    if ids is not None:
        _check_unique(table, iteration, ids)
    first, end, rows = int(iteration.min()), int(iteration.max()) + 1, np.arange(len(order))
    log = ObservationLog(points_robot, iteration, rows, first, end, ids, covariances=covariances)
    return log.only(order)


def with_stamps(table: Table, log: ObservationLog) -> ObservationLog:
    """Return a log with the times of the rows of its table, in order of time.

    The time of an iteration is that of its earliest row; that of an iteration without a row is
    interpolated. If times contradict the iteration numbers, the iterations are renumbered in order
    of time, with a warning; RelmapError if an iteration lasts into another one.
    """
    stamps_s = table.columns["stamp"][log.rows]
    numbers, begin, which = np.unique(log.iteration, return_index=True, return_inverse=True)
    begins_s = np.minimum.reduceat(stamps_s, begin)
    order, ascending = in_time_order(table.path, begins_s)
    later = np.argsort(order)
    following_s = np.append(begins_s[order], np.inf)[later + 1]
    late = log.rows[stamps_s > following_s[which]]
    if len(late):
        row = int(late.min())
        found = f"{table.columns['stamp'][row]:.10g} is later than the first of another iteration"
        table.fail(row, "stamp", f"{found}, expected the rows of an iteration to have one time")
    rows, first = np.argsort(later[which], kind="stable"), log.first_iteration
    every = np.arange(first, log.end_iteration)
    # Iterations without a row stay behind the one before; at the end they have no time.
    before = every[np.argsort(later[np.searchsorted(numbers, every, "right") - 1], kind="stable")]
    now = first + np.argsort(before)
    begun, end = np.sort(now[numbers - first]), int(now[numbers - first].max()) + 1
    return replace(
        log.only(rows),
        iteration=now[log.iteration - first][rows],
        stamps_s=np.interp(np.arange(first, end), begun, ascending),
        end_iteration=end,
        numbers=None if (before == every).all() else before[: end - first],
    )


def _check_span(table: Table, name: str, ascending: Ints, order: Ints) -> None:
    steps = np.diff(ascending)
    empty = int(np.maximum(steps - 1, 0).sum())
    if empty > MAX_EMPTY_ITERATIONS:
        widest = int(np.argmax(steps))
        found = f"{ascending[widest + 1]} comes after {ascending[widest]}"
        expected = f"expected at most {MAX_EMPTY_ITERATIONS}: a count of scans"
        problem = f"{found}, and in all {empty} iterations have no row, {expected}"
        table.fail(int(order[widest + 1]), name, problem)


def _warn_of_stride(table: Table, numbers: Ints) -> None:
    """Warn if all iterations (n,) with rows are multiples apart, such as 0, 10, 20."""
    stride = int(np.gcd.reduce(np.diff(numbers))) if len(numbers) >= FEWEST_STRIDES else 1
    if stride > 1:
        found = f"iterations are numbered {', '.join(map(str, numbers[:3]))}, ...: those between"
        advice = "if there were none, number the scans one by one"
        warn(table.path, f"{found} count as scans in which nothing was seen; {advice}")


def _check_unique(table: Table, iteration: Ints, ids: Ints) -> None:
    known = np.flatnonzero(ids >= 0)
    order = known[np.lexsort((ids[known], iteration[known]))]
    same = (np.diff(ids[order]) == 0) & (np.diff(iteration[order]) == 0)
    if same.any():
        again = np.flatnonzero(same)
        k = int(again[np.argmin(order[again + 1])])
        row, before = int(order[k + 1]), int(order[k])
        found = f"{ids[row]} occurs twice in iteration {iteration[row]}"
        there = f"before in {table.place} {table.lines[before]}"
        table.fail(row, "id", f"{found} ({there}), expected each landmark once")
