"""Sparse symmetric systems, solved by a panel-wise Cholesky factorisation.

The sparsity pattern of the factor depends only on which unknowns are coupled. It is computed once
(symbolic factorisation; T. A. Davis, "Direct Methods for Sparse Linear Systems", 2006). What a scan
shows forms a clique of coupled unknowns; a minimum-degree ordering keeps the factor of a sum of
cliques sparse.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from relmap.core.arrays import Floats, Ints

if TYPE_CHECKING:
    from relmap.core.linalg.cholesky_kernels import Layout


class Pattern:
    """Elimination order and sparsity pattern of the factor.

    `first` (b,): number of each block's first unknown; the others follow. `layout`: see
    `relmap.core.linalg.cholesky_kernels`.

    Attributes: `size`: entries of the factor; `flops`: approximate number of operations of a
    factorisation.
    """

    def __init__(self, first: Ints, layout: Layout) -> None:
        self.first, self.layout = first, layout
        start, column_of, _, _, offset = layout
        self.size = int(offset[-1])
        heights = np.diff(offset) // np.maximum(np.diff(start), 1)
        self.flops = float((np.diff(start) * heights.astype(np.float64) ** 2).sum())
        within, width = np.arange(len(column_of)) - start[column_of], np.diff(start)[column_of]
        self._diagonal = offset[column_of] + within * (width + 1)

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return len(self.layout[1])

    @classmethod
    def of_cliques(cls, width: Ints, begin: Ints, cliques: Ints) -> Pattern:
        """Return a fill-reducing ordering.

        `width` (b,): number of unknowns of each block; at least 1. `begin` (g + 1,); `cliques`
        (begin[-1],): the blocks of each clique, concatenated, without duplicates in a clique.
        """
        from relmap.core.linalg.symbolic_kernels import panels

        order = _minimum_degree(len(width), begin, cliques)
        first, (start, column_of, row_begin, rows, offset) = panels(width, order, begin, cliques)
        panel = len(column_of) * np.repeat(np.arange(len(start) - 1), np.diff(row_begin))
        return cls(first, (start, column_of, row_begin, np.sort(panel + rows) - panel, offset))

    @classmethod
    def of_pairs(cls, width: Ints, group: Ints, block: Ints) -> Pattern:
        """Return the same for blocks that are coupled where they belong to one group.

        `group`, `block` (n,): the pairs, in any order; some may occur several times.
        """
        cliques, member = np.divmod(np.unique(group * len(width) + block), len(width))
        return cls.of_cliques(width, np.searchsorted(cliques, np.arange(cliques[-1] + 2)), member)

    def hold(self, values: Floats, share: float, least: float | Floats) -> None:
        """Damp every unknown: add a fraction of its diagonal entry, and at least a minimum.

        `values` (size,) is the matrix.
        """
        values[self._diagonal] *= 1 + share
        values[self._diagonal] += least

    def largest(self, values: Floats, square: float | Floats = 1.0) -> float:
        """Return the largest diagonal entry of the matrix, times the squares of units (u,)."""
        return float((values[self._diagonal] * square).max())

    def factorise(self, values: Floats) -> None:
        """Replace a matrix by its Cholesky factor.

        `values` (size,) is the matrix, positive definite, its lower triangle as `add_part` puts it.
        An unknown whose pivot is lost to rounding is fixed.
        """
        from relmap.core.linalg.cholesky_kernels import factorise

        factorise(self.layout, values)

    def solve(self, values: Floats, right: Floats) -> Floats:
        """Return the solutions for right-hand sides (u, ...); `values` (size,) is the factor."""
        from relmap.core.linalg.cholesky_kernels import solve

        columns = np.ascontiguousarray(right).reshape(self.n_unknowns, -1)
        return np.asarray(solve(self.layout, values, columns).reshape(right.shape))

    def products(self, values: Floats, columns: Floats) -> Floats:
        """Return the products (n, n) of columns (u, n) with the inverse between them.

        `values` (size,): the factor.
        """
        from relmap.core.linalg.cholesky_kernels import forward_substitution

        halves = forward_substitution(self.layout, values, columns)
        return np.asarray(halves.T @ halves)

    def inverse(self, values: Floats) -> Floats:
        """Return the inverse on the factor's pattern (Takahashi, Fagan and Chin, 1973).

        `values` (size,): the factor. Returns (size,).
        """
        from relmap.core.linalg.cholesky_kernels import inverse

        found = np.zeros_like(values)
        inverse(self.layout, values, found)
        return found

    def trace(self, values: Floats, inverse: Floats) -> float:
        """Return the trace of the product of a matrix (size,) and an inverse (size,)."""
        own = self._diagonal
        return float(2 * values @ inverse - values[own] @ inverse[own])

    def parts(self, inverse: Floats, chosen: Ints) -> Floats:
        """Return blocks (k, m, m) of the inverse over coupled unknowns (k, m)."""
        return np.asarray(inverse[self.places(chosen)])

    def add_diagonal(self, values: Floats, unknowns: Ints, value: float | Floats) -> None:
        """Add a value to the diagonal of a matrix (size,), at unknowns (n,)."""
        values[self._diagonal[unknowns]] += value

    def places(self, chosen: Ints) -> Ints:
        """Return the storage positions of entries (k, m, m) of blocks over unknowns (k, m)."""
        start, column_of, row_begin, rows, offset = self.layout
        u, found = self.n_unknowns, np.empty((*chosen.shape, chosen.shape[1]), dtype=np.int64)
        keys = np.repeat(np.arange(len(row_begin) - 1), np.diff(row_begin)) * u + rows
        for k in range(chosen.shape[1]):  # a column at a time, to save memory
            earlier, later = (of(chosen, chosen[:, k, None]) for of in (np.minimum, np.maximum))
            p = column_of[earlier]
            row = np.searchsorted(keys, p * u + later) - row_begin[p]
            found[:, k] = offset[p] + row * (start[p + 1] - start[p]) + earlier - start[p]
        return found


def _minimum_degree(n: int, begin: Ints, cliques: Ints) -> Ints:
    """Return SuperLU's fill-reducing elimination order (n,).

    Its factor does not show which blocks are coupled: entries may underflow to zero.
    """
    member = sparse.csr_array((np.ones(len(cliques)), cliques, begin), (len(begin) - 1, n))
    shared = member.T @ member
    graph = sparse.csc_array(sparse.diags_array(shared.sum(axis=1)) + shared)
    options = {"SymmetricMode": True}
    found = splu(graph, "MMD_AT_PLUS_A", diag_pivot_thresh=0, relax=1, options=options)
    return np.argsort(found.perm_c)
