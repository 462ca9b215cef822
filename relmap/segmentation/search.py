"""From points to the wall mixture that explains them best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from relmap.segmentation.em import STRAY_AT_FIRST, WallMixture, maximise, scan_area
from relmap.segmentation.lines import find_lines
from relmap.segmentation.moves import bend, merge, prune, split
from relmap.segmentation.noise import FLOOR_M, noise_candidates, points_per_beam

MOST = 3000
"""More points than these tell no more of how many walls there are; a random part is searched."""
POLISHED = 20000
"""With so many, of all points, the lines and ends are made accurate."""
LEAST = 8
"""Points of a wall, at least."""
SHORTEST = 1.5
"""A wall is longer than so many times the noise."""
ROUNDS = 4
FIRST, SAMPLED, BETWEEN, LAST = 20, 3, 10, 40
"""Steps of EM."""


def fit_walls(
    xy: NDArray[np.float64], noise: float | None, rng: np.random.Generator
) -> WallMixture:
    """Return the walls of points (n, 2), robot frame, metres, however many they are."""
    few = part(xy, MOST, rng)
    mixture = plausible(search_walls(few, noise, rng), few)
    if len(few) == len(xy):
        return mixture
    return maximise(mixture, part(xy, POLISHED, rng), BETWEEN)


def plausible(mixture: WallMixture, xy: NDArray[np.float64]) -> WallMixture:
    """Return the mixture without walls that are as thick as long, or none if points have none.

    A scan without walls is one that points spread evenly over its area explain as well.
    """
    from relmap.segmentation.kernels import BEGIN, END

    length = mixture.walls[:, END] - mixture.walls[:, BEGIN]
    mixture = mixture.only(length > SHORTEST * mixture.sigma)
    spread = -len(xy) * np.log(scan_area(xy, 0.0))
    return mixture if mixture.evidence(xy) > spread else mixture.only([])


def search_walls(
    xy: NDArray[np.float64], noise: float | None, rng: np.random.Generator
) -> WallMixture:
    """Return the walls of points (n, 2).

    Where the scan does not say plainly how noisy it is, less and less noise is tried for as long
    as the evidence grows.
    """
    trials = noise_candidates(xy, rng) if noise is None else [max(noise, FLOOR_M)]
    best, evidence = None, -np.inf
    for sigma in trials:
        found = search_from(xy, sigma, noise is not None, rng)
        if best is not None and found.evidence(xy) <= evidence:
            break
        best, evidence = found, found.evidence(xy)
    assert best is not None
    return best


def with_sampling(mixture: WallMixture, xy: NDArray[np.float64]) -> WallMixture:
    """Return the mixture with the sampling, of beams or of surface, that explains points best."""
    both = [maximise(replace(mixture, rays=rays), xy, SAMPLED) for rays in (False, True)]
    return max(both, key=lambda one: one.likelihood(xy))


def part(xy: NDArray[np.float64], most: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return points (n, 2), or so many of them if there are more."""
    return xy if len(xy) <= most else xy[rng.choice(len(xy), most, replace=False)]


def search_from(
    xy: NDArray[np.float64], sigma: float, fixed: bool, rng: np.random.Generator
) -> WallMixture:
    """Return the walls found from lines by EM and moves between numbers of walls."""
    walls, _ = find_lines(xy, sigma, LEAST, rng)
    mixture = WallMixture(
        walls,
        sigma,
        STRAY_AT_FIRST,
        scan_area(xy, sigma),
        repeat=points_per_beam(xy),
        fixed_noise=fixed,
    )
    mixture = with_sampling(maximise(mixture, xy, FIRST), xy)
    for _ in range(ROUNDS):
        before = mixture
        mixture = merge(prune(mixture, xy, LEAST), xy)
        mixture = bend(split(maximise(mixture, xy, BETWEEN), xy), xy)
        mixture = maximise(_with_strays(mixture, xy, rng), xy, BETWEEN)
        if len(mixture.walls) == len(before.walls):
            break
    mixture = with_sampling(mixture, xy)
    return maximise(merge(prune(mixture, xy, LEAST), xy), xy, LAST)


def _with_strays(
    mixture: WallMixture, xy: NDArray[np.float64], rng: np.random.Generator
) -> WallMixture:
    """Add lines among points that belong to no wall yet."""
    from relmap.segmentation.kernels import SHARE

    _, total = mixture.density(xy)
    loose = mixture.stray / mixture.area > 0.5 * total
    walls, _ = find_lines(np.ascontiguousarray(xy[loose]), mixture.sigma, LEAST, rng)
    if len(walls) == 0:
        return mixture
    walls[:, SHARE] *= loose.mean()
    return mixture.with_walls(np.concatenate([mixture.walls, walls]))
