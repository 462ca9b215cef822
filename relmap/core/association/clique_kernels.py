"""The largest clique of a graph, compiled: branch and bound.

The bound is a greedy colouring: a clique has one node of each colour at most (Tomita and Seki,
2003).
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.search_kernels import distances
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import ordered


@compiled
def agreeing(source: Floats, target: Floats, a: Ints, b: Ints, tolerance_m: float) -> Bools:
    """Return which pairs of matches agree: different points, equally far apart on both sides.

    `source`, `target` (p, d), metres: positions of the two points of each match; `a`, `b` (p,):
    indices of these points; `tolerance_m`: largest difference between two distances that agree.
    Returns (p, p), symmetric.
    """
    here, there, n = distances(source), distances(target), len(source)
    agree = np.zeros((n, n), dtype=np.bool_)
    for i in range(n):
        for j in range(i):
            if a[i] != a[j] and b[i] != b[j]:
                agree[i, j] = agree[j, i] = abs(here[i, j] - there[i, j]) <= tolerance_m
    return agree


@compiled
def largest_clique(agree: Bools, most_steps: int) -> Ints:
    """Return the nodes of a largest clique, ascending; of the largest found if steps run out.

    `agree` (n, n), symmetric: the graph; its diagonal is ignored. `most_steps`: maximum number of
    nodes of the search tree to visit. The search starts with a greedily grown clique.
    """
    n = len(agree)
    order = _by_neighbours(agree)
    neighbours = np.empty((n, n), dtype=np.bool_)
    for i in range(n):
        for j in range(n):
            neighbours[i, j] = agree[order[i], order[j]]
    best = _grown(neighbours)
    nodes, colours = np.empty((n + 1, n), dtype=np.int64), np.empty((n + 1, n), dtype=np.int64)
    left = np.zeros(n + 1, dtype=np.int64)
    chosen = np.empty(n, dtype=np.int64)
    open_, marked = np.empty(n, dtype=np.int64), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        open_[i] = i
    _colour(neighbours, open_, nodes[0], colours[0])
    left[0] = n
    depth, steps = 0, 0
    while depth >= 0 and steps < most_steps:
        k = left[depth] - 1
        if k < 0 or depth + colours[depth, k] <= len(best):
            depth -= 1
            continue
        steps += 1
        v = nodes[depth, k]
        left[depth] = k
        chosen[depth] = v
        for i in range(k):
            marked[nodes[depth, i]] = neighbours[v, nodes[depth, i]]
        depth += 1
        left[depth] = _gather(marked, open_)
        _colour(neighbours, open_[: left[depth]], nodes[depth], colours[depth])
        if left[depth] == 0 and depth > len(best):
            best = chosen[:depth].copy()
    for i in best:
        marked[order[i]] = True
    return open_[: _gather(marked, open_)]


@helper
def _by_neighbours(agree: Bools) -> Ints:
    """Return the nodes by descending number of neighbours; ties keep their order."""
    fewer = np.zeros(len(agree), dtype=np.int64)
    for i in range(len(agree)):
        for j in range(len(agree)):
            fewer[i] -= agree[i, j]
    return ordered(fewer)


@helper
def _gather(marked: Bools, nodes: Ints) -> int:
    """List the marked nodes, ascending, and unmark them; return their number."""
    k = 0
    for i in range(len(marked)):
        if marked[i]:
            nodes[k], marked[i] = i, False
            k += 1
    return k


@helper
def _grown(neighbours: Bools) -> Ints:
    """Return a clique grown greedily by taking the nodes in this order."""
    members = np.empty(len(neighbours), dtype=np.int64)
    k = 0
    for i in range(len(neighbours)):
        fits = True
        for j in range(k):
            fits = fits and neighbours[i, members[j]]
        if fits:
            members[k] = i
            k += 1
    return members[:k]


@helper
def _colour(neighbours: Bools, open_: Ints, nodes: Ints, colours: Ints) -> None:
    """Colour the open nodes so that no two neighbours share one.

    Nodes and colours, counted from 1, are written in ascending order of colour.
    """
    rest, k, colour = open_, 0, 0
    while len(rest):
        colour += 1
        first, n_later = k, 0
        later = np.empty(len(rest), dtype=np.int64)
        for v in rest:
            fits = True
            for j in range(first, k):
                if neighbours[v, nodes[j]]:
                    fits = False
                    break
            if fits:
                nodes[k], colours[k] = v, colour
                k += 1
            else:
                later[n_later] = v
                n_later += 1
        rest = later[:n_later]
