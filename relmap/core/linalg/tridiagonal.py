"""Sparse symmetric systems whose unknowns stand in levels that touch only their neighbours.

Breadth-first search from an outer node orders any graph so (the levels of Cuthill and McKee, 1969):
a map along a path has many narrow levels.  The blocks are dense, which suits the machine; the cost
is that of the cubes of the levels' widths.  The inverse is had within the blocks alone (Takahashi,
Fagan and Chin, 1973), which is where the covariances are.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotri

Result = TypeVar("Result")

BARELY = 1e-13
"""What keeps rounding from making a matrix indefinite, as a share of its entries."""
STIFF = 1e9
"""What holds an unknown that is not free, as a multiple of what holds others."""
HOLDS = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4)
"""What is added where a matrix is not positive definite, as a share of its largest entry."""


class Levels:
    """Where the unknowns of each node stand: q of them per node, level by level.

    Parameters
    ----------
    level : (n,) int64
        Of each node, from 0, none left out; neighbours are at most one level apart.
    q : int
        Unknowns per node.
    """

    def __init__(self, level: NDArray[np.int64], q: int) -> None:
        self.level = level
        self.q = q
        counts = np.bincount(level)
        self.widths = q * counts
        order = np.argsort(level, kind="stable")
        begin = np.cumsum(counts) - counts
        place = np.empty(len(level), dtype=np.int64)
        place[order] = np.arange(len(level)) - begin[level[order]]
        self.place = q * place
        """Place of each node's first unknown in its level; (n,)."""
        below = np.append(self.widths[1:], 0)
        sizes = np.column_stack([self.widths**2, self.widths * below])
        ends = np.cumsum(sizes.ravel()).reshape(-1, 2)
        self.offsets = ends - sizes
        """Where each level's diagonal block, and the one below it, begin in a buffer; (l, 2)."""
        self.size = int(ends[-1, -1])

    @property
    def most_flops(self) -> float:
        """About how many operations a single level takes."""
        w = self.widths.astype(np.float64)
        below = np.append(w[1:], 0)
        return float(np.max(w**3 / 3 + w**2 * below + w * below**2))

    @property
    def flops(self) -> float:
        """About how many operations a factorisation takes."""
        w = self.widths.astype(np.float64)
        below = np.append(w[1:], 0)
        return float(np.sum(w**3 / 3 + w**2 * below + w * below**2))

    def blocks(
        self, buffer: NDArray[np.float64]
    ) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Return each level's diagonal block and the one below it, as views of a buffer."""
        found = []
        below = np.append(self.widths[1:], 0)
        for (a, b), w, v in zip(self.offsets, self.widths, below, strict=True):
            diagonal = buffer[a : a + w * w].reshape(w, w)
            found.append((diagonal, buffer[b : b + v * w].reshape(v, w)))
        return found

    @property
    def layout(
        self,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Level and place of each node; width and offsets of each level."""
        return self.level, self.place, self.widths, self.offsets

    def diagonal(self, buffer: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the blocks (n, q, q) of the nodes themselves."""
        width = self.widths[self.level]
        start = self.offsets[self.level, 0] + self.place * (width + 1)
        row, column = np.mgrid[: self.q, : self.q]
        return np.asarray(buffer[start[:, None, None] + row * width[:, None, None] + column])

    def hold(self, buffer: NDArray[np.float64], share: float, least: float = 0.0) -> None:
        """Give unknowns that hang by too little, or by nothing, a little hold where they are.

        It damps a step, and belongs in no covariance but for `BARELY`: many weak holds along a
        chain add up to a strong one.

        Parameters
        ----------
        buffer : (size,) float64
        share : float
            Of what holds others.
        least : float
            In weights of an observation.
        """
        diagonals = [np.einsum("ii->i", diagonal) for diagonal, _ in self.blocks(buffer)]
        largest = max(float(diagonal.max()) for diagonal in diagonals)
        for diagonal in diagonals:
            diagonal += share * (np.abs(diagonal) + largest) + least

    def damp(self, buffer: NDArray[np.float64], share: float) -> None:
        """Add a share of itself to the diagonal."""
        for diagonal, _ in self.blocks(buffer) if share else ():
            np.einsum("ii->i", diagonal)[:] *= 1 + share

    def fix(self, buffer: NDArray[np.float64], node: int) -> None:
        """Let a node's unknowns stay where they are."""
        diagonal = np.einsum("ii->i", self.blocks(buffer)[self.level[node]][0])
        own = slice(self.place[node], self.place[node] + self.q)
        diagonal[own] += STIFF * max(float(diagonal.max()), 1.0)

    def split(self, values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return values (n, q) level by level."""
        order = np.argsort(self.level, kind="stable")
        return np.split(values[order].ravel(), np.cumsum(self.widths)[:-1])

    def joined(self, parts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return values (n, q) from what `split` gave."""
        values = np.empty((len(self.level), self.q))
        values[np.argsort(self.level, kind="stable")] = np.concatenate(parts).reshape(-1, self.q)
        return values


class Factor:
    """Cholesky factor of a symmetric positive definite matrix in levels; see `factor`.

    Parameters
    ----------
    levels : Levels
    lower : list of (w, w) float64
        Of each level.
    below : list of (v, w) float64
        Between each level and the next.
    """

    def __init__(
        self, levels: Levels, lower: list[NDArray[np.float64]], below: list[NDArray[np.float64]]
    ) -> None:
        self.levels = levels
        self._lower = lower
        self._below = below

    def solve(self, right: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the solution (n, q) for a right side (n, q)."""
        parts = self.levels.split(right)
        carried: NDArray[np.float64] | float = 0.0
        for k, (L, below) in enumerate(zip(self._lower, self._below, strict=True)):
            parts[k] = solve_triangular(L, parts[k] - carried, lower=True, check_finite=False)
            carried = below @ parts[k]
        later = np.empty(0)
        for k in reversed(range(len(parts))):
            right_k = parts[k] - self._below[k].T @ later
            later = parts[k] = solve_triangular(
                self._lower[k], right_k, lower=True, trans=1, check_finite=False
            )
        return self.levels.joined(parts)

    def inverse(self) -> NDArray[np.float64]:
        """Return the inverse within the blocks, as a buffer; diagonal blocks are whole."""
        buffer = np.empty(self.levels.size)
        blocks = self.levels.blocks(buffer)
        later = np.empty((0, 0))
        for k in reversed(range(len(blocks))):
            diagonal, below = blocks[k]
            L = self._lower[k]
            pull = solve_triangular(L, self._below[k].T, lower=True, trans=1, check_finite=False)
            below[:] = -later @ pull.T
            own = np.tril(dpotri(L, lower=1)[0])
            diagonal[:] = own + np.tril(own, -1).T - pull @ below
            later = diagonal
        return buffer


def _root(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lower Cholesky factor (w, w); what rounding leaves without hold gets a little."""
    largest = max(float(np.diag(matrix).max()), 1.0)
    for hold in HOLDS:
        held = matrix + hold * largest * np.eye(len(matrix)) if hold else matrix
        try:
            return np.asarray(cholesky(held, lower=True, check_finite=False))
        except LinAlgError:
            if hold == HOLDS[-1]:
                raise
    raise AssertionError


def factored(levels: Levels, buffer: NDArray[np.float64]) -> Generator[None, None, Factor]:
    """Factor a matrix level by level, with a pause after each; return the factor.

    Parameters
    ----------
    levels : Levels
    buffer : (levels.size,) float64
        The matrix, of whose diagonal blocks the lower triangles are read; overwritten.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where it is not positive definite.
    """
    lower: list[NDArray[np.float64]] = []
    between: list[NDArray[np.float64]] = []
    for diagonal, below in levels.blocks(buffer):
        if between:
            diagonal -= between[-1] @ between[-1].T
        L = _root(diagonal)
        lower.append(L)
        between.append(solve_triangular(L, below.T, lower=True, check_finite=False).T)
        yield
    return Factor(levels, lower, between)


def factor(levels: Levels, buffer: NDArray[np.float64]) -> Factor:
    """Factor a matrix at once; see `factored`."""
    return at_once(factored(levels, buffer))


def at_once(steps: Generator[None, None, Result]) -> Result:
    """Run through all steps of a computation; return its result."""
    while True:
        try:
            next(steps)
        except StopIteration as done:
            found: Result = done.value
            return found
