"""Sparse Cholesky of a sum of cliques, block by block; see `relmap.planes.cholesky`.

Unknowns are numbered in the order in which they are eliminated.  The factor is stored in panels: of
some unknowns in a row, ``start[p]`` to ``start[p + 1]``, the columns, one after another, over the
rows ``rows[row_begin[p]:row_begin[p + 1]]``, which begin with themselves.  `column_of` tells the
panel of each unknown.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Layout = tuple[Index, Index, Index, Index, Index]
"""start (p + 1,), column_of (u,), row_begin (p + 1,), rows, and offset (p + 1,) of each panel."""

ROUNDING = 1e-14
"""A pivot that is a smaller share of its diagonal entry is rounding: its unknown stays."""


@compiled
def _heads(width: Index, order: Index, begin: Index, place: Index, tied: Index) -> Index:
    """Return the places of blocks that begin a panel, and their number at the end.

    A block goes into the panel of the one before it where both are tied to the same others.
    """
    n, count = len(order), 0
    heads, before = np.empty(n + 1, dtype=np.int64), -1
    for p in range(n):
        others, nearest = 0, n
        for q in tied[begin[p] : begin[p + 1]]:
            others += width[q]
            nearest = min(nearest, place[q])
        if before != width[order[p]] + others:
            heads[count] = p
            count += 1
        before = others if nearest == p + 1 else -1
    heads[count] = n
    return heads[: count + 1]


@compiled
def panels(width: Index, order: Index, begin: Index, tied: Index) -> tuple[Index, Layout]:
    """Return the first unknown (b,) of each block, and how the factor is laid out.

    The arguments are as from `relmap.planes.elimination_kernels.minimum_degree`.
    """
    n = len(order)
    place, at = np.empty(n, dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    for p in range(n):
        place[order[p]] = p
        at[p + 1] = at[p] + width[order[p]]
    heads = _heads(width, order, begin, place, tied)
    m, start = len(heads) - 1, at[heads]
    row_begin, offset = np.zeros(m + 1, dtype=np.int64), np.zeros(m + 1, dtype=np.int64)
    for g in range(m):
        p = heads[g]
        height = width[order[p]] + width[tied[begin[p] : begin[p + 1]]].sum()
        row_begin[g + 1] = row_begin[g] + height
        offset[g + 1] = offset[g] + height * (start[g + 1] - start[g])
    rows, column_of = np.empty(row_begin[m], dtype=np.int64), np.empty(at[n], dtype=np.int64)
    for g in range(m):
        p, r = heads[g], row_begin[g]
        column_of[start[g] : start[g + 1]] = g
        for q in np.append(p, np.sort(place[tied[begin[p] : begin[p + 1]]])):
            for u in range(at[q], at[q + 1]):
                rows[r] = u
                r += 1
    return at[place], (start, column_of, row_begin, rows, offset)


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
