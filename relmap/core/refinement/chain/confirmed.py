"""Chains with wrong ids, solved without observations that disagree with confirmed ones.

Where few landmarks are in view, a map that is folded explains many wrong ids, and costs only a few
steps of odometry. But odometry tells within a few scans which observations of an id are of one
landmark.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.geometry.motions import transforms
from relmap.core.geometry.robust import OUTLIER, limit_of
from relmap.core.refinement.chain.chain_data import Chain, Chained, Sigmas, unexplained
from relmap.core.refinement.chain.chain_solving import settled_chain, start_of
from relmap.core.refinement.chain.chained import ChainProblem
from relmap.core.refinement.gauss_newton import Solution

Found = tuple[Solution[Chained], ChainProblem]

SLIPS = 3.0, 10.0
"""How many times as far off as an observation a step of odometry must be to be an outlier, while
confirmed observations are solved for: few of these are wrong, unless ids are swapped for a while.
"""
MOST = 0.98
"""Fraction of confirmed observations from which ids are taken to be right, if none is swapped:
solving again takes several times as long."""
CLEARLY = 0.9
"""Largest ratio of what a solution leaves unexplained to what another does for it to be kept: where
the noise of few landmarks is correlated, they may differ by a twentieth and be as good."""
WRONG = 0.04
"""Fraction of observations that disagree with a map above which some ids are wrong, whatever the
noise: then another map that leaves less unexplained is kept."""


def unless_confirmed(
    found: Found,
    chain: Chain,
    step_sd: tuple[Floats, Floats],
    start: Chained,
    anchor: int,
    to_the_last: bool,
    is_repeated: Bools,
    is_swapped: Bools,
    known: Chained | None,
) -> tuple[Found, Chained | None]:
    """Return a solution, or the one by what agrees with confirmed observations, and their map.

    The cost of outliers grows with their distance, so that many wrong ids together fold the map,
    for a few rejected steps of odometry. The other solution leaves them out; it is returned if it
    rejects fewer steps, or leaves less of the odometry and of what is confirmed unexplained,
    clearly less if most ids may be right. Arguments as for `settled_chain`; `is_repeated`,
    `is_swapped` (n,): which observations others confirm, and which of these have swapped ids;
    `known`: their map, if it was solved for before. None is returned if it is not needed.
    """
    sure = is_repeated & ~is_swapped
    if not np.any(sure) or (np.mean(sure) >= MOST and not np.any(is_swapped)):
        return found, None
    state = known or _of_confirmed(chain, sure, step_sd, start, anchor)
    agrees = _agrees(chain, state)
    lost = ~np.isin(chain.landmark, chain.landmark[agrees])
    other = settled_chain(
        chain.only(agrees | lost), step_sd, state, anchor, None, to_the_last, True
    )
    off = float(np.mean(~_agrees(chain, found[0].state)))
    first, second = _unexplained([found, other], sure, start.positions, 1.0)
    return other if is_better(second, first, off) else found, state


def is_better(other: tuple[float, int], first: tuple[float, int], share_off: float) -> bool:
    """Return whether another solution replaces the first.

    `other`, `first`: what each leaves unexplained, and how many steps it rejects; `share_off`: the
    fraction of the observations that disagree with the first.
    """
    (less, fewer), (kept, slips) = other, first
    return fewer < slips or less < (1.0 if share_off > WRONG else CLEARLY) * kept


def _agrees(chain: Chain, state: Chained) -> Bools:
    """Return which observations (n,) agree with a map."""
    left = np.linalg.norm(unexplained(chain, state), axis=1)
    return np.asarray(left <= limit_of(left, chain.points.shape[1], 0.0))


def _of_confirmed(
    chain: Chain, sure: Bools, step_sd: tuple[Floats, Floats], start: Chained, anchor: int
) -> Chained:
    """Return the better map of confirmed observations, from `start`.

    Other landmarks are where the robot saw them.
    """
    own, of = np.unique(chain.landmark[sure], return_inverse=True)
    only, m = chain.only(sure), len(start.positions)
    only = Chain(only.points, of, only.iteration, only.root, only.motion)
    begun = start_of(only, transforms(start.R, start.t), len(own))
    each: list[Found] = []
    for slip in SLIPS:
        each.append(settled_chain(only, step_sd, begun, anchor, None, False, True, slip))
        solution, problem = each[-1]
        if np.all(solution.weight[problem.parts[1].start :] == 1):
            break  # Outliers of odometry are all that differs.
    every = np.ones(len(of), dtype=bool)
    costs = [cost for cost, _ in _unexplained(each, every, begun.positions, max(SLIPS))]
    state = each[int(np.argmin(costs))][0].state
    found = start_of(chain, transforms(state.R, state.t), m)
    found.positions[own] = state.positions
    return replace(found, constant=state.constant)


def _unexplained(
    solutions: list[Found], sure: Bools, positions: Floats, slip: float
) -> list[tuple[float, int]]:
    """Return what each solution does not explain, squared, and how many steps it rejects.

    At the smallest of their noises, of the observations `sure` (n,) and of odometry; `slip`: how
    many times as much a step of odometry counts at most.
    """
    noise = Sigmas(*np.min([problem.sigmas for _, problem in solutions], axis=0))
    judge, found = solutions[0][1].with_noise(noise, positions), []
    for solution, _ in solutions:
        seen, *odometry = (judge.residuals(solution.state)[part] for part in judge.parts)
        squares = np.sum(np.minimum(seen[sure], OUTLIER) ** 2)
        squares += np.sum(np.minimum(odometry, slip * OUTLIER) ** 2)
        found.append((float(squares), int(np.sum(np.max(odometry, axis=0) > OUTLIER))))
    return found
