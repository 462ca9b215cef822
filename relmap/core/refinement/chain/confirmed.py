"""Chains with wrong ids, solved first from observations that others confirm.

Where few landmarks are in view, poses that wrong ids turn explain many observations, and from such
a start least squares ends in a map that is folded. Odometry tells within a few scans which
observations of an id are of one landmark.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.geometry.motions import transforms
from relmap.core.geometry.robust import OUTLIER, limit_of
from relmap.core.refinement.chain.chain_solving import settled_chain, start_of
from relmap.core.refinement.chain.chained import Chain, Chained, ChainProblem, Sigmas
from relmap.core.refinement.condensing import LENGTH
from relmap.core.refinement.gauss_newton import Solution

Found = tuple[Solution[Chained], ChainProblem]

MOST = 0.98
"""Fraction of confirmed observations from which ids are taken to be right."""
CLEARLY = 0.9
"""Largest ratio of what a solution leaves unexplained to what another does for it to be kept: where
the noise of few landmarks is correlated, they may differ by a twentieth and be as good."""


def unless_confirmed(
    found: Found,
    chain: Chain,
    step_sd: tuple[Floats, Floats],
    start: Chained,
    anchor: int,
    to_the_last: bool,
) -> Found:
    """Return a solution, or one that starts from odometry and what is confirmed, if clearly better.

    Confirmed observations are solved for first, by themselves. Arguments as for `settled_chain`.
    """
    sure = confirmed(chain, step_sd)
    if not 0 < np.sum(sure) < MOST * len(sure):
        return found
    landmarks, of = np.unique(chain.landmark[sure], return_inverse=True)
    own = Chain(chain.points[sure], of, chain.iteration[sure], chain.root[sure], chain.motion)
    begun = start_of(own, _reckoned(chain, transforms(start.R, start.t)), len(landmarks))
    solved, problem = settled_chain(own, step_sd, begun, anchor, None, False, True)
    state, m = solved.state, len(start.positions)
    begun = replace(start_of(chain, transforms(state.R, state.t), m), constant=state.constant)
    other = settled_chain(chain, step_sd, begun, anchor, problem.sigmas, to_the_last, True)
    common = found[1].with_noise(
        Sigmas(*np.minimum(found[1].sigmas, other[1].sigmas)), start.positions
    )
    kept, better = (
        np.sum(np.minimum(common.residuals(one.state), OUTLIER) ** 2) for one, _ in (found, other)
    )
    return other if better < CLEARLY * kept else found


def confirmed(chain: Chain, step_sd: tuple[Floats, Floats]) -> Bools:
    """Return which observations (n,) another one of the same landmark confirms.

    One of the next few, at most `LENGTH` iterations away, shows it where odometry expects it. Wrong
    ids are seldom repeated.

    `step_sd`, tuple of (k - 1,): standard deviations of the distance and the turn of each step.
    """
    (n, d), at = chain.points.shape, chain.iteration
    poses = _reckoned(chain, np.tile(np.eye(4), (len(chain.motion) + 1, 1, 1)))[at]
    places = np.einsum("nij,nj->ni", poses[:, :d, :d], chain.points) + poses[:, :d, 3]
    variance = d / np.maximum(np.sum(chain.root**2, axis=(1, 2)), 1e-300)
    square = np.sum(chain.points**2, axis=1)
    unknown = np.isnan(chain.motion[:, 0, 0])
    sums = (unknown, *(np.where(unknown, 0.0, sd**2) for sd in step_sd))
    part, way, turn = (np.append(0, np.cumsum(each))[at] for each in sums)
    order, pairs, off = np.lexsort((at, chain.landmark)), [], []
    for lag in range(1, LENGTH + 1):
        a, b = order[:-lag], order[lag:]
        near = (chain.landmark[a] == chain.landmark[b]) & (at[b] - at[a] <= LENGTH)
        near &= part[a] == part[b]
        a, b = a[near], b[near]
        expected = variance[a] + variance[b] + way[b] - way[a]
        expected += (turn[b] - turn[a]) * np.maximum(square[a], square[b])
        pairs.append(np.column_stack([a, b]))
        off.append(np.linalg.norm(places[a] - places[b], axis=1) / np.sqrt(expected))
    apart, found = np.concatenate(off), np.zeros(n, dtype=bool)
    found[np.concatenate(pairs)[apart <= limit_of(apart, d, 0.0)]] = True
    return found


def _reckoned(chain: Chain, poses: Floats) -> Floats:
    """Return poses (k, 4, 4) by odometry, from others (k, 4, 4) where it is not known."""
    steps = np.where(np.isnan(chain.motion), np.linalg.inv(poses[:-1]) @ poses[1:], chain.motion)
    found = poses.copy()
    for k, step in enumerate(steps):
        found[k + 1] = found[k] @ step
    return found
