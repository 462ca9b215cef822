"""Joint least squares over all condensed segments, an addition to the paper.

A chain of groups drifts, and a loop closure moves only the landmarks seen again. Here all
observations are used jointly. The robot pose of each iteration is a nuisance variable without a
motion model: only the relative positions of the landmarks matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation, place_each
from relmap.core.geometry.robust import EXACT, fit_robust_each
from relmap.core.map.pose import trajectory
from relmap.core.refinement.condensing import LENGTH, SegmentRows
from relmap.core.refinement.equations import SegmentProblem, SegmentState, segment_problem
from relmap.core.refinement.gauss_newton import Solution, settle, settle_again, size_of
from relmap.core.refinement.residuals import MergeResiduals, SegmentResiduals, residuals_of
from relmap.core.refinement.rows import JointRows
from relmap.core.refinement.trend import SURELY, by_landmark
from relmap.core.shown import Brief

CONFIRMED, AGAINST = 3, 0.5
"""Observations of a landmark in a segment that confirm it: wrong ids are seldom repeated; and the
weight below which they contradict the map."""
DISTRUSTED = 1e-4
"""Factor of the weight of others where a map is solved again from confirmed observations."""
EVERY = 16
"""Of so many segments one is fitted to place a scan without outliers."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Computes the covariances of some landmarks, transformed and scaled (d, d)."""

    problem: Any
    settled: Solution[Any]
    chosen: Bools
    scale: Floats

    def __call__(self) -> Floats:
        """Return the covariances, square metres; NaN for undetermined landmarks."""
        state = self.settled.state
        found = self.problem.covariances(state, self.settled.weight)
        found = np.asarray(self.scale.T @ found[self.chosen] @ self.scale)
        # Linearisation does not describe errors as large as the map.
        extent = np.ptp(state.positions[self.chosen], axis=0).max()
        found[np.trace(found, axis1=1, axis2=2) > found.shape[1] * extent**2] = np.nan
        return found

    @cached_property
    def _factor(self) -> Floats:
        return np.asarray(self.problem.factor(self.settled.state, self.settled.weight))

    def times(self, columns: Floats) -> Floats:
        """Return the products (m, d, c) of the covariance of all positions with columns (m, d, c).

        The landmarks are unknowns of the problem: `problem.unknown` is not None.
        """
        pattern, unknown = self.problem.pattern, self.problem.unknown[self.chosen]
        right = np.zeros((pattern.n_unknowns, columns.shape[2]))
        right[unknown] = self.scale @ columns
        return np.asarray(self.scale.T @ pattern.solve(self._factor, right)[unknown])

    def scaled(self, factor: float) -> Spread:
        """Return the same for standard deviations scaled by a factor."""
        return replace(self, scale=factor * self.scale)


@dataclass(frozen=True, eq=False, repr=False)
class Refined(Brief):
    """A submap at the joint optimum over all observations.

    `landmarks` (m,); `positions` (m, d), metres: in the robot frame of the anchor iteration.
    `anchor_iteration`: the first iteration whose landmarks determine its pose. `noise_m`: standard
    deviation of an observed coordinate, from the residuals. `power`: exponent p of the minimised
    sum of p-th powers of the residuals; 2 is least squares. `converged`: whether the least squares
    converged. Otherwise the positions are the best found, no worse than the initial ones.
    `n_outliers`: number of observations that noise does not explain. `n_contradicting`: of these,
    landmarks of segments that confirm them (`CONFIRMED`); 0 in maps that depend on odometry.
    """

    landmarks: Ints
    positions: Floats
    anchor_iteration: int
    noise_m: float
    segments: SegmentResiduals
    merges: MergeResiduals
    spread: Spread
    power: float = 2
    converged: bool = True
    n_outliers: int = 0
    n_contradicting: int = 0

    STATE = (
        "landmarks positions anchor_iteration noise_m segments merges power converged n_outliers "
        "n_contradicting covariances"
    )

    def __getstate__(self) -> dict[str, object]:
        """Copy the covariances, not the data from which they are computed."""
        return self.__dict__ | {"covariances": self.covariances, "spread": None}

    def only(self, own: Bools) -> Refined:
        """Return the same with some of the landmarks (m,); the residuals remain those of all."""
        chosen = self.spread.chosen.copy()
        chosen[chosen] = own
        spread = replace(self.spread, chosen=chosen)
        return replace(
            self, landmarks=self.landmarks[own], positions=self.positions[own], spread=spread
        )

    @cached_property
    def covariances(self) -> Floats:
        """Covariances of the position errors (m, d, d), square metres, computed on first access."""
        return self.spread()

    @property
    def is_exact(self) -> bool:
        """Whether all residuals are rounding, which contradicts nothing; covariances are, too."""
        return bool(self.noise_m <= EXACT * np.ptp(self.positions, axis=0).max())

    @property
    def has_joint_covariances(self) -> bool:
        """Whether landmarks were kept unknowns, as where few are in view."""
        return self.spread.problem.unknown is not None

    def joint_covariance(self, rows: Ints) -> Floats:
        """Return the covariance (k d, k d), square metres, of the landmarks in some rows (k,)."""
        (m, d), k = self.positions.shape, len(rows)
        columns = np.zeros((m, d, k, d))
        columns[rows, :, np.arange(k)] = np.eye(d)
        found = self.spread.times(columns.reshape(m, d, k * d))[rows]
        return np.asarray(found.reshape(k * d, k * d))


