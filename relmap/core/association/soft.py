"""Registration where the noise is a good fraction of the spacing of the landmarks.

Most single matches are then ambiguous, but a scan of many points still has only one likely
placement.  Each point belongs to any nearby track, with the probability that the noise implies, or
to none; the placement that maximises the likelihood is found by expectation maximisation from many
starts (Granger and Pennec, "Multi-scale EM-ICP", ECCV 2002). On average over random placements the
likelihood ratio to unrelated points is 1, so a placement is accepted if its ratio exceeds the
number of possible placements and no other placement comes near.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.metric import farthest, rows_of, scaled
from relmap.core.association.placement import Placement
from relmap.core.association.search import triangles_of
from relmap.core.association.tracks import sampled

UNEXPLAINED = 0.3
"""Initial fraction of the points of a scan that belong to no track; and its bounds."""
BOUNDS = 0.1, 0.9
SOURCES = 30
"""Maximum number of tracks in the triangles that suggest placements, see `sampled`."""
FURTHEST = 16.0
"""Largest squared distance of a possible match, in variances."""
GATE = 11.0
"""The same for a link."""
COARSE = 4.0
"""Factor of the variance when many starts are compared."""
SHIFTS = 1000
"""Maximum number of shifts compared."""
SUGGESTED = 1000
"""Maximum number of placements by triangles that are compared, those with most matches."""
STARTS = 12
"""Maximum number of starts that are refined, the most likely that differ."""
ROUNDS = 12
"""Maximum number of rounds of expectation maximisation."""
SETTLED = 0.01
"""Change of the log likelihood ratio that ends them."""
LEAST = 0.02
"""Minimum probability of a match that takes part in a fit."""
MOVED = 2.0
"""Mean difference of the points, in standard deviations, that makes two placements distinct."""
CORNERS = 4.0
"""Smallest side of the triangles that suggest placements, in standard deviations."""
SEEN = 0.25
"""Fraction of the points that a suggested placement must explain."""
DOUBT = 2.0
"""A track seen n times exists with probability n / (n + DOUBT)."""


@dataclass(frozen=True, eq=False)
class SoftMatching:
    """Tracks and the points of a scan, matched with the probabilities that the noise implies.

    `source` (n, d), metres: tracks, in the frame of an earlier scan; `variance` (n,), square
    metres: of the difference of a coordinate between a track and an observation of it; `target`
    (m, d), metres: points of the scan; `spacing_m`: median distance of a landmark to its nearest
    neighbour; `metric` (m, d, d): of the points.
    """

    source: Floats
    variance: Floats
    target: Floats
    spacing_m: float
    metric: Floats | None

    @property
    def density(self) -> float:
        """Landmarks per unit of area or volume, if scattered at random."""
        ball = {2: math.pi, 3: 4 / 3 * math.pi}[self.source.shape[1]]
        return math.log(2) / (ball * float(self.spacing_m ** self.source.shape[1]))

    def found(self, R: Floats, t: Floats) -> tuple[Placement, float, float] | None:
        """Return the most likely placement, and the log likelihood ratios of it and of a rival.

        `R` (h, d, d), `t` (h, d): placements to start from.
        """
        from relmap.core.association.soft_kernels import scores

        likely = scores(self._terms(COARSE), self.metric, R, t)
        fitted: list[tuple[Placement, float]] = []
        while len(fitted) < STARTS and np.isfinite(likely).any():
            k = int(likely.argmax())
            fitted.append(self.fitted(R[k], t[k]))
            for known in (Placement(R[k], t[k], 0), fitted[-1][0]):
                likely[~self._differ(R, t, known)] = -np.inf
        if not fitted:
            return None
        best, score = max(fitted, key=lambda one: one[1])
        rivals = [rival for one, rival in fitted if self._differ(one.R, one.t, best)]
        return best, score, max(rivals, default=-np.inf)

    def fitted(self, R: Floats, t: Floats) -> tuple[Placement, float]:
        """Return the most likely placement near one, and its log likelihood ratio."""
        from relmap.core.association.soft_kernels import climb

        R, t = R.copy(), t.copy()
        score, n_agreeing = climb(self._terms(1.0), self.metric, R, t)
        return Placement(R, t, round(n_agreeing)), score

    def misfit(self, placement: Placement) -> float:
        """Return the variance of matches after placement, relative to that assumed."""
        from relmap.core.association.soft_kernels import soft_matches

        share, at = np.empty((len(self.source), len(self.target))), (placement.R, placement.t)
        soft_matches(self._terms(1.0), self.metric, UNEXPLAINED, *at, share)
        i, j = np.nonzero(share > LEAST)
        off = scaled(rows_of(self.metric, j), self.target[j] - placement.apply(self.source)[i])
        d, weight = self.source.shape[1], share[i, j]
        freedoms: float = max(d * float(weight.sum()) - d * (d + 1) / 2, 1.0)
        return float(np.sum(weight * np.sum(off**2, axis=1) / self.variance[i])) / freedoms

    def _terms(self, factor: float) -> tuple[Floats, Floats, Floats, float, Floats]:
        peak = np.ones(len(self.target)) if self.metric is None else np.linalg.det(self.metric)
        return self.source, factor * self.variance, self.target, self.density, peak

    def by_triangles(self) -> tuple[Floats, Floats]:
        """Return the placements R (h, d, d), t (h, d) that triangles suggest."""
        from relmap.core.association.search_kernels import placements_by_triangles

        sigma_m = math.sqrt(float(np.median(self.variance)))
        source = self.source[sampled(len(self.source), SOURCES)]
        triangles = triangles_of(source, CORNERS * sigma_m)
        fewest = max(3, round(SEEN * min(len(source), len(self.target))))
        within, farthest_m = (2 * sigma_m, fewest), farthest(2 * sigma_m, self.metric)
        R, t, matches = placements_by_triangles(
            source, self.target, triangles, *within, self.metric, farthest_m
        )
        best = np.argsort(-np.sum(matches >= 0, axis=1), kind="stable")[:SUGGESTED]
        return R[best], t[best]

    def by_shifts(self, farthest_m: float, start: Placement | None = None) -> tuple[Floats, Floats]:
        """Return a start, as above, and its shifts that bring a source point onto a target.

        `farthest_m`: maximum length of a shift; `start`: by default the identity.
        """
        d = self.source.shape[1]
        start = Placement(np.eye(d), np.zeros(d), 0) if start is None else start
        shifts = (self.target[None] - start.apply(self.source)[:, None]).reshape(-1, d)
        shifts = shifts[np.linalg.norm(shifts, axis=1) <= farthest_m]
        shifts = np.concatenate([np.zeros((1, d)), shifts[:: max(1, -(-len(shifts) // SHIFTS))]])
        R = np.broadcast_to(start.R, (len(shifts), d, d))
        return np.ascontiguousarray(R), start.t + shifts

    def _differ(self, R: Floats, t: Floats, other: Placement) -> Bools:
        """Return whether R (..., d, d) and t (..., d) place source points differently from another.

        The mean square distance in variances, from the moments of the points.
        """
        turn, shift = R - other.R, t - other.t
        total, first, second = self._moments
        square = np.einsum("...ij,jk,...ik->...", turn, second, turn)
        square += 2 * np.einsum("...i,...ij,j->...", shift, turn, first)
        square += total * np.sum(shift**2, axis=-1)
        return np.asarray(square > MOVED**2)

    @cached_property
    def _moments(self) -> tuple[float, Floats, Floats]:
        """Moments of the source points, each weighted by its share of them over its variance."""
        weight = 1 / (len(self.source) * self.variance)
        second = np.einsum("n,ni,nj->ij", weight, self.source, self.source)
        return weight.sum(), weight @ self.source, second


def likely_links(
    expected: Floats, variance: Floats, seen: Ints, points: Floats, metric: Floats | None
) -> tuple[Ints, Ints]:
    """Return the most likely links of predicted tracks and points: rows of each, (k,).

    `expected` (n, d), metres. `variance` (n,), square metres: as in `SoftMatching`. `seen` (n,):
    observations of each track; one with few may not exist. `points` (m, d), metres. `metric`
    (m, d, d): of the points.
    """
    from scipy.optimize import linear_sum_assignment

    n, d = expected.shape
    if not n or not len(points):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    apart = (points[None] - expected[:, None]).reshape(-1, d)
    own = None if metric is None else np.tile(metric, (n, 1, 1))
    square = np.sum(scaled(own, apart) ** 2, axis=1).reshape(n, -1) / variance[:, None]
    exists = seen / (seen + DOUBT)
    own_cost = (d * np.log(variance) - 2 * np.log(exists))[:, None]
    near = square <= GATE
    if not near.any():
        return np.empty(0, np.int64), np.empty(0, np.int64)
    rows, found = linear_sum_assignment(np.where(near, square + own_cost, GATE + own_cost.max()))
    linked = near[rows, found]
    return rows[linked], found[linked]
