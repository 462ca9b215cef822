"""From points to the wall mixture that best explains them.

It starts from lines in the ground plane by RANSAC in local windows, with a density split along
each. A window holds few walls, so two of its points lie on the same wall far more often than two of
the scan's (local sampling: Torr and Davidson, "IMPSAC", PAMI 2003). From the window a line grows
along its own band as long as points follow one another; the best lines claim their points first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.em.mixture import STRAY_AT_FIRST, WallMixture, maximise, scan_area
from relmap.segmentation.em.moves import ROUGH, bend, merge, prune, split
from relmap.segmentation.noise import (
    FLOOR_M,
    beam_angle,
    neighbour_distance,
    points_per_beam,
    window_noise,
)
from relmap.segmentation.wall import BEGIN, END, LEAST, SHARE, WALL

FEW = 1000
MOST = 3000
MORE = 6000
"""Maximum number of points for the search of the number of walls; beyond it, a random sample."""
POLISHED = 20000
"""Maximum number of points for the refinement of lines and ends."""
SHORTEST = 1.5
"""Minimum length of the longest wall of a scan, relative to the noise."""
STRAYS = 0.1
"""Fraction of a wall's points that may belong to a neighbour."""
STARTS = (0.5, 0.8)
"""Factor on the noise estimate for the first search for lines: joining pieces of a wall is easier
than splitting merged walls."""
ROUNDS = 4
LOOSER = 12.0
"""Spacings of points by which an end may have been missed."""
FIRST, BETWEEN, LAST = 20, 10, 40
"""Steps of EM."""
TRIES = 100
BEAMS = 0.5
"""Angle, in beams, below which points are the noise of one column, not a wall."""
UNCLAIMED = 0.6
"""Fraction of a line's points that must still be free for it to keep them; else it is regrown."""


def fit_walls(xy: Floats, noise: float | None, rng: np.random.Generator) -> WallMixture:
    """Return the walls of points (n, 2), robot frame, metres; their number is estimated.

    Several starts on few points; the best is refined on increasing numbers of points.
    """
    few = part(xy, FEW, rng)
    mixture = search_walls(few, noise, rng)
    for most in (MOST, MORE):
        mixture, few = loosened(mixture, len(few)), part(xy, most, rng)
        mixture = replace(mixture, repeat=points_per_beam(few))
        mixture = improve(mixture, few, rng, thorough=True)
        if len(few) == len(xy):
            break
    mixture = plausible(maximise(mixture, few, LAST), few)
    if len(few) == len(xy):
        return mixture
    return maximise(mixture, part(xy, POLISHED, rng), BETWEEN)


def loosened(mixture: WallMixture, n: int) -> WallMixture:
    """Return walls among n points, slightly extended, so that more points can show their ends.

    Without noise, no point beyond an end would ever be included.
    """
    walls = mixture.walls.copy()
    spacing = (walls[:, END] - walls[:, BEGIN]) / np.maximum(walls[:, SHARE] * n, 1.0)
    more = np.where(spacing > mixture.sigma, LOOSER * spacing, 0.0)
    walls[:, BEGIN] -= more
    walls[:, END] += more
    return mixture.with_walls(walls)


def plausible(mixture: WallMixture, xy: Floats) -> WallMixture:
    """Return the mixture, without walls if the points have none.

    A scan has no walls if a uniform distribution over its area explains it as well, or if all walls
    are as thick as long.
    """
    if not long_enough(mixture).any():
        return mixture.only([])
    spread = -len(xy) * np.log(scan_area(xy, 0.0))
    return mixture if mixture.evidence(xy) > spread else mixture.only([])


def long_enough(mixture: WallMixture) -> Bools:
    """Return which walls (k,) are longer than thick."""
    length = mixture.walls[:, END] - mixture.walls[:, BEGIN]
    return np.asarray(length > SHORTEST * mixture.sigma)


def seen_broad(mixture: WallMixture, xy: Floats, labels: Ints) -> Bools:
    """Return which walls (k,) have points (n, 2) on several beams: one gives no direction.

    Some of the points may belong to a neighbour.
    """
    broad = np.zeros(len(mixture.walls), dtype=np.bool_)
    for k in np.unique(labels[labels >= 0]):
        u = mixture.sightings(xy[labels == k], mixture.walls[k])[0]
        broad[k] = np.ptp(np.quantile(u, [STRAYS, 1 - STRAYS])) > 0.5 * mixture.beam
    return broad


