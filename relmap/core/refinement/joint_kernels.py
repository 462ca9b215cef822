"""The joint least squares with the landmarks eliminated, compiled, and what both ways share.

A row is a landmark in a segment.  Rows come in the order of their segments; `begin` (s + 1,) tells
where each segment's begin.  A matrix is stored as its factor will be; see `cholesky`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.cholesky_kernels import Layout
from relmap.core.linalg.compiling import compiled
from relmap.core.linalg.small_kernels import product
from relmap.core.refinement.segment_kernels import derivative

Blocks = tuple[NDArray[np.int64], Layout]
"""First unknown of each node, and how the matrix is laid out."""


@compiled
def breadth_first(
    begin: NDArray[np.int64],
    landmark: NDArray[np.int64],
    landmark_begin: NDArray[np.int64],
    entry: NDArray[np.int64],
    segment: NDArray[np.int64],
    of_landmark: NDArray[np.int64],
    of_segment: NDArray[np.int64],
    queue: NDArray[np.int64],
    state: NDArray[np.int64],
    budget: int,
) -> bool:
    """Go on searching the levels of landmarks and segments breadth-first; tell whether it is done.

    `entry` lists the rows of each landmark, from `landmark_begin` on; levels (m,) and (s,) are -1
    where not found yet.  `state` holds tail and head of the queue (m,), the level reached and the
    landmark to begin with.  What cannot be reached stands in levels of its own, after the others.
    About as many rows as the budget says are looked at.
    """
    tail, head, base, candidate = state
    while tail < len(queue) or head < tail:
        if head == tail:
            while of_landmark[candidate] >= 0:
                candidate = (candidate + 1) % len(queue)
            of_landmark[candidate] = base
            queue[tail] = candidate
            tail += 1
        here = queue[head]
        head += 1
        level = of_landmark[here]
        base = level + 1
        for e in range(landmark_begin[here], landmark_begin[here + 1]):
            s = segment[entry[e]]
            budget -= 1
            if of_segment[s] >= 0:
                continue
            of_segment[s] = level
            for row in range(begin[s], begin[s + 1]):
                budget -= 1
                if of_landmark[landmark[row]] < 0:
                    of_landmark[landmark[row]] = level + 1
                    queue[tail] = landmark[row]
                    tail += 1
        if budget <= 0:
            break
    state[0], state[1], state[2], state[3] = tail, head, base, candidate
    return bool(tail == len(queue) and head == tail)


@compiled
def subtract(
    part: NDArray[np.float64],
    nodes: NDArray[np.int64],
    q: int,
    buffer: NDArray[np.float64],
    blocks: Blocks,
) -> None:
    """Subtract a part (n q, n q) over n nodes, not all different, from a matrix."""
    first, (start, column_of, row_begin, rows, offset) = blocks
    place, last = np.empty_like(column_of), -1
    for j in np.argsort(first[nodes]):
        column = first[nodes[j]]
        p = column_of[column]
        if p != last:
            for r in range(row_begin[p], row_begin[p + 1]):
                place[rows[r]] = r - row_begin[p]
            last = p
        width = start[p + 1] - start[p]
        for i in range(len(nodes)):
            row = first[nodes[i]]
            if row < column:
                continue
            for a in range(q):
                at = offset[p] + (place[row] + a) * width + column - start[p]
                for b in range(q):
                    buffer[at + b] -= part[i * q + a, j * q + b]


@compiled
def _eliminated(
    pull: NDArray[np.float64], own: NDArray[np.float64], total: float
) -> NDArray[np.float64]:
    """Return what a landmark of some weight takes from the matrix of its placements (n q, n q).

    Less their own share `own` (n, q, q); `pull` (d, n q) are the weighted derivatives of the rows.
    """
    q = own.shape[1]
    part = np.empty((pull.shape[1], pull.shape[1]))
    for a in range(pull.shape[1]):
        for b in range(a + 1):
            entry = 0.0
            for c in range(len(pull)):
                entry += pull[c, a] * pull[c, b]
            part[a, b] = part[b, a] = entry / total
    for k in range(len(own)):
        for a in range(q):
            for b in range(q):
                part[q * k + a, q * k + b] -= own[k, a, b]
    return part


@compiled
def placement_equations(
    entry_begin: NDArray[np.int64],
    entry: NDArray[np.int64],
    placement: NDArray[np.int64],
    points: NDArray[np.float64],
    residual: NDArray[np.float64],
    weight: NDArray[np.float64],
    gradient: NDArray[np.float64],
    buffer: NDArray[np.float64],
    blocks: Blocks,
) -> None:
    """Add the normal equations of the placements, with the landmarks eliminated.

    Parameters
    ----------
    entry_begin : (m + 1,) int64
        Where the rows of each landmark begin in `entry`.
    entry : (n,) int64
    placement : (n,) int64
        Ascending among the rows of each landmark.
    points : (n, d) float64, metres
        The rows as placed, from the centre that their placement turns about.
    residual : (n, d) float64, metres
        How far they are from the mean of their landmark.
    weight : (n,) float64
        Of all observations in a row.
    gradient : (p, q) float64
        Added to.
    buffer : float64
        The matrix, added to; nothing is where it is empty.
    """
    d = points.shape[1]
    q = 3 * d - 3
    J = np.empty((d, q))
    for i in range(len(entry_begin) - 1):
        rows = entry[entry_begin[i] : entry_begin[i + 1]]
        nodes, n, total = np.empty(len(rows), dtype=np.int64), 0, 0.0
        pull, own = np.zeros((d, q * len(rows))), np.zeros((len(rows), q, q))
        for row in rows:
            if n == 0 or nodes[n - 1] != placement[row]:
                nodes[n] = placement[row]
                n += 1
            total += weight[row]
            derivative(points, row, J)
            for a in range(d):
                for b in range(q):
                    weighted = weight[row] * J[a, b]
                    pull[a, q * (n - 1) + b] += weighted
                    gradient[nodes[n - 1], b] += weighted * residual[row, a]
                    for c in range(q):
                        own[n - 1, b, c] += weighted * J[a, c]
        if len(buffer) > 0:
            part = _eliminated(pull[:, : q * n], own[:n], total)
            subtract(part, nodes[:n], q, buffer, blocks)


@compiled
def _part(
    nodes: NDArray[np.int64],
    q: int,
    inverse: NDArray[np.float64],
    blocks: Blocks,
) -> NDArray[np.float64]:
    """Return the part (n q, n q) of the inverse of a matrix that is over n nodes."""
    first, (start, column_of, row_begin, rows, offset) = blocks
    part = np.empty((q * len(nodes), q * len(nodes)))
    place = np.empty_like(column_of)
    for m in range(len(nodes)):
        column = first[nodes[m]]
        p = column_of[column]
        for r in range(row_begin[p], row_begin[p + 1]):
            place[rows[r]] = r - row_begin[p]
        width = start[p + 1] - start[p]
        for k in range(len(nodes)):
            row = first[nodes[k]]
            if row < column:
                continue
            for a in range(q):
                at = offset[p] + (place[row] + a) * width + column - start[p]
                for b in range(q):
                    part[q * k + a, q * m + b] = part[q * m + b, q * k + a] = inverse[at + b]
    return part


@compiled
def spread_of_landmarks(
    entry_begin: NDArray[np.int64],
    entry: NDArray[np.int64],
    placement: NDArray[np.int64],
    points: NDArray[np.float64],
    weight: NDArray[np.float64],
    inverse: NDArray[np.float64],
    blocks: Blocks,
) -> NDArray[np.float64]:
    """Return the covariances (m, d, d) of landmarks, of unit noise, from that of placements."""
    d = points.shape[1]
    q = 3 * d - 3
    found, J = np.zeros((len(entry_begin) - 1, d, d)), np.empty((d, q))
    for i in range(len(found)):
        rows = entry[entry_begin[i] : entry_begin[i + 1]]
        nodes, pull, total = np.empty(len(rows), dtype=np.int64), np.empty((d, q * len(rows))), 0.0
        for k in range(len(rows)):
            total += weight[rows[k]]
            nodes[k] = placement[rows[k]]
        for k in range(len(rows)):
            derivative(points, rows[k], J)
            for a in range(d):
                for b in range(q):
                    pull[a, q * k + b] = weight[rows[k]] / total * J[a, b]
        half = product(pull, _part(nodes, q, inverse, blocks))
        for a in range(d):
            for b in range(d):
                for c in range(half.shape[1]):
                    found[i, a, b] += half[a, c] * pull[b, c]
            found[i, a, a] += 1 / total
    return found
