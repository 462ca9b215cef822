"""Sparse Cholesky, panel by panel; see `relmap.core.linalg.cholesky`.

Unknowns are numbered in elimination order. The factor is stored in panels of consecutive unknowns,
``start[p]`` to ``start[p + 1]``: columns (h, k), row-major, over the rows
``rows[row_begin[p]:row_begin[p + 1]]``, which start with the panel's own. `column_of` is the panel
of each unknown.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import unset

Layout = tuple[Ints, Ints, Ints, Ints, Ints]
"""start (p + 1,), column_of (u,), row_begin (p + 1,), rows, and offset (p + 1,) of each panel."""
MUCH = 2000
"""Number of multiplications above which BLAS is faster than a loop."""
ROUNDING = 1e-14
"""A pivot that is a smaller fraction of its diagonal entry is rounding: its unknown is fixed."""


@helper
def _panel(layout: Layout, values: Floats, p: int) -> Floats:
    """Return the columns (h, k) of panel p, a view."""
    start, offset = layout[0], layout[4]
    return values[offset[p] : offset[p + 1]].reshape(-1, start[p + 1] - start[p])


@helper
def _place(layout: Layout, p: int, place: Ints) -> None:
    """Write into `place` (u,) which row of panel p each of its unknowns is."""
    row_begin, rows = layout[2], layout[3]
    for r in range(row_begin[p], row_begin[p + 1]):
        place[rows[r]] = r - row_begin[p]


@compiled
def add_part(layout: Layout, unknowns: Ints, part: Floats, values: Floats, place: Ints) -> None:
    """Add the lower triangle of a dense part over unknowns (n,), ascending, to a matrix.

    `place` (u,) is work space.
    """
    start, column_of, _, _, offset = layout
    first, n = 0, len(unknowns)
    while first < n:
        p, end = column_of[unknowns[first]], first + 1
        while end < n and column_of[unknowns[end]] == p:
            end += 1
        _place(layout, p, place)
        for a in range(first, n):
            row = offset[p] + place[unknowns[a]] * (start[p + 1] - start[p]) - start[p]
            for b in range(first, min(a + 1, end)):
                values[row + unknowns[b]] += part[a, b]
        first = end


@compiled
def take_part(layout: Layout, unknowns: Ints, values: Floats, part: Floats, place: Ints) -> None:
    """Copy the symmetric part (n, n) over unknowns (n,), ascending, of a matrix.

    `place` (u,) is work space.
    """
    start, column_of, _, _, offset = layout
    last = -1
    for b in range(len(unknowns)):
        p = column_of[unknowns[b]]
        if p != last:
            _place(layout, p, place)
            last = p
        column, width = offset[p] + unknowns[b] - start[p], start[p + 1] - start[p]
        for a in range(b, len(unknowns)):
            part[a, b] = part[b, a] = values[column + place[unknowns[a]] * width]


@helper
def _times_transposed(A: Floats, B: Floats, C: Floats) -> None:
    """Compute ``C = A @ B.T``; only the lower triangle is needed."""
    if A.size * len(B) > MUCH:
        np.dot(A, B.T, C)
        return
    for i in range(len(A)):
        for j in range(min(i + 1, len(B))):
            entry = 0.0
            for k in range(A.shape[1]):
                entry += A[i, k] * B[j, k]
            C[i, j] = entry


@helper
def _take_away(
    layout: Layout, values: Floats, p: int, s: int, done: int, place: Ints, work: Floats
) -> int:
    """Subtract panel s, from row `done` on, from panel p; return how many of its rows are in p."""
    start, _, row_begin, rows, _ = layout
    own, first = rows[row_begin[s] + done : row_begin[s + 1]], start[p]
    panel, target = _panel(layout, values, s)[done:], _panel(layout, values, p)
    shared = 0
    while shared < len(own) and own[shared] < start[p + 1]:
        shared += 1
    left = work[: len(own) * shared].reshape(len(own), shared)
    _times_transposed(panel, panel[:shared], left)
    for r in range(len(own)):
        row = target[place[own[r]]]
        for c in range(min(r + 1, shared)):
            row[own[c] - first] -= left[r, c]
    return shared


@helper
def _add_multiple(values: Floats, factor: float, others: Floats) -> None:
    for r in range(len(values)):
        values[r] += factor * others[r]


@helper
def _factorise_panel(panel: Floats, least: Floats) -> None:
    """Replace a panel's columns by those of the factor (h, k); see `ROUNDING`."""
    k = panel.shape[1]
    upper = np.zeros((k, k))
    for c in range(k):
        for r in range(c, k):
            upper[c, r] = panel[r, c]
        for b in range(c):
            _add_multiple(upper[c, c:], -upper[b, c], upper[b, c:])
        root = np.sqrt(upper[c, c] if upper[c, c] > least[c] else 1e300)
        for r in range(c, k):
            upper[c, r] = upper[c, r] / root if r > c else root
            panel[r, c] = upper[c, r]
    for r in range(k, len(panel)):
        row = panel[r]
        for c in range(k):
            row[c] /= upper[c, c]
            _add_multiple(row[c + 1 :], -row[c], upper[c, c + 1 :])


