"""The map of all observations and odometry, where landmarks alone leave gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import nearest
from relmap.core.association.metric import WORST
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.core.geometry.motions import transforms
from relmap.core.map.globalmap import order_of_submaps
from relmap.core.motion_noise import MotionNoise, unit_of
from relmap.core.refinement.chain.bridging import Bridged
from relmap.core.refinement.chain.chain_data import Chain, Chained, Sigmas, off_by, unexplained
from relmap.core.refinement.chain.chain_solving import settled_chain, start_of
from relmap.core.refinement.chain.chained import ChainProblem
from relmap.core.refinement.chain.confirmed import unless_confirmed
from relmap.core.refinement.chain.visits import visits_of
from relmap.core.refinement.condensing import NOWHERE, SegmentRows
from relmap.core.refinement.gauss_newton import Solution, size_of
from relmap.core.refinement.joint import Refined, Spread, joint_rows
from relmap.core.refinement.misread import FAR, are_scattered
from relmap.core.refinement.residuals import MergeResiduals, SegmentResiduals, residuals_of
from relmap.core.state.table import NONE, LandmarkState

if TYPE_CHECKING:
    from relmap.core.mapper import RelativeMapper

ALIKE = 0.1
"""Largest median distance of the common landmarks of two joined parts, relative to their extent."""
AGAIN = 2
"""Minimum number of observations of a landmark that constrains the poses."""
TELLS = 2, 4
"""How many times as many visits, or observations, must show a landmark at its place as at another
one: where ids are swapped for a while, it is not known which place is which."""
ELSEWHERE = 0.8
"""Distance from which an observation shows another landmark, relative to that of the nearest one:
where passes disagree, as in Victoria Park, they do so by less."""
GUESS_M = 0.1
"""Noise of an observed coordinate if it is unknown."""
DOUBT = 0.25
"""Weight below which a step of odometry counts as rejected."""


@dataclass(frozen=True, eq=False)
class Solved:
    """The solution for a part of a run.

    `poses` (k, 4, 4): poses of its iterations, in the frame of `refined`; `iterations` (k,);
    `doubted` (i,): iterations whose odometry is rejected. `of_two_places` (l,): landmarks whose id
    names two places. `confirmed`: the map of confirmed observations, if it was needed, with all its
    `landmarks` (m,).
    """

    refined: Refined
    poses: Floats
    iterations: Ints
    doubted: Ints
    of_two_places: Ints
    sigmas: Sigmas
    landmarks: Ints
    confirmed: Chained | None


@dataclass(frozen=True, eq=False)
class PartSolver:
    """Solves parts of a run by all observations and odometry.

    `rows`: of all iterations; `motions` (k, 4, 4): odometry without its constant errors, NaN if
    unknown, of this noise; `sigmas`: factors of the noises, if estimated before; `to_the_last`:
    whether outliers are rejected and the cost is minimised until convergence.
    """

    engine: RelativeMapper
    rows: SegmentRows
    motions: Floats
    noise: MotionNoise
    sigmas: Sigmas | None
    to_the_last: bool

    def solve(self, bridged: Bridged, before: Sequence[Solved] = ()) -> list[Solved]:
        """Return the solved parts of a run from these initial poses.

        They are in the order of submaps: the first is the map. `before`: solutions with more
        landmarks, of which the maps of confirmed observations serve again.
        """
        found = (self._part(bridged, part, before) for part in np.unique(bridged.part).tolist())
        solved = [part for part in found if part is not None]
        each, first = [part.refined.landmarks for part in solved], self.engine.table.first
        until = self.engine.map.kept_until
        kept = np.array([np.sum(first[own] < until) for own in each], dtype=np.int64)
        order = order_of_submaps(kept, np.array([len(own) for own in each], dtype=np.int64))
        return [solved[k] for k in order.tolist()]

    def _part(self, bridged: Bridged, part: int, before: Sequence[Solved]) -> Solved | None:
        """Return one part; None if it has no observation."""
        iterations = np.flatnonzero(bridged.part == part)
        chain, landmarks = self._chain(bridged, part, iterations)
        if not len(landmarks):
            return None
        # The first iteration with an observation, from the kept anchor on.
        kept = np.flatnonzero(iterations[chain.iteration] >= self.engine.map.kept_anchor)
        anchor = int(chain.iteration[kept[0] if len(kept) else 0])
        start = start_of(chain, bridged.poses[iterations], len(landmarks))
        step_sd = self.noise.sigmas(chain.motion)
        has_ids = self.engine.association.has_ids
        found = settled_chain(chain, step_sd, start, anchor, self.sigmas, self.to_the_last, has_ids)
        visit, confirmed = np.full(len(chain.points), NONE), None
        if has_ids:
            visit, is_swapped = visits_of(chain, step_sd)
            known = _confirmed(before, iterations, landmarks)
            args = chain, step_sd, start, anchor, self.to_the_last, visit != NONE, is_swapped
            found, confirmed = unless_confirmed(found, *args, known)
        settled, problem = found
        refined, placed = self._refined(settled, problem, landmarks, iterations, anchor)
        of_two_places = np.zeros(len(landmarks), dtype=bool)
        if has_ids:
            misread, of_two_places = _misread(settled, problem, chain, visit)
            refined = refined.only(~(misread | of_two_places))
        left_out = len(chain.points) - len(problem.chain.points)
        refined = replace(refined, n_outliers=refined.n_outliers + left_out)
        way, turn = problem.parts[1:]
        weight = np.minimum(settled.weight[way], settled.weight[turn])
        doubted = iterations[problem.moved[weight < DOUBT] + 1]
        named, sigmas = landmarks[of_two_places], problem.sigmas
        return Solved(refined, placed, iterations, doubted, named, sigmas, landmarks, confirmed)

    def _chain(self, bridged: Bridged, part: int, iterations: Ints) -> tuple[Chain, Ints]:
        """Return the data of a part, and its landmarks (m,)."""
        engine, kept, table = self.engine, self.engine.kept, self.engine.table
        every = table.now(kept.landmark)
        there = (bridged.part[kept.iteration] == part) & ~table.dynamic[every]
        seen = np.bincount(every[there], kept.count[there], minlength=len(table))
        is_mature = self.to_the_last and not engine.association.has_ids
        often = seen >= (engine.config.group_after // 2 if is_mature else AGAIN)
        chosen = np.flatnonzero(there & often[every])
        landmarks, of = np.unique(every[chosen], return_inverse=True)
        points = kept.location[chosen]
        root = np.sqrt(kept.count[chosen])[:, None, None] * np.eye(points.shape[1])
        if len(kept.covariance) and not engine.association.current.estimates_covariances:
            # Their common factor is that of the noise, which is estimated.
            variance = np.trace(kept.covariance, axis1=1, axis2=2) / points.shape[1]
            usual = np.minimum(variance, WORST**2 * np.median(variance)).mean()
            root = np.linalg.inv(np.linalg.cholesky(kept.covariance[chosen] / usual))
        root /= self._sigma_m
        between = self.motions[iterations[1:]].copy()
        between[np.diff(iterations) != 1] = np.nan
        begin = np.searchsorted(iterations, kept.iteration[chosen])
        return Chain(points, of, begin, root, between), landmarks

    def _refined(
        self,
        settled: Solution[Chained],
        problem: ChainProblem,
        landmarks: Ints,
        iterations: Ints,
        anchor: int,
    ) -> tuple[Refined, Floats]:
        """Return the map and the poses (k, 4, 4), in the frame of the anchor."""
        state = settled.state
        R, t = state.R[anchor], state.t[anchor]
        placed = transforms(R.T @ state.R, (state.t - t) @ R)
        self._carry_condensed(placed, iterations)
        positions, seen_m = (state.positions - t) @ R, self._sigma_m * problem.sigmas.seen
        segments, merges = _residuals(self.rows, self.engine.table, landmarks, positions, seen_m)
        refined = Refined(
            landmarks,
            positions,
            int(iterations[anchor]),
            seen_m,
            segments,
            merges,
            Spread(problem, settled, np.ones(len(landmarks), dtype=bool), R),
            converged=settled.converged,
            n_outliers=int(np.sum(settled.weight[problem.parts[0]] < 1)),
        )
        return refined, placed

    def _carry_condensed(self, placed: Floats, iterations: Ints) -> None:
        """Move the poses (k, 4, 4) of iterations (k,) that were not observed singly.

        Their segment was condensed before the first odometry, and moves with its first iteration.
        """
        segment = self.rows.iteration_segment[iterations]
        is_condensed = (segment != NOWHERE) & ~np.isin(iterations, self.engine.kept.iteration)
        own = np.flatnonzero(is_condensed)
        base = self.rows.base[segment[own]]
        at = np.searchsorted(iterations, base).clip(max=len(iterations) - 1)
        own, at = own[iterations[at] == base], at[iterations[at] == base]
        lies = self.rows.poses[iterations]
        placed[own] = placed[at] @ np.linalg.inv(lies[at]) @ lies[own]

    @property
    def _sigma_m(self) -> float:
        noise_m = self.engine.noise_m
        is_known = np.isfinite(noise_m) and noise_m > 0
        return noise_m if is_known else GUESS_M * unit_of(self.rows.points)


def join_parts(bridged: Bridged, solved: Sequence[Solved]) -> Bridged | None:
    """Return all scans with a part joined to the first that shares landmarks with it.

    Parts of one log that are not connected by odometry may share landmarks, known by their ids.

    `solved`: its parts, as `PartSolver.solve` returns them. Returns None if no part shares enough
    landmarks, or their positions disagree.
    """
    for k in reversed(range(len(solved))):
        other = solved[k]
        for base in solved[:k]:
            one, another = other.refined, base.refined
            _, mine, its = np.intersect1d(one.landmarks, another.landmarks, return_indices=True)
            here, there = one.positions[mine], another.positions[its]
            if len(mine) <= here.shape[1] or not fixes_rotation(there):
                continue
            R, t = fit_rigid(here, there)
            apart = np.linalg.norm(here @ R.T + t - there, axis=1)
            if np.median(apart) > ALIKE * size_of(there):
                continue
            poses, part = bridged.poses.copy(), bridged.part.copy()
            poses[base.iterations] = base.poses
            poses[other.iterations] = transforms(R, t) @ other.poses
            part[other.iterations] = part[base.iterations[0]]
            return replace(bridged, poses=poses, part=part)
    return None


def _confirmed(before: Sequence[Solved], iterations: Ints, landmarks: Ints) -> Chained | None:
    """Return the map of what is confirmed of these landmarks, if this part was solved before."""
    for one in before:
        if one.confirmed is not None and np.array_equal(one.iterations, iterations):
            own = np.searchsorted(one.landmarks, landmarks)
            return replace(one.confirmed, positions=one.confirmed.positions[own])
    return None


def _misread(
    settled: Solution[Chained], problem: ChainProblem, chain: Chain, visit: Ints
) -> tuple[Bools, Bools]:
    """Return which landmarks (m,) exist only because of wrong ids, and whose id names two places.

    `chain`: all observations, also those that the solved problem leaves out; `visit` (n,): as
    `visits_of` returns it.
    """
    state, m = settled.state, len(settled.state.positions)
    is_off = np.linalg.norm(unexplained(chain, state), axis=1) > FAR * problem.sigmas.seen
    against = np.bincount(chain.landmark, is_off, m)
    support = np.bincount(chain.landmark, minlength=m) - against
    is_far = is_off & _is_elsewhere(chain, state)
    own, first, of, size = np.unique(
        visit, return_index=True, return_inverse=True, return_counts=True
    )
    at, elsewhere = chain.landmark[first], (own != NONE) & (2 * np.bincount(of, is_far) > size)
    visits, there = np.bincount(at, own != NONE, m), np.bincount(at, elsewhere, m)
    seen_there = np.bincount(at, elsewhere * size, m)
    is_of_two = (visits - there <= TELLS[0] * there) & (support < TELLS[1] * seen_there)
    return are_scattered(support, against), is_of_two


def _is_elsewhere(chain: Chain, state: Chained) -> Bools:
    """Return which observations (n,) are about as far from their landmark as the nearest other."""
    other_m = nearest(cKDTree(state.positions), state.positions, 2)[0][:, 1]
    off_m = np.linalg.norm(off_by(chain, state), axis=1)
    return np.asarray(off_m > ELSEWHERE * other_m[chain.landmark])


def _residuals(
    rows: SegmentRows, table: LandmarkState, landmarks: Ints, positions: Floats, noise_m: float
) -> tuple[SegmentResiduals, MergeResiduals]:
    """Return the residuals of segments and merges."""
    whole = np.full((len(table), positions.shape[1]), np.nan)
    whole[landmarks] = positions
    chosen = np.zeros(len(table), dtype=bool)
    chosen[landmarks] = True
    landmark, none = table.now(rows.landmark), np.zeros(len(table), dtype=bool)
    joint, start = joint_rows(rows, whole, chosen, landmark, none)
    return residuals_of(rows, joint, start.placed, whole[joint.landmarks], noise_m)
