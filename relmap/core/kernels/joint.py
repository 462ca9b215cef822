"""The joint least squares with the landmarks eliminated, compiled, and what both ways share.

A row is a landmark in a segment.  Rows come in the order of their segments; `begin` (s + 1,) tells
where each segment's begin.  A matrix is a buffer of dense blocks; see `tridiagonal`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled
from relmap.core.kernels.linear import product
from relmap.core.kernels.segments import derivative


@compiled
def breadth_first(
    start: int,
    begin: NDArray[np.int64],
    landmark: NDArray[np.int64],
    landmark_begin: NDArray[np.int64],
    segment: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the levels of landmarks and segments, searched breadth-first from one landmark.

    `segment` lists the segments of each landmark, from `landmark_begin` on.  What cannot be reached
    stands in levels of its own, after the others.
    """
    of_landmark = np.empty(len(landmark_begin) - 1, dtype=np.int64)
    of_segment = np.empty(len(begin) - 1, dtype=np.int64)
    of_landmark[:] = of_segment[:] = -1
    queue = np.empty(len(of_landmark), dtype=np.int64)
    tail, head, base, candidate = 0, 0, 0, start
    while tail < len(queue):
        while of_landmark[candidate] >= 0:
            candidate = (candidate + 1) % len(queue)
        of_landmark[candidate] = base
        queue[tail] = candidate
        tail += 1
        while head < tail:
            here = queue[head]
            head += 1
            base = of_landmark[here]
            for entry in range(landmark_begin[here], landmark_begin[here + 1]):
                s = segment[entry]
                if of_segment[s] >= 0:
                    continue
                of_segment[s] = base
                for row in range(begin[s], begin[s + 1]):
                    if of_landmark[landmark[row]] < 0:
                        of_landmark[landmark[row]] = base + 1
                        queue[tail] = landmark[row]
                        tail += 1
        base += 1
    return of_landmark, of_segment


@compiled
def subtract(
    part: NDArray[np.float64],
    nodes: NDArray[np.int64],
    q: int,
    buffer: NDArray[np.float64],
    level: NDArray[np.int64],
    place: NDArray[np.int64],
    width: NDArray[np.int64],
    offset: NDArray[np.int64],
) -> None:
    """Subtract a part (n q, n q) over n nodes from the lower blocks of a matrix."""
    for i in range(len(nodes)):
        row, row_level = nodes[i], level[nodes[i]]
        for j in range(len(nodes)):
            column, column_level = nodes[j], level[nodes[j]]
            same = row_level == column_level
            if not (same and place[row] >= place[column]) and row_level != column_level + 1:
                continue
            start = offset[column_level, 0 if same else 1] + place[column]
            for a in range(q):
                at = start + (place[row] + a) * width[column_level]
                for b in range(q):
                    buffer[at + b] -= part[i * q + a, j * q + b]


@compiled
def _eliminated(
    T: NDArray[np.float64], weight: NDArray[np.float64], total: float
) -> NDArray[np.float64]:
    """Return what a landmark takes from the matrix of its placements, less their own share.

    T (d, n q) are the derivatives of its rows, of weights (n,) that come to a total.
    """
    d, q = len(T), T.shape[1] // len(weight)
    part = np.empty((T.shape[1], T.shape[1]))
    for k in range(len(weight)):
        for m in range(k + 1):
            share = weight[k] * weight[m] / total - (weight[k] if k == m else 0.0)
            for a in range(q * k, q * (k + 1)):
                for b in range(q * m, q * (m + 1)):
                    entry = 0.0
                    for c in range(d):
                        entry += T[c, a] * T[c, b]
                    part[a, b] = part[b, a] = share * entry
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
    level: NDArray[np.int64],
    place: NDArray[np.int64],
    width: NDArray[np.int64],
    offset: NDArray[np.int64],
) -> None:
    """Add the normal equations of the placements, with the landmarks eliminated.

    Parameters
    ----------
    entry_begin : (m + 1,) int64
        Where the rows of each landmark begin in `entry`.
    entry : (n,) int64
    placement : (n,) int64
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
        nodes, own, total = np.empty(len(rows), dtype=np.int64), np.empty(len(rows)), 0.0
        T = np.empty((d, q * len(rows)))
        for k in range(len(rows)):
            nodes[k], own[k] = placement[rows[k]], weight[rows[k]]
            total += own[k]
            derivative(points, rows[k], J)
            for a in range(d):
                for b in range(q):
                    T[a, q * k + b] = J[a, b]
                    gradient[nodes[k], b] += own[k] * J[a, b] * residual[rows[k], a]
        if len(buffer) > 0:
            part = _eliminated(T, own, total)
            subtract(part, nodes, q, buffer, level, place, width, offset)


@compiled
def _blocks(
    nodes: NDArray[np.int64],
    q: int,
    inverse: NDArray[np.float64],
    level: NDArray[np.int64],
    place: NDArray[np.int64],
    width: NDArray[np.int64],
    offset: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the part (n q, n q) of the inverse of a matrix that is over n nodes."""
    part = np.empty((q * len(nodes), q * len(nodes)))
    for k in range(len(nodes)):
        row = nodes[k]
        for m in range(len(nodes)):
            column = nodes[m]
            if level[row] < level[column]:
                continue
            start = offset[level[column], 0 if level[row] == level[column] else 1] + place[column]
            for a in range(q):
                at = start + (place[row] + a) * width[level[column]]
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
    level: NDArray[np.int64],
    place: NDArray[np.int64],
    width: NDArray[np.int64],
    offset: NDArray[np.int64],
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
        half = product(pull, _blocks(nodes, q, inverse, level, place, width, offset))
        for a in range(d):
            for b in range(d):
                for c in range(half.shape[1]):
                    found[i, a, b] += half[a, c] * pull[b, c]
            found[i, a, a] += 1 / total
    return found