def refine(
    rows: SegmentRows,
    positions: Floats,
    chosen: Bools,
    of: Ints,
    others: Bools,
    since: int = 0,
    has_ids: bool = False,
) -> Refined | None:
    """Return the joint optimum of the landmarks of one submap over all observations.

    `positions` (m, d), metres: initial positions, from the chain of groups. `chosen` (m,): the
    landmarks of the submap. `of` (m,): the landmark that each number stands for, after merging.
    `others` (m,): static landmarks that are not mapped; they constrain the landmarks seen with
    them. `since`: iteration from which the anchor is chosen, if there is one. `has_ids`: whether
    ids are known; if some observations then contradict the optimum, it is solved for again from the
    confirmed ones. Returns None if the observations determine nothing.
    """
    landmark = of[rows.landmark]
    joint, start = joint_rows(rows, positions, chosen, landmark, others)
    anchor = _anchor(joint, rows.first_iteration, since) or _anchor(joint, rows.first_iteration)
    if anchor is None:
        return None
    problem = segment_problem(joint, size_of(start.positions), anchor)
    first = problem.of_segments(start)
    settled = settle(problem, first)
    if has_ids and (settled.weight < 1).any():
        trust = np.where(joint.n_seen >= CONFIRMED, 1.0, DISTRUSTED)
        settled = settle_again(problem, first, settled, trust)
    refined, weight = settled.state.positions, settled.weight
    placed = SegmentProblem(joint, 0.0).fitted(refined, weight).placed
    explained = (weight == 1).astype(np.float64)
    cost = problem.equations(settled.state, explained, with_matrix=False, damping=0.0).cost
    noise_m = _noise(rows, joint, cost, explained)
    mapped = chosen[joint.landmarks]
    near = _deciding(rows, joint, anchor[0], weight)
    iteration, R, t = _pose(near, joint, anchor, refined, mapped, of)
    return Refined(
        joint.landmarks[mapped],
        (refined[mapped] - t) @ R,
        iteration,
        noise_m,
        *residuals_of(rows, joint, (placed - t) @ R, (refined - t) @ R, noise_m),
        Spread(problem, settled, mapped, noise_m * R),
        converged=settled.converged,
        n_outliers=int(joint.n_seen[weight < 1].sum()),
        n_contradicting=_n_contradicting(joint, weight),
    )


def _n_contradicting(joint: JointRows, weight: Floats) -> int:
    """Return the number of confirmed rows of low weight (n,)."""
    return int(np.sum((joint.n_seen >= CONFIRMED) & (weight < AGAINST)))


def placed_segments(
    rows: SegmentRows, positions: Floats, kept: Bools, landmark: Ints
) -> tuple[Floats, Bools, Floats]:
    """Return all rows (n, d), with each segment fitted to its kept rows (n,).

    Also which rows are determined (n,), and the weights (k,) of the kept ones in the robust fit.
    """
    at, n_seen = rows.segment[kept], rows.n_seen[kept].astype(np.float64)
    there = positions[landmark[kept]]
    R, t, fixed, weight = fit_robust_each(rows.points[kept], there, n_seen, at, rows.n_segments)
    return place_each(R, t, rows.segment, rows.points), fixed[rows.segment], weight


