"""Choosing the number of walls: removing, joining and splitting them.

EM never changes the number of its components.  Each move is accepted or rejected by the change of
the likelihood of the relevant points and of the number of parameters (as in BIC), except that
walls are opaque: two that are flush are one if one hides the other, or they lie side by side.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.em.mixture import PARAMETERS, WallMixture, maximise, wall_cost
from relmap.segmentation.wall import (
    BEGIN,
    END,
    EXACT_M,
    LEAST,
    SHARE,
    cut,
    flush,
    one_hides_other,
    side_by_side,
    within_reach,
)

EMPTY = 6.0
"""Minimum number of missing points in a gap: fewer occur by chance once in e**6."""
MISSED = 0.6
"""Missing columns of beams in a gap: one suffices, as noise moves no point off its beam."""
CURVED = 3.0
"""Curvature, in standard deviations, above which splitting a wall is tried."""
SETTLE = 6
"""Steps of EM after a move."""
TRIAL = 8
"""Steps of EM to evaluate a move."""
GLANCE = 4
"""Steps of EM to select the most promising of several moves."""
FINALISTS = 2
LEG = 3.0
"""Standard deviations from a wall's end within which another may begin undetected."""
ROUGH = 0.05
"""Gain of log likelihood per wall and step below which a trial has converged."""


def prune(mixture: WallMixture, xy: Floats) -> WallMixture:
    """Remove walls whose points the rest explains about as well, weakest first."""
    penalty = wall_cost(len(xy))
    while len(mixture.walls):
        density, total = mixture.density(xy)
        gain = -np.log1p(-np.minimum(density / total, 1 - 1e-12)).sum(axis=1)
        weak = np.minimum(gain - penalty, mixture.walls[:, SHARE] * len(xy) - LEAST)
        worst = int(weak.argmin())
        if weak[worst] >= 0:
            break
        keep = np.arange(len(mixture.walls)) != worst
        mixture = maximise(mixture.only(keep), xy, SETTLE)
    return mixture


def merge(mixture: WallMixture, xy: Floats) -> WallMixture:
    """Join pairs of walls that are flush, or do not justify their parameters."""
    names, parted = list(range(len(mixture.walls))), set[tuple[int, int]]()
    while True:
        labels = mixture.labels(xy)
        for i, j in combinations(range(len(names)), 2):
            if (names[i], names[j]) not in parted:
                joined = _join(mixture, xy, labels, i, j)
                if joined is not None:
                    break
                parted.add((names[i], names[j]))
        else:
            return mixture
        walls = np.delete(mixture.walls, j, axis=0)
        walls[i] = joined
        mixture = mixture.with_walls(walls)
        names[i] = max(names) + 1
        del names[j]


def _join(mixture: WallMixture, xy: Floats, labels: Ints, i: int, j: int) -> Floats | None:
    """Return two walls as one, given the wall of each point; None if they are two."""
    w, v = mixture.walls[i], mixture.walls[j]
    if not within_reach(w, v, mixture.sigma):
        return None
    own = xy[(labels == i) | (labels == j)]
    if len(own) < 3:
        return None
    whole = wall_through(own, w, mixture.beam)
    whole[SHARE] = w[SHARE] + v[SHARE]
    if flush(w, v, mixture.sigma) and (one_hides_other(w, v, mixture.sigma) or side_by_side(w, v)):
        return whole
    two, near = mixture.around([i, j], xy)
    scale = len(xy) / len(near)
    whole[SHARE] *= scale
    two = maximise(two, near, TRIAL, tolerance=ROUGH)
    one = maximise(two.with_walls(whole[None]), near, TRIAL, tolerance=ROUGH)
    if one.evidence(near) < two.evidence(near):
        return None
    one.walls[0, SHARE] /= scale
    return np.asarray(one.walls[0])


def bend(mixture: WallMixture, xy: Floats, suspects_only: bool = True) -> WallMixture:
    """Split bent walls across and thick walls lengthwise."""
    labels, walls = mixture.labels(xy), []
    for k, wall in enumerate(mixture.walls):
        own = xy[labels == k]
        suspect = len(own) > 2 * PARAMETERS
        suspect = suspect and not (suspects_only and not _suspect(mixture, own, wall))
        pieces = _bent(mixture, xy, own, k) if suspect else None
        walls.append(wall[None] if pieces is None else pieces)
    return mixture.with_walls(np.concatenate(walls)) if walls else mixture


def _suspect(mixture: WallMixture, own: Floats, wall: Floats) -> bool:
    """Return whether points (m, 2) look bent, or thicker than the noise, about their wall."""
    _, t, d = mixture.sightings(own, wall)
    z = (t - t.mean()) / max(t.std(), 1e-12)
    curve = z * z - z * (z**3).mean() - 1
    spread = max(float(d.std()), 1e-12)
    bent = abs(d @ curve) / (spread * max(float(np.linalg.norm(curve)), 1e-12))
    return bool(bent > CURVED or spread > mixture.sigma * (1 + 2 / np.sqrt(len(own))))