def search_walls(xy: Floats, noise: float | None, rng: np.random.Generator) -> WallMixture:
    """Return the walls of points (n, 2): the best of several starts by evidence."""
    sigma = window_noise(xy, rng) if noise is None else max(noise, FLOOR_M)
    beams = beam_angle(xy), points_per_beam(xy)
    none, area = np.zeros((0, WALL)), scan_area(xy, sigma)
    nothing = WallMixture(none, sigma, STRAY_AT_FIRST, area, *beams, fixed_noise=noise is not None)
    found = []
    for start in STARTS:
        lines = find_lines(xy, start * sigma, rng, nothing.beam)[0]
        first = replace(nothing, walls=lines, sigma=start * sigma if noise is None else sigma)
        found.append(improve(maximise(first, xy, FIRST, tolerance=ROUGH), xy, rng))
    return max(found, key=lambda one: one.evidence(xy))


def part(xy: Floats, most: int, rng: np.random.Generator) -> Floats:
    """Return the points (n, 2), or a random sample if there are more than `most`."""
    return xy if len(xy) <= most else xy[rng.choice(len(xy), most, replace=False)]


def improve(
    mixture: WallMixture, xy: Floats, rng: np.random.Generator, thorough: bool = False
) -> WallMixture:
    """Return the mixture after moves between numbers of walls, until none is accepted."""
    for _ in range(ROUNDS):
        sizes = [len(mixture.walls)]
        mixture = prune(mixture, xy)
        sizes.append(len(mixture.walls))
        mixture = merge(mixture, xy)
        sizes.append(len(mixture.walls))
        mixture = split(maximise(mixture, xy, BETWEEN, tolerance=ROUGH), xy)
        sizes.append(len(mixture.walls))
        mixture = bend(mixture, xy, not thorough or mixture.repeat > 1)
        sizes.append(len(mixture.walls))
        mixture = _with_strays(mixture, xy, rng)
        mixture = maximise(mixture, xy, BETWEEN, tolerance=ROUGH)
        sizes.append(len(mixture.walls))
        if min(sizes) == max(sizes):
            return mixture
    return merge(prune(mixture, xy), xy)


def _with_strays(mixture: WallMixture, xy: Floats, rng: np.random.Generator) -> WallMixture:
    """Add lines among points that belong to no wall yet."""
    _, total = mixture.density(xy)
    loose = mixture.stray / mixture.area > 0.5 * total
    strays = np.ascontiguousarray(xy[loose])
    walls, _ = find_lines(strays, mixture.sigma, rng, mixture.beam)
    if len(walls) == 0:
        return mixture
    walls[:, SHARE] *= loose.mean()
    return mixture.with_walls(np.concatenate([mixture.walls, walls]))


def find_lines(
    xy: Floats, sigma: float, rng: np.random.Generator, beam: float
) -> tuple[Floats, Ints]:
    """Return lines and the line of each point.

    `xy` (n, 2), robot frame, metres. `sigma`: noise, metres. `beam`: angle between beams, radians;
    0 without beams. Returns `walls` (k, WALL): see `relmap.segmentation.wall`; best first. `labels`
    (n,): row of `walls`, -1 for none.
    """
    from relmap.segmentation.em.window_kernels import grow_lines

    labels, found = np.full(len(xy), -1), [np.zeros((0, WALL))]
    if len(xy) < LEAST:
        return found[0], labels
    window, repeat = max(6 * sigma, 2 * neighbour_distance(xy)), points_per_beam(xy)
    narrow, count = BEAMS * beam, 0
    while (labels < 0).sum() >= LEAST:
        free = np.flatnonzero(labels < 0)
        grown = grow_lines(xy[free], rng.random((TRIES, 2)), sigma, window, repeat, narrow)
        chosen, claims = _best_first(*grown[1:])
        if not chosen:
            break
        for k, claim in zip(chosen, claims, strict=True):
            labels[free[claim]] = count
            grown[0][k, SHARE] = claim.sum() / len(xy)
            count += 1
        found.append(grown[0][chosen])
    return np.concatenate(found), labels


def _best_first(members: Bools, scores: Floats) -> tuple[list[int], list[Bools]]:
    """Return which lines claim points, best first, and the points (n,) each claims."""
    size = members.sum(axis=1)
    quality = scores / np.maximum(size, 1)
    chosen: list[int] = []
    claims: list[Bools] = []
    left = size
    while True:
        score = np.where(left >= UNCLAIMED * size, left * quality, 0)
        best = int(score.argmax())
        if left[best] < LEAST or score[best] <= 0:
            return chosen, claims
        claim = members[best].copy()
        chosen.append(best)
        claims.append(claim)
        members &= ~claim
        left = members.sum(axis=1)
