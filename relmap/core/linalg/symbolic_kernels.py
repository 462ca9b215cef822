"""Symbolic Cholesky factorisation: which entries of the factor are stored, and where.

See `relmap.core.linalg.cholesky_kernels` for the layout.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Ints
from relmap.core.linalg.cholesky_kernels import Layout
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import unset

WIDE = 48
"""Maximum width of a panel, except for a single block: wider ones are multiplied by other code."""


@helper
def _heads(width: Ints, order: Ints, begin: Ints, place: Ints, tied: Ints) -> Ints:
    """Return the indices of blocks that start a panel, and the number of blocks at the end.

    A block joins the panel of the previous one if both are coupled to the same others.
    """
    n, count, wide = len(order), 0, 0
    heads, before = np.empty(n + 1, dtype=np.int64), -1
    for p in range(n):
        others, nearest = 0, n
        for q in tied[begin[p] : begin[p + 1]]:
            others += width[q]
            nearest = min(nearest, place[q])
        wide += width[order[p]]
        if before != width[order[p]] + others or wide > WIDE:
            heads[count], wide = p, width[order[p]]
            count += 1
        before = others if nearest == p + 1 else -1
    heads[count] = n
    return heads[: count + 1]


@helper
def _coupled(order: Ints, place: Ints, begin: Ints, cliques: Ints) -> tuple[Ints, Ints]:
    """Return the blocks coupled to each when it is eliminated, as `begin` (n + 1,) and blocks.

    A clique waits for the first of its blocks. There, all that wait are united, and what is left
    waits for the next (symbolic multifrontal factorisation; Duff and Reid, 1983).
    """
    n, given = len(order), len(begin) - 1
    stop, tied = np.zeros(n + 1, dtype=np.int64), np.empty(len(cliques), dtype=np.int64)
    waiting, following, taken = unset(n), unset(given + n), unset(n)
    for c in range(given):
        _wait(c, cliques[begin[c] : begin[c + 1]], place, waiting, following)
    for p in range(n):
        taken[p], count, c = p, stop[p], waiting[p]
        while c >= 0:
            if c < given:
                blocks = cliques[begin[c] : begin[c + 1]]
            else:
                blocks = tied[stop[c - given] : stop[c - given + 1]]
            for block in blocks:
                if taken[place[block]] == p:
                    continue
                if count == len(tied):
                    tied = _doubled(tied)
                tied[count], taken[place[block]] = block, p
                count += 1
            c = following[c]
        stop[p + 1] = count
        _wait(given + p, tied[stop[p] : count], place, waiting, following)
    return stop, tied


@helper
def _doubled(values: Ints) -> Ints:
    longer = np.empty(2 * len(values), dtype=np.int64)
    for k in range(len(values)):
        longer[k] = values[k]
    return longer


@helper
def _wait(clique: int, blocks: Ints, place: Ints, waiting: Ints, following: Ints) -> None:
    """Let a clique wait for the first of its blocks to be eliminated."""
    if len(blocks):
        first = place[blocks[0]]
        for block in blocks:
            first = min(first, place[block])
        following[clique], waiting[first] = waiting[first], clique


@compiled
def panels(width: Ints, order: Ints, begin: Ints, cliques: Ints) -> tuple[Ints, Layout]:
    """Return the first unknown (b,) of each block, and the layout of the factor.

    The rows of a panel are not in order yet. `width` (n,): unknowns of each block; `order` (n,):
    the blocks as they are eliminated; `begin` (c + 1,), `cliques`: as of `Pattern.of_cliques`.
    """
    n = len(order)
    place, at = np.empty(n, dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    for p in range(n):
        place[order[p]] = p
        at[p + 1] = at[p] + width[order[p]]
    begin, tied = _coupled(order, place, begin, cliques)
    heads = _heads(width, order, begin, place, tied)
    m = len(heads) - 1
    start, first = np.empty(m + 1, dtype=np.int64), np.empty(n, dtype=np.int64)
    for g in range(m + 1):
        start[g] = at[heads[g]]
    for p in range(n):
        first[order[p]] = at[p]
    row_begin, offset = np.zeros(m + 1, dtype=np.int64), np.zeros(m + 1, dtype=np.int64)
    for g in range(m):
        p = heads[g]
        height = width[order[p]]
        for q in range(begin[p], begin[p + 1]):
            height += width[tied[q]]
        row_begin[g + 1] = row_begin[g] + height
        offset[g + 1] = offset[g] + height * (start[g + 1] - start[g])
    rows, column_of = np.empty(row_begin[m], dtype=np.int64), np.empty(at[n], dtype=np.int64)
    for g in range(m):
        p, r = heads[g], row_begin[g]
        for u in range(start[g], start[g + 1]):
            column_of[u] = g
        for k in range(begin[p] - 1, begin[p + 1]):
            block = tied[k] if k >= begin[p] else order[p]
            for u in range(width[block]):
                rows[r] = first[block] + u
                r += 1
    return first, (start, column_of, row_begin, rows, offset)
