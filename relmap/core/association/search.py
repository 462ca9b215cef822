"""Registration of two scans without an initial guess, and its significance.

Triangles of one scan are looked up among those of the other by their side lengths; each hit gives a
candidate placement. The one with the most matches is accepted if so many are unlikely by chance (a
contrario: Desolneux, Moisan and Morel, 2000) and no other placement comes near.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.metric import farthest, rows_of
from relmap.core.association.placement import Placement, trimmed_fit

TRIANGLES = 120
"""Maximum number of triangles looked up."""
MOST = 3000
"""Maximum number of triangle matches tried."""
ROUNDS = 4
"""Maximum number of refits of a placement to its matches."""
RIVALS = 4
"""Rivals that are refitted before they are counted."""
APART = 10.0
"""Distance, in tolerances, of most points after two placements that are different motions."""
PATCH, CENTRES, NEIGHBOURS = 24, 2, 4
"""Points whose pattern may repeat, those amid them, and the neighbours of each of these whose
distance may be the period."""
REPEATED = 0.4
"""Fraction of the points, and at least two, that such a shift brings onto others."""


def log_chance(n: int, n_agreeing: int, share: float, log_placements: float) -> float:
    """Return the log of the expected number of placements with as many matches by chance.

    `share`: probability that a point coincides with another in a wrong placement; `log_placements`:
    log of the number of distinguishable placements.
    """
    ways = math.lgamma(n + 1) - math.lgamma(n_agreeing + 1) - math.lgamma(n - n_agreeing + 1)
    return log_placements + ways + n_agreeing * math.log(max(share, 1e-12))


def search(
    source: Floats,
    target: Floats,
    tolerance_m: float,
    fewest: int,
    metric: Floats | None = None,
    reach_m: float = np.inf,
) -> tuple[Placement, int] | None:
    """Return the placement with the most matches, and the number of matches of the best rival.

    `source` (n, d), `target` (m, d), metres. `tolerance_m`: largest distance between the points of
    a match. `fewest`: minimum number of matches. `metric` (m, d, d): of the targets; the tolerance
    is in its units. `reach_m`: placements that move a point farther are left out. Returns `rival`:
    matches of the best other placement, and of one that moves the points nearly alike only those
    that this one assigns differently. None if no placement is found.
    """
    from relmap.core.association.search_kernels import placements_by_triangles

    triangles = triangles_of(source, 2 * tolerance_m)
    if not len(triangles) or min(len(source), len(target)) < fewest:
        return None
    reach = 1.5 * tolerance_m
    R, t, matches = placements_by_triangles(
        source, target, triangles, reach, fewest, metric, farthest(reach, metric)
    )
    if np.isfinite(reach_m) and len(R):
        moved = np.einsum("hij,nj->hni", R, source) + t[:, None] - source
        near = np.linalg.norm(moved, axis=2).max(axis=1) <= reach_m
        R, t, matches = R[near], t[near], matches[near]
    if not len(R):
        return None
    most = np.argsort(-np.sum(matches >= 0, axis=1), kind="stable")[:RIVALS]
    each = [settled(source, target, Placement(R[k], t[k], 0), tolerance_m, metric) for k in most]
    best = max(filter(None, each), key=lambda placed: placed.n_agreeing, default=None)
    if best is None or best.n_agreeing < fewest:
        return None
    match = matches_of(source, target, best, 1.5 * tolerance_m, metric)
    others = np.sum((matches >= 0) & (matches != match), axis=1)
    rival = 0
    for row in np.argsort(-others, kind="stable")[:RIVALS]:
        placed = settled(source, target, Placement(R[row], t[row], 0), tolerance_m, metric)
        if placed is not None and others[row]:
            other = matches_of(source, target, placed, tolerance_m, metric)
            apart_m = np.linalg.norm(placed.apply(source) - best.apply(source), axis=1)
            # The other way round, points on the axis of a pattern match as before.
            is_other = np.median(apart_m) > APART * tolerance_m
            rival = max(rival, int(np.sum((other >= 0) & (is_other | (other != match)))))
    return best, rival


def settled(
    source: Floats,
    target: Floats,
    placement: Placement,
    tolerance_m: float,
    metric: Floats | None = None,
) -> Placement | None:
    """Fit a placement of points (n, d) to all that it brings onto others (m, d).

    `source` (n, d), `target` (m, d), metres. `placement`: where to start. `tolerance_m`: largest
    distance between the points of a match. `metric` (m, d, d): of the targets; the tolerance is in
    its units. Returns None if there are too few matches.
    """
    n_agreeing = 0
    for _ in range(ROUNDS):
        match = matches_of(source, target, placement, 1.5 * tolerance_m, metric)
        rows = np.flatnonzero(match >= 0)
        own = rows_of(metric, match[rows])
        fitted = trimmed_fit(source[rows], target[match[rows]], tolerance_m, own)
        if fitted is None:
            return None
        placement = fitted
        if len(rows) <= n_agreeing:
            break
        n_agreeing = len(rows)
    return placement


def matches_of(
    source: Floats,
    target: Floats,
    placement: Placement,
    tolerance_m: float,
    metric: Floats | None = None,
) -> Ints:
    """Return the target matched to each source point (n,), or -1; each is matched once at most."""
    from relmap.core.association.search_kernels import matched_at

    R, t, farthest_m = placement.R, placement.t, farthest(tolerance_m, metric)
    return matched_at(source, target, R, t, tolerance_m, metric, farthest_m)


def triangles_of(points: Floats, least_m: float) -> Ints:
    """Return triangles (k, 3) of points (n, d) with long sides, and in space long heights."""
    n, d = points.shape
    rng = np.random.default_rng(n)
    if n < 3:
        return np.empty((0, 3), dtype=np.int64)
    if math.comb(n, 3) <= 6 * TRIANGLES:
        corners = rng.permutation(np.array(list(combinations(range(n), 3))))
    else:
        corners = rng.integers(0, n, (6 * TRIANGLES, 3))
    sides = points[corners[:, [1, 2, 0]]] - points[corners[:, [2, 0, 1]]]
    length = np.linalg.norm(sides, axis=2)
    size = length.min(axis=1)
    if d == 3:
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        size = np.minimum(size, area / np.maximum(length.max(axis=1), 1e-300))
    return np.asarray(corners[size > least_m][:TRIANGLES])


def fits_mirrored(
    source: Floats, target: Floats, tolerance_m: float, least: float, metric: Floats | None
) -> bool:
    """Return whether `least` points fit the mirror image of others, but not their own.

    `source` (n, d), `target` (m, d), metres; `metric` (m, d, d): of the targets.
    """
    sign = np.where(np.arange(source.shape[1]) == 1, -1.0, 1.0)
    mirrored = None if metric is None else metric * sign * sign[:, None]
    image = search(source, target * sign, tolerance_m, 3, mirrored)
    if image is None or image[0].n_agreeing < least:
        return False
    own = search(source, source * sign, tolerance_m, 3)  # on a line: all
    return own is None or own[0].n_agreeing < least
