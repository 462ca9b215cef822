"""Condensing a segment, compiled; see `relmap.core.refinement.condensing`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import median
from relmap.core.refinement.aligning_kernels import join, mean_of, settle

FAR = 10.0
"""Largest distance of a condensed landmark, relative to the largest observed distance."""
RARE = 100.0
"""Of so many segments without outliers one is aligned robustly."""
OUTLIER, TRIMS = 10.0, 3
"""Deviation of an observation, in medians of its segment, above which it is an outlier; and maximum
number of rounds of outlier rejection."""
EXACT = 1e-9
"""Deviation, as a fraction of the extent, treated as rounding."""


@helper
def _errors(
    deviation: Floats, mean: Floats, counts: Floats, seen: Bools
) -> tuple[Floats, Floats, float]:
    """Return the squared errors of observations (n, k), and those (l,) from which noise is known.

    Of landmarks seen twice or more: the error of one of two observations is twice its deviation
    (n, k, d) from their mean, in squares. Also returns what of a square is rounding.
    """
    n, k, d = deviation.shape
    squares, listed, count, extent = np.zeros((n, k)), np.empty(n * k), 0, 0.0
    for i in range(n):
        square = 0.0
        for a in range(d):
            square += mean[i, a] * mean[i, a]
        extent = max(extent, square)
        for m in range(k):
            if seen[i, m] and counts[i] > 1:
                for a in range(d):
                    squares[i, m] += deviation[i, m, a] ** 2 / (1 - 1 / counts[i])
                listed[count] = squares[i, m]
                count += 1
    return squares, listed[:count], EXACT**2 * extent


@helper
def _is_doubtful(deviation: Floats, mean: Floats, counts: Floats, seen: Bools) -> bool:
    """Return whether the largest deviation (n, k, d) is larger than noise explains."""
    _, listed, rounding = _errors(deviation, mean, counts, seen)
    if len(listed) == 0:
        return False
    # The largest of so many errors in the plane is beyond this once in `RARE` segments.
    limit = max(median(listed) * np.log(RARE * len(listed)) / np.log(2), rounding)
    largest = 0.0
    for square in listed:  # compiling `listed.max()` takes 0.4 s
        largest = max(largest, square)
    return bool(largest > limit)


@helper
def _visible(
    block: Floats, places: Floats, deviation: Floats, seen: Bools, t: Floats
) -> tuple[NDArray[np.uint8], float, int]:
    """Return in which iterations each landmark is seen, as bits (n,), and the sum of squares.

    And how many coordinates are observed beyond the first of each landmark. Wrong matches can leave
    a landmark or an iteration without support: what is placed beyond the largest coordinate of the
    block (n, k, d) times `FAR` is not seen, and t is NaN.
    """
    n, k, d = block.shape
    visible, squares, largest, n_again = np.zeros(n, dtype=np.uint8), 0.0, 0.0, 0
    for i in range(n):
        for m in range(k):
            for a in range(d):
                squares += deviation[i, m, a] ** 2
                # NaN is never larger
                largest = abs(block[i, m, a]) if abs(block[i, m, a]) > largest else largest
    for i in range(n):
        within = True
        for a in range(d):
            within &= abs(places[i, a]) <= FAR * largest
        for m in range(k):
            visible[i] |= (seen[i, m] and within) << m
            n_again += seen[i, m] and within
        n_again -= visible[i] > 0
    for m in range(k):
        within = True
        for a in range(d):
            within &= abs(t[m, a]) <= FAR * largest
        for a in range(d):
            t[m, a] = t[m, a] if within else np.nan
    return visible, squares, d * n_again


@compiled
def align_iterations(block: Floats, free: Bools) -> tuple[Bools, Floats, Floats, Bools, bool]:
    """Align the largest consistent set of the free iterations (k,) of a block (n, k, d).

    Those that show fewer than two landmarks are free no longer. Returns the aligned iterations,
    their poses R (k, d, d) and t (k, d), which observations (n, k) are used, and whether some of
    these may be wrong.
    """
    n, k, _ = block.shape
    seen, n_shown = np.empty((n, k), dtype=np.bool_), np.zeros(k)
    for i in range(n):
        for m in range(k):
            seen[i, m] = free[m] and not np.isnan(block[i, m, 0])
            n_shown[m] += seen[i, m]
    for m in range(k):
        free[m] = n_shown[m] >= 2
    joined, R, t = join(block, seen, free)
    settle(block, seen, joined, R, t)
    places, counts, deviation = mean_of(block, seen, R, t)
    return joined, R, t, seen, _is_doubtful(deviation, places, counts, seen)


@helper
def _trim(deviation: Floats, mean: Floats, counts: Floats, seen: Bools) -> bool:
    """Drop the worst observation of each iteration if it is an outlier; return whether any is.

    Only the worst, because the others may deviate because of it.
    """
    n, k, _ = deviation.shape
    squares, listed, rounding = _errors(deviation, mean, counts, seen)
    if len(listed) == 0:
        return False
    limit, found = max(OUTLIER**2 * median(listed), rounding), False
    for m in range(k):
        worst = 0
        for i in range(n):
            worst = i if squares[i, m] > squares[worst, m] else worst
        if squares[worst, m] > limit:
            seen[worst, m] = False
            found = True
    return found


@compiled
def trim_outliers(block: Floats, seen: Bools, joined: Bools, R: Floats, t: Floats) -> None:
    """Drop outliers among the observations (n, k) one by one, and align the iterations again."""
    for _ in range(TRIMS):
        places, counts, deviation = mean_of(block, seen, R, t)
        if not _trim(deviation, places, counts, seen):
            break
        settle(block, seen, joined, R, t)


@compiled
def condensed(
    block: Floats, joined: Bools, R: Floats, t: Floats, seen: Bools
) -> tuple[Floats, NDArray[np.uint8], float, int]:
    """Return the positions (n, d) of the landmarks of aligned iterations; see `align_iterations`.

    And what `_visible` does, with the degrees of freedom. It may set t to NaN.
    """
    k, d = t.shape
    places, _, deviation = mean_of(block, seen, R, t)
    visible, squares, freedoms = _visible(block, places, deviation, seen, t)
    freedoms += 3 * d - 3
    for m in range(k):
        freedoms -= (3 * d - 3) * joined[m]
    return places, visible, squares, freedoms
