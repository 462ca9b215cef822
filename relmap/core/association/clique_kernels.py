"""The largest clique of a graph, compiled: branch and bound over bit sets.

The bound is a greedy colouring: a clique has one node of each colour at most (Tomita and Seki,
2003; San Segundo et al., 2011).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled

WORD = 64


@compiled
def agreeing(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    a: NDArray[np.int64],
    b: NDArray[np.int64],
    tolerance_m: float,
) -> NDArray[np.bool_]:
    """Tell which pairs of matches agree: they are of different points as far apart on both sides.

    Parameters
    ----------
    source, target : (p, d) float64, metres
        Where the two points of each match lie.
    a, b : (p,) int64
        Which points these are.
    tolerance_m : float
        Largest difference of two distances that agree.

    Returns
    -------
    (p, p) bool, symmetric
    """
    n, d = source.shape
    agree = np.zeros((n, n), np.bool_)
    for i in range(n):
        for j in range(i):
            if a[i] != a[j] and b[i] != b[j]:
                here, there = 0.0, 0.0
                for k in range(d):
                    here += (source[i, k] - source[j, k]) ** 2
                    there += (target[i, k] - target[j, k]) ** 2
                agree[i, j] = abs(np.sqrt(here) - np.sqrt(there)) <= tolerance_m
                agree[j, i] = agree[i, j]
    return agree


@compiled
def largest_clique(agree: NDArray[np.bool_], most_steps: int) -> NDArray[np.int64]:
    """Return the nodes of a largest clique, ascending; of the largest found where steps run out.

    Parameters
    ----------
    agree : (n, n) bool, symmetric
        The graph; its diagonal is not looked at.
    most_steps : int
        Nodes of the search tree that are visited at most.  A greedily grown clique is there from
        the start.
    """
    n = len(agree)
    order = _by_degree(agree)
    neighbours = _bit_rows(agree, order)
    best = _grown(agree, order)
    n_words = neighbours.shape[1]
    open_ = np.zeros((n + 1, n_words), np.uint64)
    nodes, colours = np.empty((n + 1, n), np.int64), np.empty((n + 1, n), np.int64)
    left = np.zeros(n + 1, np.int64)
    chosen = np.empty(n, np.int64)
    for v in range(n):
        open_[0, v // WORD] |= np.uint64(1) << np.uint64(v % WORD)
    left[0] = _colour(neighbours, open_[0], nodes[0], colours[0])
    depth, steps = 0, 0
    while depth >= 0 and steps < most_steps:
        k = left[depth] - 1
        if k < 0 or depth + colours[depth, k] <= len(best):
            depth -= 1
            continue
        steps += 1
        v = nodes[depth, k]
        left[depth] = k
        open_[depth, v // WORD] &= ~(np.uint64(1) << np.uint64(v % WORD))
        chosen[depth] = v
        open_[depth + 1] = open_[depth] & neighbours[v]
        depth += 1
        left[depth] = _colour(neighbours, open_[depth], nodes[depth], colours[depth])
        if left[depth] == 0 and depth > len(best):
            best = order[chosen[:depth]]
    return np.sort(best)


@compiled
def _by_degree(agree: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the nodes, those with most neighbours first; of equals the lower number."""
    n = len(agree)
    degree = np.zeros(n, np.int64)
    for i in range(n):
        for j in range(n):
            degree[i] += agree[i, j]
    return np.argsort(n - degree, kind="mergesort")


@compiled
def _bit_rows(agree: NDArray[np.bool_], order: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Return the neighbours of each node, in another order, as bits (n, words)."""
    n = len(agree)
    rows = np.zeros((n, (n + WORD - 1) // WORD), np.uint64)
    for i in range(n):
        for j in range(n):
            if i != j and agree[order[i], order[j]]:
                rows[i, j // WORD] |= np.uint64(1) << np.uint64(j % WORD)
    return rows


@compiled
def _grown(agree: NDArray[np.bool_], order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a clique that takes in, in this order, every node that fits."""
    members = np.empty(len(order), np.int64)
    k = 0
    for i in range(len(order)):
        fits = True
        for j in range(k):
            fits = fits and agree[order[i], members[j]]
        if fits:
            members[k] = order[i]
            k += 1
    return members[:k]


@compiled
def _lowest(word: np.uint64) -> int:
    """Return the number of the lowest bit that is set."""
    low = word & (~word + np.uint64(1))
    k = 0
    for half in (32, 16, 8, 4, 2, 1):
        if low >> np.uint64(half) != np.uint64(0):
            low >>= np.uint64(half)
            k += half
    return k


@compiled
def _colour(
    neighbours: NDArray[np.uint64],
    open_: NDArray[np.uint64],
    nodes: NDArray[np.int64],
    colours: NDArray[np.int64],
) -> int:
    """Colour the open nodes so that no two neighbours share one; return how many there are.

    Nodes and colours, from 1 on, are written in ascending order of the colour.
    """
    rest = open_.copy()
    k, colour = 0, 0
    while True:
        same = rest.copy()
        colour += 1
        found = False
        for word in range(len(rest)):
            while same[word] != np.uint64(0):
                v = word * WORD + _lowest(same[word])
                found = True
                bit = np.uint64(1) << np.uint64(v % WORD)
                rest[word] &= ~bit
                same[word] &= ~bit
                for other in range(word, len(rest)):
                    same[other] &= ~neighbours[v, other]
                nodes[k], colours[k] = v, colour
                k += 1
        if not found:
            return k
