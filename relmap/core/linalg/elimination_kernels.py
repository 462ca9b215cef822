"""The order in which unknowns are eliminated; see `relmap.core.linalg.cholesky`.

The graph is represented by its cliques. Eliminating a block merges all cliques that contain it into
one (the quotient graph; George and Liu, "The evolution of the minimum degree ordering", 1989),
which is also the pattern of its column of the factor.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import unset

NEVER = 2**62
"""Replaces the degree of an eliminated block."""


@helper
def _union(
    of: int, begin: Ints, end: Ints, member: Ints, own: Ints, mark: Ints, stamp: int
) -> Ints:
    """Return the members of some cliques without duplicates, except one member."""
    size = 0
    for e in own:
        size += end[e] - begin[e]
    found, n = np.empty(size, dtype=np.int64), 0
    mark[of] = stamp
    for e in own:
        for m in member[begin[e] : end[e]]:
            if mark[m] != stamp:
                mark[m] = stamp
                found[n] = m
                n += 1
    return found[:n]


@helper
def _cliques_of(n: int, begin: Ints, member: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the cliques of each of n members: begin, end, and clique numbers."""
    first, of = np.zeros(n + 1, dtype=np.int64), np.empty(len(member), dtype=np.int64)
    for m in member:
        first[m + 1] += 1
    for u in range(n):
        first[u + 1] += first[u]
    last = first[:n].copy()
    for e in range(len(begin) - 1):
        for m in member[begin[e] : begin[e + 1]]:
            of[last[m]] = e
            last[m] += 1
    return first[:n], last, of


@helper
def _absorb(clique: int, u: int, first: Ints, last: Ints, of: Ints, gone: Bools) -> None:
    """Replace the cliques of member u that a new clique has absorbed by that clique."""
    kept = first[u]
    for k in range(first[u], last[u]):
        if not gone[of[k]]:
            of[kept] = of[k]
            kept += 1
    of[kept] = clique
    last[u] = kept + 1


@helper
def _with_room(numbers: Ints, more: int) -> Ints:
    """Return numbers (n,) followed by free space."""
    longer = np.empty(len(numbers) + more, dtype=np.int64)
    for i in range(len(numbers)):
        longer[i] = numbers[i]
    return longer


@helper
def _least(degree: Ints) -> int:
    """Return the first block of minimum degree."""
    least = 0
    for v in range(len(degree)):
        if degree[v] < degree[least]:
            least = v
    return least


@helper
def _total(width: Ints, which: Ints) -> int:
    """Return the sum of the widths of some blocks."""
    total = 0
    for k in which:
        total += width[k]
    return total


@compiled
def minimum_degree(width: Ints, clique_begin: Ints, cliques: Ints) -> tuple[Ints, Ints, Ints]:
    """Return a fill-reducing elimination order (b,), and the blocks coupled to each.

    `width` (b,): number of unknowns of each block; `clique_begin`, `cliques`: blocks of each
    clique, concatenated. Returns the order, and, as `begin` (b + 1,) and `tied`, the blocks coupled
    to the first, second, ... block of the order when it is eliminated.
    """
    n, m, used = len(width), len(clique_begin) - 1, len(cliques)
    first, last, of = _cliques_of(n, clique_begin, cliques)
    begin, end = np.zeros(m + n + 1, dtype=np.int64), np.zeros(m + n, dtype=np.int64)
    for k in range(m):
        begin[k + 1] = end[k] = clique_begin[k + 1]
    member = _with_room(cliques, len(cliques))
    gone, mark = np.zeros(m + n, dtype=np.bool_), unset(n)
    degree, order = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    stamp, left = n, 0
    for v in range(n):
        own = _union(v, begin, end, member, of[first[v] : last[v]], mark, v)
        left, degree[v] = left + width[v], _total(width, own)
    for new in range(m, m + n):
        v = _least(degree)
        left -= width[v]
        all_tied = degree[v] == left  # the others too, as none has a smaller degree
        order[new - m], degree[v] = v, NEVER
        tied = _union(v, begin, end, member, of[first[v] : last[v]], mark, stamp)
        for k in range(first[v], last[v]):
            gone[of[k]] = True
        if used + len(tied) > len(member):
            member = _with_room(member, len(member) + len(tied))
        for u in tied:
            member[used] = u
            used += 1
        end[new] = begin[new + 1] = used
        for u in tied:
            stamp += 1
            _absorb(new, u, first, last, of, gone)
            if all_tied:
                degree[u] = left - width[u]
            else:
                own = _union(u, begin, end, member, of[first[u] : last[u]], mark, stamp)
                degree[u] = _total(width, own)
        stamp += 1
    return order, begin[m:] - len(cliques), member[len(cliques) : used]