@compiled
def factorise(layout: Layout, values: Floats) -> None:
    """Replace the columns of the matrix by those of its Cholesky factor.

    Each panel is updated by the earlier ones (left-looking; Ng and Peyton, 1993).
    """
    start, column_of, row_begin, rows, _ = layout
    n, highest, widest = len(start) - 1, 0, 0
    place = np.empty(len(column_of), dtype=np.int64)
    head, following, done = unset(n), unset(n), np.zeros(n, dtype=np.int64)
    for p in range(n):
        highest = max(highest, row_begin[p + 1] - row_begin[p])
        widest = max(widest, start[p + 1] - start[p])
    work = np.empty(highest * widest)
    for p in range(n):
        width, height = start[p + 1] - start[p], row_begin[p + 1] - row_begin[p]
        _place(layout, p, place)
        panel = _panel(layout, values, p)
        least = np.empty(width)
        for c in range(width):
            least[c] = ROUNDING * panel[c, c]
        s = head[p]
        while s >= 0:
            after = following[s]
            done[s] += _take_away(layout, values, p, s, done[s], place, work)
            if row_begin[s] + done[s] < row_begin[s + 1]:
                q = column_of[rows[row_begin[s] + done[s]]]
                following[s], head[q] = head[q], s
            s = after
        _factorise_panel(panel, least)
        done[p] = width
        if width < height:
            q = column_of[rows[row_begin[p] + width]]
            following[p], head[q] = head[q], p


@compiled
def forward_substitution(layout: Layout, values: Floats, right: Floats) -> Floats:
    """Return the solutions (u, m) of the system of the factor, without its transpose.

    `right` (u, m). Only panels on the paths of its nonzero entries to the root of the elimination
    tree are read.
    """
    start, _, row_begin, rows, _ = layout
    x = right.copy()
    for p in range(len(start) - 1):
        own, k = rows[row_begin[p] : row_begin[p + 1]], start[p + 1] - start[p]
        known, is_reached = x[start[p] : start[p + 1]], False
        for c in range(k):
            for j in range(x.shape[1]):
                is_reached |= known[c, j] != 0.0
        if not is_reached:
            continue
        panel = _panel(layout, values, p)
        for r in range(len(own)):
            for c in range(min(r, k)):
                _add_multiple(x[own[r]], -panel[r, c], known[c])
            if r < k:
                for j in range(x.shape[1]):
                    known[r, j] /= panel[r, r]
    return x


@compiled
def solve(layout: Layout, values: Floats, right: Floats) -> Floats:
    """Return the solutions (u, m) for right-hand sides (u, m), given the factor."""
    start, _, row_begin, rows, _ = layout
    x, n = forward_substitution(layout, values, right), len(start) - 1
    for p in range(n - 1, -1, -1):
        own, k = rows[row_begin[p] : row_begin[p + 1]], start[p + 1] - start[p]
        panel = _panel(layout, values, p)
        wanted = x[start[p] : start[p + 1]]
        for r in range(k, len(own)):
            for c in range(k):
                _add_multiple(wanted[c], -panel[r, c], x[own[r]])
        for c in range(k - 1, -1, -1):
            for j in range(x.shape[1]):
                wanted[c, j] /= panel[c, c]
            for b in range(c):
                _add_multiple(wanted[b], -panel[c, b], wanted[c])
    return x


@helper
def _inverse_of_triangle(panel: Floats, root: Floats) -> None:
    """Write the inverse (k, k) of the lower triangle of a panel (h, k) into `root`, zeros."""
    for c in range(len(root)):
        root[c, c] = 1.0 / panel[c, c]
        for r in range(c + 1, len(root)):
            for b in range(c, r):
                root[r, c] -= panel[r, b] * root[b, c]
            root[r, c] /= panel[r, r]


@compiled
def inverse(layout: Layout, values: Floats, found: Floats) -> None:
    """Write the inverse on the pattern into `found`, given the factor; see `Pattern.inverse`."""
    start, _, row_begin, rows, _ = layout
    place = np.empty(start[-1], dtype=np.int64)
    for p in range(len(start) - 2, -1, -1):
        panel, target = _panel(layout, values, p), _panel(layout, found, p)
        k, n = panel.shape[1], len(panel) - panel.shape[1]
        root, pull, part = np.zeros((k, k)), np.zeros((n, k)), np.empty((n, n))
        _inverse_of_triangle(panel, root)
        for r in range(n):
            for b in range(k):
                _add_multiple(pull[r, : b + 1], -panel[k + r, b], root[b])
        take_part(layout, rows[row_begin[p] + k : row_begin[p + 1]], found, part, place)
        np.dot(part, pull, target[k:])
        for a in range(k):
            for e in range(a, k):
                _add_multiple(target[a], root[e, a], root[e])
            for r in range(n):
                _add_multiple(target[a], pull[r, a], target[k + r])


@compiled
def add_products(
    jacobian: Floats, off: Floats, weight: Floats, places: Ints, values: Floats, pull: Floats
) -> None:
    """Add the products of Jacobians (n, r, q), with weights (n,), to a matrix.

    `off` (n, r): residuals; `places` (n, q, q): where the products are stored in the matrix; none
    are added if it is empty; `pull` (n, q): set to the products with the residuals.
    """
    n, r, q = jacobian.shape
    for k in range(n):
        for i in range(q):
            pull[k, i] = 0.0
            for a in range(r):
                pull[k, i] += weight[k] * jacobian[k, a, i] * off[k, a]
            if len(values):
                for j in range(i + 1):
                    product = 0.0
                    for a in range(r):
                        product += jacobian[k, a, i] * jacobian[k, a, j]
                    values[places[k, i, j]] += weight[k] * product
