"""Hot loops of the joint least squares with the landmarks eliminated, and what both ways share.

Compiled; see `kernels` on how and why.

A row is a landmark in a segment.  Rows come in the order of their segments; `begin` (s + 1,) tells
where each segment's begin.  A matrix is a buffer of dense blocks; see `tridiagonal`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled
from relmap.core.segmentkernels import derivative


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
    of_landmark = np.full(len(landmark_begin) - 1, -1)
    of_segment = np.full(len(begin) - 1, -1)
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
    product: NDArray[np.float64],
    nodes: NDArray[np.int64],
    q: int,
    buffer: NDArray[np.float64],
    level: NDArray[np.int64],
    place: NDArray[np.int64],
    width: NDArray[np.int64],
    offset: NDArray[np.int64],
) -> None:
    """Subtract a product (n q, n q) over n nodes from the lower blocks of a matrix."""
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
                    buffer[at + b] -= product[i * q + a, j * q + b]


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
    q = 3 if d == 2 else 6
    J = np.empty((d, q))
    for i in range(len(entry_begin) - 1):
        rows = entry[entry_begin[i] : entry_begin[i + 1]]
        total = weight[rows].sum()
        T = np.zeros((d, q * len(rows)))
        for k in range(len(rows)):
            derivative(points[rows[k]], J)
            for b in range(q):
                for a in range(d):
                    value = weight[rows[k]] * J[a, b]
                    gradient[placement[rows[k]], b] += value * residual[rows[k], a]
                    T[a, q * k + b] = value / np.sqrt(total)
        if len(buffer) == 0:
            continue
        product = np.dot(T.T, T)
        for k in range(len(rows)):
            derivative(points[rows[k]], J)
            for a in range(q):
                for b in range(q):
                    for c in range(d):
                        own = weight[rows[k]] * J[c, a] * J[c, b]
                        product[q * k + a, q * k + b] -= own
        subtract(product, placement[rows], q, buffer, level, place, width, offset)


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
    q = 3 if d == 2 else 6
    found = np.zeros((len(entry_begin) - 1, d, d))
    J = np.empty((d, q))
    for i in range(len(found)):
        rows = entry[entry_begin[i] : entry_begin[i + 1]]
        total = weight[rows].sum()
        pull = np.empty((d, q * len(rows)))
        joint = np.empty((q * len(rows), q * len(rows)))
        for k in range(len(rows)):
            derivative(points[rows[k]], J)
            pull[:, q * k : q * (k + 1)] = weight[rows[k]] / total * J
            row = placement[rows[k]]
            for m in range(len(rows)):
                column = placement[rows[m]]
                if level[row] < level[column]:
                    continue
                same = level[row] == level[column]
                start = offset[level[column], 0 if same else 1] + place[column]
                for a in range(q):
                    at = start + (place[row] + a) * width[level[column]]
                    for b in range(q):
                        joint[q * k + a, q * m + b] = inverse[at + b]
                        joint[q * m + b, q * k + a] = inverse[at + b]
        found[i] = np.dot(np.dot(pull, joint), pull.T)
        for a in range(d):
            found[i, a, a] += 1 / total
    return found
