"""Normal equations with some unknowns eliminated, for any kind of landmark.

Each residual depends on one body that is eliminated and on a few unknowns that are kept (Schur
complement; Triggs et al., "Bundle adjustment - a modern synthesis", 2000).  The bodies are poses,
or points if so many are seen at once that eliminating the poses is more expensive. Bodies that
share most unknowns, such as consecutive poses, form a stretch: their contributions are summed in a
dense block before they are added to the sparse matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.cholesky import Pattern

if TYPE_CHECKING:
    from relmap.core.refinement.schur_kernels import Bodies, Rows


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The normal equations of a Gauss-Newton step.

    `right` (u,): right-hand side, in elimination order. `matrix` (size,): stored as described by
    the pattern; empty if not requested. `cost`: weighted sum of squares at the optimum of the
    eliminated bodies. `eliminated_steps`: maps a step (u,) to the steps of the bodies (p, q).
    """

    right: Floats
    matrix: Floats
    cost: float
    eliminated_steps: Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals at a state, and their Jacobians.

    `off` (r,); `by_eliminated` (r, q): Jacobian by a step of the body; for a pose, rotation and
    translation. `by_kept` (r, k).
    """

    off: Floats
    by_eliminated: Floats
    by_kept: Floats


class Elimination:
    """The residuals of each body, and the positions of the equations in the matrix.

    `kept` (r, k): the kept unknowns of each residual, numbered in elimination order. `begin`
    (p + 1,), `seen` (begin[-1],): the residuals of each body, concatenated. `stretch` (p,),
    ascending: bodies of one stretch share no residuals with those of others. `times` (p,): number
    of bodies with the same observations that each represents; default 1. `free`, `free_in_matrix`
    (p,): how many of these are free; default all. A body that is fixed only to define the frame may
    be free in the right-hand side.
    """

    def __init__(
        self,
        pattern: Pattern,
        kept: Ints,
        begin: Ints,
        seen: Ints,
        stretch: Ints,
        times: Floats | None = None,
        free: Floats | None = None,
        free_in_matrix: Floats | None = None,
    ) -> None:
        self._pattern, self._kept = pattern, kept
        times = np.ones(len(stretch)) if times is None else times
        free = times if free is None else free
        free_in_matrix = free if free_in_matrix is None else free_in_matrix
        self._bodies = begin, seen, times, free, free_in_matrix
        first = np.append(np.flatnonzero(np.diff(stretch, prepend=-1)), len(stretch))
        u, of = pattern.n_unknowns, np.repeat(np.arange(len(first) - 1), np.diff(begin[first]))
        width = kept.shape[1]
        k = width if _are_blocks(kept) else 1  # of blocks, only the first one is sorted
        found, number = np.unique(of[:, None] * u + kept[seen, ::k], return_inverse=True)
        found = (found[:, None] + np.arange(k)).ravel()
        number = k * number.reshape(-1, width // k, 1) + np.arange(k)
        starts = np.searchsorted(found, np.arange(len(first)) * u)
        self._number = np.zeros_like(kept)
        self._number[seen] = number.reshape(-1, width) - starts[of][:, None]
        self._stretches = first, starts, found % u

    def equations(
        self,
        linear: Linearised,
        weight: Floats,
        hold: float,
        with_matrix: bool,
        along: Floats | None = None,
    ) -> NormalEquations:
        """Return the normal equations of the kept unknowns.

        `weight` (r,); `hold`: damping of poorly determined bodies, as a fraction of the diagonal.
        `along` (p, h, q): directions in which a body is unobservable, or 0; none if omitted.
        """
        from relmap.core.refinement.schur_kernels import eliminated_steps, reduced_equations

        rows, bodies = self._seen(linear, weight, along)
        matrix = np.zeros(self._pattern.size if with_matrix else 0)
        right, layout = np.zeros(self._pattern.n_unknowns), self._pattern.layout
        cost, roots = reduced_equations(rows, bodies, self._stretches, hold, layout, matrix, right)

        def steps(step: Floats) -> Floats:
            return eliminated_steps(rows, bodies, self._kept, step, roots)

        return NormalEquations(right, matrix, cost, steps)

    def covariances(
        self, linear: Linearised, weight: Floats, hold: float, inverse: Floats
    ) -> Floats:
        """Return the covariances (p, q, q) of the bodies, from those of the kept unknowns."""
        from relmap.core.refinement.schur_kernels import eliminated_covariances

        rows, bodies = self._seen(linear, weight, None)
        layout = self._pattern.layout
        return eliminated_covariances(rows, bodies, self._stretches, hold, layout, inverse)

    def _seen(
        self, linear: Linearised, weight: Floats, along: Floats | None
    ) -> tuple[Rows, Bodies]:
        """Return rows and bodies in the form used by the kernels."""
        none = np.zeros((len(self._bodies[2]), 0, linear.by_eliminated.shape[1]))
        rows = linear.off, linear.by_eliminated, linear.by_kept, weight, self._number
        return rows, (*self._bodies, none if along is None else along)


def _are_blocks(kept: Ints) -> bool:
    """Return whether the kept unknowns (r, k) of each residual are a block, and none overlap."""
    k = kept.shape[1]
    if not len(kept) or not (kept == kept[:, :1] + np.arange(k)).all():
        return False
    begins = np.zeros(kept.max() + 1, dtype=bool)
    begins[kept[:, 0]] = True
    return bool((np.diff(np.flatnonzero(begins)) >= k).all())
