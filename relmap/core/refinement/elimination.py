"""The joint least squares with the placements eliminated, segment by segment.

Each iteration of a segment has a placement of its own; those that saw the same share it.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from relmap.core.geometry.alignment import sums_each
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.condensing import LENGTH
from relmap.core.refinement.rows import JointRows

BARELY = 1e-13
"""What keeps rounding from making a matrix indefinite, as a share of its entries."""


class FreePlacements:
    """What the placements of each segment leave of the equations of the landmarks.

    Parameters
    ----------
    rows : JointRows
    anchor : (segment, bit)
        The iteration whose placement is not free.
    """

    def __init__(self, rows: JointRows, anchor: tuple[int, int]) -> None:
        d = rows.points.shape[1]
        self._rows = rows
        self._begin = rows.begin
        bits = (rows.visible >> np.arange(LENGTH)[:, None]) & 1 > 0
        self._patterns = []
        for begin, end in zip(self._begin[:-1], self._begin[1:], strict=True):
            self._patterns.append(_patterns(np.repeat(bits[:, begin:end], d, axis=1)))
        self._anchor = anchor[0]
        begin, end = self._begin[anchor[0] : anchor[0] + 2]
        seen = np.repeat(bits[anchor[1], begin:end], d)
        self._fixed = (self._patterns[anchor[0]][0] == seen).all(axis=1)

    def equations(
        self,
        positions: NDArray[np.float64],
        placed: NDArray[np.float64],
        weight: NDArray[np.float64],
        pattern: Pattern,
        buffer: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Add the normal equations of the landmarks to the matrix; return their right side.

        Parameters
        ----------
        positions : (m, d) float64, map frame, metres
        placed : (n, d) float64, map frame, metres
            Where the rows are.
        weight : (n,) float64
            Of one observation.
        pattern : Pattern
        buffer : float64
            The matrix, added to; nothing is where it is empty.

        Returns
        -------
        right : (m, d) float64
        cost : (s,) float64
            Weighted sum of squares that is left of each segment.
        """
        from relmap.core.refinement.joint_kernels import subtract

        rows, d = self._rows, positions.shape[1]
        there, root = positions[rows.landmark], np.repeat(np.sqrt(weight), d)
        roots = root[:, None] * self._derivatives(there).reshape(len(root), -1)
        errors, seen = root * (placed - there).ravel(), np.repeat(rows.n_seen, d)
        left = seen * errors
        for s, (saw, counts) in enumerate(self._patterns):
            begin, end = self._begin[s], self._begin[s + 1]
            at = slice(d * begin, d * end)
            T = _taken_away(roots[at], saw, counts, d)
            left[at] -= (T @ errors[at]) @ T
            if len(buffer):
                if s == self._anchor:
                    free = 1 - self._fixed / counts
                    T *= np.repeat(np.sqrt(free), roots.shape[1])[:, None]
                T *= root[at]
                part = T.T @ T
                part.flat[:: len(part) + 1] -= root[at] ** 2 * seen[at]
                subtract(part, rows.landmark[begin:end], d, buffer, pattern.blocks)
        right = sums_each((root * left).reshape(-1, d), rows.landmark, len(positions))
        squares = (errors * left).reshape(-1, d).sum(axis=1)
        cost = np.bincount(rows.segment, weights=squares, minlength=len(rows.segments))
        return right, cost.astype(np.float64)

    def _derivatives(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives (n, d, q) of points by a turn about their segment's middle."""
        segment, (n, d) = self._rows.segment, points.shape
        middle = sums_each(points, segment, len(self._rows.segments))
        x = points - (middle / np.diff(self._begin)[:, None])[segment]
        J = np.zeros((n, d, 3 * d - 3))
        J[:, :, -d:] = np.eye(d)
        if d == 2:
            J[:, 0, 0], J[:, 1, 0] = -x[:, 1], x[:, 0]
        else:
            for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
                J[:, a, b], J[:, a, c] = x[:, c], -x[:, b]
        return J


def _patterns(bits: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return what iterations (k, n) saw that saw anything, each once, and how many saw that."""
    times = Counter(row.tobytes() for row in bits if row.any())
    saw = np.frombuffer(b"".join(times), dtype=bool).reshape(len(times), -1)
    return saw, np.array(list(times.values()))


def _taken_away(
    roots: NDArray[np.float64], saw: NDArray[np.bool_], counts: NDArray[np.int64], d: int
) -> NDArray[np.float64]:
    """Return what free placements of patterns take away from points, as a root (p q, n d).

    Of the derivatives (n d, q); `saw` (p, n d) tells which a pattern saw, `counts` (p,) how many
    iterations saw them.
    """
    q = roots.shape[1]
    seen = np.multiply(saw[:, None, :], np.ascontiguousarray(roots.T))
    G = seen @ seen.transpose(0, 2, 1)
    hold = np.diagonal(G, axis1=1, axis2=2).copy()
    hold[:, : q - d] = hold[:, : q - d].max(axis=1, keepdims=True)
    G[:, range(q), range(q)] += BARELY * hold + 1e-300
    root = np.sqrt(counts)[:, None, None] * np.linalg.inv(np.linalg.cholesky(G))
    return np.asarray((root @ seen).reshape(-1, len(roots)))
