"""Sparse Cholesky of a sum of cliques, block by block; see `relmap.planes.cholesky`.

Blocks are small sets of unknowns that always stand together.  Unknowns are numbered in the order in
which they are eliminated; `column_of` tells the place of each one's block in it.  The factor is
stored in panels: of each block the columns, one after another, over the rows
``rows[row_begin[p]:row_begin[p + 1]]``, its own unknowns first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Layout = tuple[Index, Index, Index, Index, Index]
"""start (b + 1,) of each block's unknowns, column_of (u,), row_begin (b + 1,), rows, and where each
panel begins (b + 1,)."""

ROUNDING = 1e-14
"""A pivot that is a smaller share of its diagonal entry is rounding: its unknown stays."""


@compiled
def panels(width: Index, order: Index, begin: Index, tied: Index) -> Layout:
    """Return how the factor is laid out; the arguments are as from `minimum_degree`."""
    n = len(order)
    place, start = np.empty(n, dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    for p in range(n):
        place[order[p]] = p
        start[p + 1] = start[p] + width[order[p]]
    row_begin, offset = np.zeros(n + 1, dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    for p in range(n):
        height = width[order[p]] + width[tied[begin[p] : begin[p + 1]]].sum()
        row_begin[p + 1] = row_begin[p] + height
        offset[p + 1] = offset[p] + height * width[order[p]]
    rows, column_of = np.empty(row_begin[n], dtype=np.int64), np.empty(start[n], dtype=np.int64)
    for p in range(n):
        column_of[start[p] : start[p + 1]] = p
        at = row_begin[p]
        for q in np.append(p, np.sort(place[tied[begin[p] : begin[p + 1]]])):
            for u in range(start[q], start[q + 1]):
                rows[at] = u
                at += 1
    return start, column_of, row_begin, rows, offset


@compiled
def entries(layout: Layout, begin: Index, unknowns: Index) -> Index:
    """Return where in the panels the lower triangle of each dense part is, row after row.

    Parameters
    ----------
    layout : as from `panels`
    begin, unknowns : int64
        The unknowns of each part, ascending, one part after another.
    """
    start, column_of, row_begin, rows, offset = layout
    total = 0
    for g in range(len(begin) - 1):
        n = begin[g + 1] - begin[g]
        total += n * (n + 1) // 2
    found, place, at = np.empty(total, dtype=np.int64), np.zeros(len(column_of), np.int64), 0
    for g in range(len(begin) - 1):
        own, last = unknowns[begin[g] : begin[g + 1]], -1
        for b in range(len(own)):
            p = column_of[own[b]]
            height = row_begin[p + 1] - row_begin[p]
            if p != last:
                for r in range(height):
                    place[rows[row_begin[p] + r]] = r
                last = p
            column = offset[p] + (own[b] - start[p]) * height
            for a in range(b, len(own)):
                found[at + a * (a + 1) // 2 + b] = column + place[own[a]]
        at += len(own) * (len(own) + 1) // 2
    return found


@compiled
def _add_multiple(values: Array, factor: float, others: Array) -> None:
    for r in range(len(values)):
        values[r] += factor * others[r]


@compiled
def _take_away(
    layout: Layout, values: Array, p: int, s: int, done: int, place: Index, work: Array
) -> int:
    """Take away from panel p what panel s, from its row `done` on, leaves of it; return how many.

    Rows of panel s that are unknowns of panel p.
    """
    start, _, row_begin, rows, offset = layout
    height, own = row_begin[s + 1] - row_begin[s], rows[row_begin[s] : row_begin[s + 1]]
    panel = values[offset[s] : offset[s + 1]].reshape(-1, height)
    target = values[offset[p] : offset[p + 1]].reshape(-1, row_begin[p + 1] - row_begin[p])
    shared = 0
    while done + shared < height and own[done + shared] < start[p + 1]:
        shared += 1
    for c in range(done, done + shared):
        left, column = work[: height - c], target[own[c] - start[p]]
        left[:] = 0.0
        for k in range(len(panel)):
            _add_multiple(left, panel[k, c], panel[k, c:])
        below = own[c:]
        for r in range(len(below)):
            column[place[below[r]]] -= left[r]
    return shared


@compiled
def _factorise_panel(panel: Array, least: Array) -> None:
    """Put the columns of the factor (k, h) in place of a panel's own."""
    for c in range(len(panel)):
        for k in range(c):
            _add_multiple(panel[c, c:], -panel[k, c], panel[k, c:])
        pivot = panel[c, c] if panel[c, c] > ROUNDING * least[c] else 1e300
        panel[c, c:] /= np.sqrt(pivot)
        panel[c, c] = np.sqrt(pivot)


@compiled
def factorise(layout: Layout, values: Array) -> None:
    """Put the Cholesky factor in place of a symmetric positive definite matrix.

    Panel by panel, each less what those before it leave (left-looking; Ng and Peyton, 1993).
    """
    start, column_of, row_begin, rows, offset = layout
    n = len(start) - 1
    head, following = np.full(n, -1), np.full(n, -1)
    done, place = np.zeros(n, dtype=np.int64), np.zeros(len(column_of), dtype=np.int64)
    work = np.empty(max(np.diff(row_begin).max(), 1) if n else 1)
    for p in range(n):
        width, height = start[p + 1] - start[p], row_begin[p + 1] - row_begin[p]
        for r in range(height):
            place[rows[row_begin[p] + r]] = r
        panel = values[offset[p] : offset[p + 1]].reshape(width, height)
        least = np.empty(width)
        for c in range(width):
            least[c] = panel[c, c]
        s = head[p]
        while s >= 0:
            after = following[s]
            done[s] += _take_away(layout, values, p, s, done[s], place, work)
            if row_begin[s] + done[s] < row_begin[s + 1]:
                q = column_of[rows[row_begin[s] + done[s]]]
                following[s], head[q] = head[q], s
            s = after
        _factorise_panel(panel, least)
        done[p] = width
        if width < height:
            q = column_of[rows[row_begin[p] + width]]
            following[p], head[q] = head[q], p


@compiled
def solve(layout: Layout, values: Array, right: Array) -> Array:
    """Return the solution (u,) for a right side (u,), with the factor."""
    start, _, row_begin, rows, offset = layout
    x, n = right.copy(), len(start) - 1
    for p in range(n):
        own = rows[row_begin[p] : row_begin[p + 1]]
        panel = values[offset[p] : offset[p + 1]].reshape(-1, len(own))
        for c in range(len(panel)):
            x[own[c]] /= panel[c, c]
            for r in range(c + 1, len(own)):
                x[own[r]] -= panel[c, r] * x[own[c]]
    for p in range(n - 1, -1, -1):
        own = rows[row_begin[p] : row_begin[p + 1]]
        panel = values[offset[p] : offset[p + 1]].reshape(-1, len(own))
        for c in range(len(panel) - 1, -1, -1):
            total = x[own[c]]
            for r in range(c + 1, len(own)):
                total -= panel[c, r] * x[own[r]]
            x[own[c]] = total / panel[c, c]
    return x
