"""The statements that write a scan into a journal."""

from __future__ import annotations

from itertools import chain, repeat
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.io.journal.layout import COVARIANCES, ODOMETRY, PAIRS, STAMPS, Layout

Statements = list[tuple[str, list[tuple[Any, ...]]]]
"""SQL, and the rows of values to execute it with."""
BLOCK = 32
"""Rows written by one statement."""


def observation_rows(
    layout: Layout, k: int, values: Floats, ids: Ints | None, labels: Ints
) -> Statements:
    """Return the statements that write the observations of scan k; see `Journal.append`."""
    n = len(labels)
    columns = values.T.tolist() if n else []
    slots = ["?"] * (2 + len(columns)) + ["NULL"] * (len(layout.values) - len(columns))
    if layout.has_ids:
        slots.append("NULL" if ids is None else "?")
        columns += [] if ids is None else [ids.tolist()]
    rows = zip(repeat(k, n), range(n), *columns, labels.tolist(), strict=True)
    return _blocks(f"({', '.join(slots)}, ?)", list(chain.from_iterable(rows)), n)


def covariance_rows(k: int, covariances: Floats) -> Statements:
    """Return the statements that write the covariances (n, d, d) of scan k into their table."""
    n, d = covariances.shape[:2]
    entries = {
        "xyz"[a] + "xyz"[b]: covariances[:, a, b].tolist()
        for a, b in zip(*np.triu_indices(d), strict=True)
    }
    columns = [entries.get(pair, [None] * n) for pair in PAIRS]
    rows = list(zip(repeat(k, n), range(n), *columns, strict=True))
    slots = ", ".join("?" * (2 + len(PAIRS)))
    return [_made(COVARIANCES), (f"INSERT INTO covariances VALUES ({slots})", rows)]


def odometry_rows(k: int, motion: Floats) -> Statements:
    """Return the statements that write the motion (4, 4) to scan k into its table."""
    row = (k, np.ascontiguousarray(motion, dtype="<f8").tobytes())
    return [_made(ODOMETRY), ("INSERT INTO odometry VALUES (?, ?)", [row])]


def stamp_rows(k: int, stamp_s: float) -> Statements:
    """Return the statements that write the time of scan k, seconds, into its table."""
    return [_made(STAMPS), ("INSERT INTO stamps VALUES (?, ?)", [(k, stamp_s)])]


def _made(table: str) -> tuple[str, list[tuple[Any, ...]]]:
    return table.replace("TABLE", "TABLE IF NOT EXISTS", 1), [()]


def _blocks(slots: str, numbers: list[float], n: int) -> Statements:
    """Return the statements that write n rows of numbers, many per statement: twice as fast."""
    statements: Statements = []
    width, end = slots.count("?"), n - n % BLOCK
    for begin, stop, k in ((0, end, BLOCK), (end, n, 1)):
        size = k * width
        rows = [tuple(numbers[i : i + size]) for i in range(begin * width, stop * width, size)]
        if rows:
            statements.append((f"INSERT INTO observations VALUES {', '.join([slots] * k)}", rows))
    return statements
