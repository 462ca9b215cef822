"""Sparse symmetric systems that are sums of cliques: sets of unknowns all tied to one another.

What one scan says of walls is such a clique.  Walls with their corners are blocks that stand
together, so the factor is stored and worked on in small dense panels.  The order of elimination and
the pattern of the factor depend on the cliques alone and are found once, however often the numbers
change (T. A. Davis, "Direct Methods for Sparse Linear Systems", 2006).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class CliquePattern:
    """In which order to eliminate, and where the factor has its entries.

    Parameters
    ----------
    width : (b,) int64
        Unknowns of each block; at least 1.
    begin : (g + 1,) int64
    cliques : (begin[-1],) int64
        The blocks of each clique, one clique after another, no block twice in one.

    Attributes
    ----------
    first : (b,) int64
        Number of each block's first unknown; the others follow.
    size : int
        Entries of the factor.
    """

    def __init__(
        self, width: NDArray[np.int64], begin: NDArray[np.int64], cliques: NDArray[np.int64]
    ) -> None:
        from relmap.planes.cholesky_kernels import panels
        from relmap.planes.elimination_kernels import minimum_degree

        order, tied_begin, tied = minimum_degree(width, begin, cliques)
        self.first, self._layout = panels(width, order, tied_begin, tied)
        self.size = int(self._layout[-1][-1])
        every = np.arange(self._layout[0][-1])
        self._diagonal = self.entries(np.append(every, len(every)), every)

    def entries(self, begin: NDArray[np.int64], unknowns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return where the lower triangles of dense parts are, row after row, part after part.

        Parameters
        ----------
        begin : (g + 1,) int64
        unknowns : (begin[-1],) int64
            The unknowns of each part, ascending; all in one clique.
        """
        from relmap.planes.cholesky_kernels import entries

        return entries(self._layout, begin, unknowns)

    def hold(self, values: NDArray[np.float64], share: float, least: float) -> None:
        """Hold every unknown where it is a little: a share of what holds it, and at least so much.

        `values` (size,) is the matrix.
        """
        values[self._diagonal] *= 1 + share
        values[self._diagonal] += least

    def solve(self, values: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the solution (u,) for a right side (u,).

        `values` (size,) is the matrix, positive definite, its lower triangle where `entries` tells;
        overwritten by its Cholesky factor.  An unknown of which rounding leaves nothing stays.
        """
        from relmap.planes.cholesky_kernels import factorise, solve

        factorise(self._layout, values)
        return solve(self._layout, values, right)

    def inverse(
        self, values: NDArray[np.float64], chosen: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return blocks (k, m, m) of the inverse: those of chosen unknowns (k, m).

        `values` (size,) is the matrix, as for `solve`; overwritten by its factor.
        """
        from relmap.planes.cholesky_kernels import factorise, solve

        factorise(self._layout, values)
        unknowns, at = np.unique(chosen, return_inverse=True)
        row, place = np.divmod(np.argsort(at.ravel(), kind="stable"), chosen.shape[1])
        end = np.cumsum(np.bincount(at.ravel()))
        blocks, unit = np.empty((*chosen.shape, chosen.shape[1])), np.zeros(len(self._diagonal))
        for k, unknown in enumerate(unknowns.tolist()):
            unit[unknown] = 1.0
            column = solve(self._layout, values, unit)
            unit[unknown] = 0.0
            own = slice(end[k - 1] if k else 0, end[k])
            blocks[row[own], :, place[own]] = column[chosen[row[own]]]
        return blocks