def joint_rows(
    rows: SegmentRows, positions: Floats, chosen: Bools, landmark: Ints, others: Bools
) -> tuple[JointRows, SegmentState]:
    """Return the rows of a submap and of others seen with it, and their initial positions.

    Segments not determined by the submap are left out.
    """
    mapped = chosen[landmark]
    placed, fixed, _ = placed_segments(rows, positions, mapped, landmark)
    known = fixed & (mapped | others[landmark])
    n_seen = np.bincount(landmark[known], weights=rows.n_seen[known], minlength=len(positions))
    known &= n_seen[landmark] > 1
    start = positions.copy()
    loose = np.flatnonzero(known & ~mapped)
    for number, of in by_landmark(landmark[loose], placed[loose]):
        start[number] = np.median(placed[loose[of]], axis=0)
    joint = JointRows.of_landmarks(rows, landmark, np.flatnonzero(known))
    return joint, SegmentState(start[joint.landmarks], placed[known])


def _anchor(rows: JointRows, first_iteration: Ints, since: int = 0) -> tuple[int, int] | None:
    """Return segment and bit of the first iteration, not before `since`, that is determined."""
    begun = first_iteration[rows.segments]
    for segment, (begin, end) in enumerate(zip(rows.begin[:-1], rows.begin[1:], strict=True)):
        for bit in range(max(since - int(begun[segment]), 0), LENGTH):
            seen = (rows.visible[begin:end] >> bit) & 1 > 0
            if fixes_rotation(rows.points[begin:end][seen]):
                return segment, bit
    return None


def _deciding(rows: SegmentRows, joint: JointRows, segment: int, weight: Floats) -> SegmentRows:
    """Return rows that decide the pose of a scan of a segment of `joint`, rows of weights (n,).

    Those of other segments only show beyond which distance an observation is an outlier. If there
    is none in the segment, a few of them are enough.
    """
    if (weight[joint.segment == segment] < 1).any():
        return rows
    own = joint.segments[segment]
    return rows.only(np.flatnonzero(rows.segment % EVERY == own % EVERY))


def _pose(
    rows: SegmentRows,
    joint: JointRows,
    anchor: tuple[int, int],
    refined: Floats,
    mapped: Bools,
    of: Ints,
) -> tuple[int, Floats, Floats]:
    """Return an iteration (segment, bit), and rotation and translation of the robot in it.

    As the trajectory shows it, which is robust to outliers, where mapped landmarks determine it.
    `refined` (k, d), metres, and `mapped` (k,): of the landmarks of `joint`; `of`: as for `refine`.
    """
    iteration = int(rows.first_iteration[joint.segments[anchor[0]]]) + anchor[1]
    d, positions = refined.shape[1], np.full((len(of), refined.shape[1]), np.nan)
    positions[joint.landmarks[mapped]] = refined[mapped]
    pose = trajectory(rows, positions, of)[iteration]
    if np.isfinite(pose[0, 0]):
        return iteration, pose[:d, :d], pose[:d, 3]
    seen = (joint.segment == anchor[0]) & ((joint.visible >> anchor[1]) & 1 > 0)
    R, t = fit_rigid(joint.points[seen], refined[joint.landmark[seen]])
    return iteration, R @ rows.R[iteration], R @ rows.t[iteration] + t


def _noise(rows: SegmentRows, joint: JointRows, cost: float, weight: Floats) -> float:
    """Return the standard deviation of an observed coordinate that explains the residuals.

    It is pooled from the residuals within and between segments; if the latter are significantly
    larger, only they are used. Only inlier rows, with weights (n,) of 1, are used.
    """
    d = joint.points.shape[1]
    q = 3 * d - 3
    within = rows.freedoms[joint.segments].sum()
    between = d * (weight.sum() - len(joint.landmarks)) - q * (len(joint.segments) - 1)
    squares = rows.squares[joint.segments].sum()
    variance = (squares + cost) / max(within + between, 1)
    if between > 0 and cost / between > (1 + SURELY * np.sqrt(2 / between)) * variance:
        variance = cost / between
    return float(np.sqrt(variance))
