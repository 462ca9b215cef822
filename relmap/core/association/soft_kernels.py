"""Likelihood of placements, compiled; see `soft`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.association.soft import BOUNDS, FURTHEST, LEAST, ROUNDS, SETTLED, UNEXPLAINED
from relmap.core.geometry.fitting_kernels import placed_at
from relmap.core.geometry.weighted_kernels import weighted_step
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import square_between

Terms = tuple[Floats, Floats, Floats, float, Floats]
"""Source, variance, target, density and peak, see `soft_matches`."""


@compiled
def soft_matches(
    terms: Terms, metric: Floats | None, unexplained: float, R: Floats, t: Floats, share: Floats
) -> float:
    """Write the probability that each target (m, d) belongs to each placed source point (n, d).

    `terms`: ``source`` (n, d), metres; ``variance`` (n,), square metres, of the difference of a
    coordinate between a source point and the target of the same object; ``target`` (m, d), metres;
    ``density`` of targets of other objects per unit of area or volume; ``peak`` (m,): determinants
    of the metric, 1 without one. `metric` (m, d, d): of the targets. `unexplained`: fraction of the
    targets that belong to other objects. `share` (n, m): overwritten with the probabilities.
    Returns the log likelihood ratio, relative to targets that all belong to other objects.
    """
    source, variance, target, density, peak = terms
    (n, d), m = source.shape, len(target)
    placed, apart, score = placed_at(source, R, t), np.empty(d), 0.0
    for j in range(m):
        total = 0.0
        for i in range(n):
            share[i, j] = 0.0
            square = square_between(target[j], placed[i], metric, j, apart) / variance[i]
            if square < FURTHEST:
                share[i, j] = np.exp(-square / 2) / (2 * np.pi * variance[i]) ** (d / 2) * peak[j]
                total += share[i, j]
        total *= 1 - unexplained
        score += np.log(unexplained + total / density)
        for i in range(n):
            share[i, j] *= (1 - unexplained) / (total + unexplained * density)
    return score


@compiled
def scores(terms: Terms, metric: Floats | None, R: Floats, t: Floats) -> Floats:
    """Return the log likelihood ratios (h,) of placements R (h, d, d) and t (h, d)."""
    share, found = np.empty((len(terms[0]), len(terms[2]))), np.empty(len(R))
    for h in range(len(R)):
        found[h] = soft_matches(terms, metric, UNEXPLAINED, R[h], t[h], share)
    return found


@helper
def _step(
    terms: Terms, metric: Floats | None, share: Floats, likely: Bools, R: Floats, t: Floats
) -> None:
    """Improve a placement by the likely matches (n, m), weighted by their probabilities."""
    source, variance, target, _, _ = terms
    (n, m), d, k = share.shape, len(t), 0
    n_likely = likely.sum()
    here, there = np.empty((n_likely, d)), np.empty((n_likely, d))
    weighed, rows = np.zeros((n_likely, d, d)), np.ones(n_likely, dtype=np.bool_)
    for i in range(n):
        for j in range(m):
            if not likely[i, j]:
                continue
            weight = np.sqrt(share[i, j] / variance[i])
            for a in range(d):
                here[k, a], there[k, a] = source[i, a], target[j, a]
                for c in range(d):
                    unit = (1.0 if a == c else 0.0) if metric is None else metric[j, a, c]
                    weighed[k, a, c] = weight * unit
            k += 1
    weighted_step(here, there, weighed, rows, R, t)


@compiled
def climb(terms: Terms, metric: Floats | None, R: Floats, t: Floats) -> tuple[float, float]:
    """Move a placement R (d, d), t (d,), in place, to the most likely one nearby.

    By expectation maximisation; the arguments are those of `soft_matches`.  Returns the log
    likelihood ratio and the expected number of matches.
    """
    n_targets, unexplained, score = len(terms[2]), UNEXPLAINED, -np.inf
    share = np.empty((len(terms[0]), n_targets))
    for k in range(ROUNDS + 1):
        last, score = score, soft_matches(terms, metric, unexplained, R, t, share)
        unexplained = min(max(1 - share.sum() / n_targets, BOUNDS[0]), BOUNDS[1])
        likely = share > LEAST
        if k == ROUNDS or score - last < SETTLED or likely.sum() < len(t):
            break
        _step(terms, metric, share, likely, R, t)
    return score, share.sum()