def _bent(mixture: WallMixture, xy: Floats, own: Floats, k: int) -> Floats | None:
    """Return two walls that better explain a wall's points, if there are any."""
    one, near = mixture.around([k], xy)
    wall, trials = one.walls[0], []
    _, t, d = mixture.sightings(own, wall)
    for upper in _halves(t, d, mixture.sigma):
        if min(upper.sum(), (~upper).sum()) < PARAMETERS:
            continue
        halves = np.array([wall_through(own[side], wall, one.beam) for side in (upper, ~upper)])
        halves[:, SHARE] *= [upper.mean(), 1 - upper.mean()]
        trials.append(maximise(one.with_walls(halves), near, GLANCE, tolerance=ROUGH))
    best, pieces = maximise(one, near, TRIAL, tolerance=ROUGH).evidence(near), None
    for trial in sorted(trials, key=lambda two: -two.likelihood(near))[:FINALISTS]:
        two = maximise(trial, near, 2 * TRIAL, tolerance=ROUGH)
        if two.evidence(near) > best and not one_hides_other(two.walls[0], two.walls[1], two.sigma):
            best, pieces = two.evidence(near), two.walls.copy()
    if pieces is not None:
        pieces[:, SHARE] *= len(near) / len(xy)
    return pieces


def _halves(t: Floats, d: Floats, sigma: float) -> list[Bools]:
    """Return splits (m,) of points at t along and d across a wall: ends, middle, sides."""
    low, first, middle, last, high = np.quantile(t, [0, 0.25, 0.5, 0.75, 1])
    cuts = [first, middle, last]
    if high - low > 12 * sigma:
        cuts += [low + LEG * sigma, high - LEG * sigma]
    return [*(t > cut for cut in cuts), d > np.median(d)]


def wall_through(own: Floats, like: Floats, beam: float = 0.0) -> Floats:
    """Return the wall through points (m, 2), with the orientation of another."""
    from relmap.segmentation.em.step_kernels import fit_line
    from relmap.segmentation.em.wall_kernels import sightings

    wall = like.copy()
    fit_line(own, wall, beam)
    t = sightings(own, wall, beam)[1]
    wall[BEGIN], wall[END] = t.min(), max(t.max(), t.min() + EXACT_M)
    return wall


def split(mixture: WallMixture, xy: Floats) -> WallMixture:
    """Split walls at doors: stretches too empty to belong to a uniformly filled wall."""
    labels, walls = mixture.labels(xy), list[Floats]()
    for k, wall in enumerate(mixture.walls):
        u, t, _ = mixture.sightings(xy[labels == k], wall)
        hole = _hole(np.sort(u), wall, mixture)
        walls += [wall] if hole is None else cut(wall, hole, float(np.mean(t < 0.5 * sum(hole))))
    return mixture.with_walls(np.array(walls).reshape(-1, mixture.walls.shape[1]))


def _hole(u: Floats, wall: Floats, mixture: WallMixture) -> tuple[float, float] | None:
    """Return the gap along a wall (metres) among the sorted measures of its points."""
    from relmap.segmentation.em.wall_kernels import foot_and_height, place

    hole = missed_beams(u, mixture.beam) if mixture.repeat > 1 else widest_gap(u, mixture.along)
    if hole is None:
        return None
    foot, height = foot_and_height(wall)
    first, last = (place(edge, foot, height, mixture.beam) for edge in hole)
    return first, last


def missed_beams(bearing: Floats, beam: float) -> tuple[float, float] | None:
    """Return the widest step between sorted bearings (m,) if beams are missing in it.

    Half a beam at each side is excluded, as it belongs to the wall.
    """
    if len(bearing) < 2:
        return None
    step = np.diff(bearing)
    at = int(step.argmax())
    if step[at] < (1 + MISSED) * beam:
        return None
    return float(bearing[at] + 0.5 * beam), float(bearing[at + 1] - 0.5 * beam)


def widest_gap(t: Floats, sigma: float) -> tuple[float, float] | None:
    """Return the emptiest stretch of sorted positions (m,) along a wall, if it is a gap.

    The number of points in a stretch is compared, as Poisson counts, with that of a uniform wall
    and with that due to noise from both sides of a gap (0.8 sigma of wall).
    """
    if len(t) < 6:
        return None
    length = t[-1] - t[0]
    width = max(0.5 * sigma, length / min(len(t), 400), 1e-12)
    edges = t[0] + width * np.arange(int(length / width) + 1)
    below = np.searchsorted(t, edges)
    inside = below[None, :] - below[:, None]
    gap = edges[None, :] - edges[:, None]
    outside = np.maximum(len(t) - inside, 1) / np.maximum(length - gap, width)
    even, leaked = outside * gap, np.maximum(0.8 * sigma * outside, 0.2)
    gain = even - leaked - inside * np.log(np.maximum(even, 1e-9) / leaked)
    margin = 2 * sigma
    possible = (gap > 2 * sigma) & (even > leaked) & (inside < even)
    possible &= (edges[:, None] > t[0] + margin) & (edges[None, :] < t[-1] - margin)
    gain = np.where(possible, gain, -np.inf)
    i, j = np.unravel_index(int(gain.argmax()), gain.shape)
    if gain[i, j] < EMPTY + wall_cost(len(t)):
        return None
    return float(edges[i]), float(edges[j])
