"""Sparse symmetric systems, solved by a Cholesky factor in small dense panels.

Where the factor has entries depends on who is tied to whom alone.  That is found once, in one of
two ways, however often the numbers change (T. A. Davis, "Direct Methods for Sparse Linear Systems",
2006).  What a scan says of walls is a clique: a set of unknowns all tied to one another; an order
of least degree leaves the factor of a sum of cliques sparse.  Landmarks and placements are ordered
by breadth-first search instead, in levels that touch only their neighbours (Cuthill and McKee,
1969): that takes no more time than looking at all rows once.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg.lapack import dtrtri

from relmap.core.arrays import Floats, Ints

if TYPE_CHECKING:
    from relmap.core.linalg.cholesky_kernels import Layout

WIDE = 48
"""Unknowns of a panel of a level at most: what is wider is better multiplied."""
STIFF = 1e9
"""What holds an unknown that is not free, as a multiple of what holds others."""


class Pattern:
    """In which order to eliminate, and where the factor has its entries.

    Parameters
    ----------
    first : (b,) int64
        Number of each block's first unknown; the others follow.
    layout : as `relmap.core.linalg.cholesky_kernels` has it

    Attributes
    ----------
    size : int
        Entries of the factor.
    """

    def __init__(self, first: Ints, layout: Layout) -> None:
        self.first, self.layout = first, layout
        start, column_of, _, _, offset = layout
        self.size = int(offset[-1])
        heights = np.diff(offset) // np.maximum(np.diff(start), 1)
        self._flops = np.diff(start) * heights.astype(np.float64) ** 2
        within, width = np.arange(len(column_of)) - start[column_of], np.diff(start)[column_of]
        self._diagonal = offset[column_of] + within * (width + 1)

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return len(self.layout[1])

    @property
    def flops(self) -> float:
        """About how many operations a factorisation takes."""
        return float(self._flops.sum())

    @classmethod
    def of_cliques(cls, width: Ints, begin: Ints, cliques: Ints) -> Pattern:
        """Return an order that fills little.

        Parameters
        ----------
        width : (b,) int64
            Unknowns of each block; at least 1.
        begin : (g + 1,) int64
        cliques : (begin[-1],) int64
            The blocks of each clique, one clique after another, no block twice in one.
        """
        from relmap.core.linalg.cholesky_kernels import panels
        from relmap.core.linalg.elimination_kernels import minimum_degree

        order, tied_begin, tied = minimum_degree(width, begin, cliques)
        first, (start, column_of, row_begin, rows, offset) = panels(width, order, tied_begin, tied)
        panel = len(column_of) * np.repeat(np.arange(len(start) - 1), np.diff(row_begin))
        return cls(first, (start, column_of, row_begin, np.sort(panel + rows) - panel, offset))

    @classmethod
    def of_levels(cls, level: Ints, q: int) -> Pattern:
        """Return the order of levels.

        Parameters
        ----------
        level : (n,) int64
            Of each node, from 0, none left out; neighbours are at most one level apart.
        q : int
            Unknowns of each node.
        """
        ends = q * np.cumsum(np.bincount(level))
        begins, step = np.append(0, ends[:-1]), q * max(WIDE // q, 1)
        pieces = [np.arange(*of, step) for of in zip(begins, ends, strict=True)]
        last = np.repeat(np.append(ends[1:], ends[-1]), [len(piece) for piece in pieces])
        start = np.concatenate([*pieces, ends[-1:]])
        rows = [np.arange(*of) for of in zip(start[:-1], last, strict=True)]
        heights, widths = last - start[:-1], np.diff(start)
        row_begin = np.append(0, np.cumsum(heights))
        offset = np.append(0, np.cumsum(heights * widths))
        column_of = np.repeat(np.arange(len(widths)), widths)
        first = np.empty(len(level), dtype=np.int64)
        first[np.argsort(level, kind="stable")] = q * np.arange(len(level))
        return cls(first, (start, column_of, row_begin, np.concatenate(rows), offset))

    def add(self, values: Floats, unknowns: Ints, part: Floats) -> None:
        """Add a symmetric part (n, n) over unknowns (n,), ascending and all tied, to a matrix."""
        from relmap.core.linalg.cholesky_kernels import add_part

        add_part(self.layout, unknowns, part, values, np.empty_like(self.layout[1]))

    def hold(self, values: Floats, share: float, least: float) -> None:
        """Hold every unknown where it is a little: a share of what holds it, and at least so much.

        `values` (size,) is the matrix.
        """
        values[self._diagonal] *= 1 + share
        values[self._diagonal] += least

    def largest(self, values: Floats) -> float:
        """Return the largest entry of the matrix's diagonal."""
        return float(values[self._diagonal].max())

    def fix(self, values: Floats, node: int, q: int) -> None:
        """Let a node's q unknowns stay where they are."""
        own = self._diagonal[self.first[node] : self.first[node] + q]
        values[own] += STIFF * max(self.largest(values), 1.0)

    def factorise(self, values: Floats) -> None:
        """Put its Cholesky factor in place of a matrix.

        `values` (size,) is the matrix, positive definite, its lower triangle as `add` puts it.
        An unknown of which rounding leaves nothing stays where it is.
        """
        from relmap.core.linalg.cholesky_kernels import factorise

        factorise(self.layout, values)

    def solve(self, values: Floats, right: Floats) -> Floats:
        """Return the solution (u,) for a right side; `values` (size,) is the factor."""
        from relmap.core.linalg.cholesky_kernels import solve

        return solve(self.layout, values, right)

    def inverse(self, values: Floats) -> Floats:
        """Return the inverse where the factor has entries (Takahashi, Fagan and Chin, 1973).

        Parameters
        ----------
        values : (size,) float64
            The factor.

        Returns
        -------
        (size,) float64
        """
        start, _, row_begin, rows, _ = self.layout
        found, place = np.empty_like(values), np.empty_like(rows, shape=self.n_unknowns)
        for p in range(len(start) - 2, -1, -1):
            k, panel, target = (
                start[p + 1] - start[p],
                self._panel(values, p),
                self._panel(found, p),
            )
            root = dtrtri(np.tril(panel[:k]), lower=1)[0]
            target[:k] = root.T @ root
            below = rows[row_begin[p] + k : row_begin[p + 1]]
            if len(below):
                pull = panel[k:] @ root
                target[k:] = -(self._part(found, below, place) @ pull)
                target[:k] -= pull.T @ target[k:]
        return found

    def _panel(self, values: Floats, p: int) -> Floats:
        """Return the columns (h, k) of a panel, a view."""
        start, _, _, _, offset = self.layout
        return values[offset[p] : offset[p + 1]].reshape(-1, start[p + 1] - start[p])

    def _part(self, values: Floats, unknowns: Ints, place: Ints) -> Floats:
        """Return the symmetric part (n, n) over unknowns (n,), ascending; `place` (u,) is room."""
        start, column_of, row_begin, rows, _ = self.layout
        part = np.empty((len(unknowns), len(unknowns)))
        panels = column_of[unknowns]
        begins = np.append(np.flatnonzero(np.diff(panels, prepend=-1)), len(unknowns))
        for a, b in itertools.pairwise(begins):
            p = panels[a]
            place[rows[row_begin[p] : row_begin[p + 1]]] = np.arange(
                row_begin[p + 1] - row_begin[p]
            )
            entries = self._panel(values, p)[place[unknowns[a:]]][:, unknowns[a:b] - start[p]]
            lower = np.tril(entries[: b - a])
            part[b:, a:b], part[a:b, b:] = entries[b - a :], entries[b - a :].T
            part[a:b, a:b] = lower + np.tril(lower, -1).T
        return part

    def parts(self, inverse: Floats, chosen: Ints) -> Floats:
        """Return parts (k, m, m) of the inverse: those of unknowns (k, m) tied to one another."""
        return np.asarray(inverse[self._places(chosen)])

    def lower(self, chosen: Ints) -> tuple[Ints, tuple[Ints, ...]]:
        """Return where parts (k, m, m) over unknowns (k, m) go, and which entries of the parts do.

        Of two that mirror one another one goes.
        """
        goes = chosen[:, :, None] >= chosen[:, None]
        return self._places(chosen)[goes], np.nonzero(goes)

    def add_diagonal(self, values: Floats, unknowns: Ints, value: float) -> None:
        """Add a value to the diagonal of a matrix (size,), at unknowns (n,)."""
        values[self._diagonal[unknowns]] += value

    def _places(self, chosen: Ints) -> Ints:
        """Return where the entries (k, m, m) of parts over unknowns (k, m) stand."""
        start, column_of, row_begin, rows, offset = self.layout
        earlier = np.minimum(chosen[:, :, None], chosen[:, None])
        p, u = column_of[earlier], self.n_unknowns
        keys = np.repeat(np.arange(len(row_begin) - 1), np.diff(row_begin)) * u + rows
        later = np.maximum(chosen[:, :, None], chosen[:, None])
        row = np.searchsorted(keys, p * u + later) - row_begin[p]
        return np.asarray(offset[p] + row * (start[p + 1] - start[p]) + earlier - start[p])
