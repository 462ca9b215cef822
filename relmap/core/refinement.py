"""Joint least squares over all condensed segments: the step that the paper lacks.

A chain of groups drifts, and where it closes a loop only the landmarks seen again move.  Here all
observations count at once.  Where the robot was in each iteration is a nuisance variable, no motion
is estimated: what counts is where the landmarks come to lie relative to one another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid, fit_rigid_each, fixes_rotation
from relmap.core.condensing import LENGTH, SegmentRows
from relmap.core.jointequations import Equations, JointRows, equations
from relmap.core.tridiagonal import Factor

ROUNDS = 30
SETTLED = 1e-7
"""Step, as a share of the size of the map, at which the solution has settled."""
SLOW = 0.1
"""A step that leaves a larger share of the one before asks for a new factor."""

SURELY = 3.0
"""Standard deviations by which a variance must be larger to be taken for larger."""


@dataclass(frozen=True, eq=False)
class Refined:
    """A piece of the map on which all observations agree best.

    Attributes
    ----------
    landmarks : (m,) int64
    positions : (m, d) float64, metres
        In the frame of the robot in the anchor iteration.
    anchor_iteration : int
        The first iteration that saw enough of the landmarks to be fixed by them.
    noise_m : float
        Standard deviation of an observed coordinate, from what is left.
    """

    landmarks: NDArray[np.int64]
    positions: NDArray[np.float64]
    anchor_iteration: int
    noise_m: float
    _spread: Callable[[], NDArray[np.float64]]

    @cached_property
    def covariances(self) -> NDArray[np.float64]:
        """Of the errors of the positions (m, d, d), square metres, worked out when first asked."""
        return self._spread()


def refine(
    rows: SegmentRows,
    positions: NDArray[np.float64],
    chosen: NDArray[np.bool_],
    of: NDArray[np.int64],
) -> Refined | None:
    """Return where landmarks of one piece of the map lie by all observations.

    Parameters
    ----------
    rows : SegmentRows
    positions : (m, d) float64, metres
        The chained map to start from.
    chosen : (m,) bool
        The landmarks of the piece.
    of : (m,) int64
        The landmark that each number stands for, after merging.

    Returns
    -------
    Refined or None
        None where nothing is fixed.
    """
    joint = _joint_rows(rows, positions, chosen, of)
    anchor = _anchor(joint)
    if anchor is None:
        return None
    system = equations(joint, anchor)
    weight = np.ones(len(joint.points))
    refined, factor = _settled(system, joint, positions[joint.landmarks], weight)
    placed = _placed(joint, refined, weight)
    noise_m = _noise(rows, joint, system)
    iteration = int(rows.first_iteration[joint.segments[anchor[0]]]) + anchor[1]
    seen = (joint.segment == anchor[0]) & ((joint.visible >> anchor[1]) & 1 > 0)
    R, t = fit_rigid(joint.points[seen], refined[joint.landmark[seen]])
    R, t = R @ rows.R[iteration], R @ rows.t[iteration] + t

    def spread() -> NDArray[np.float64]:
        return np.asarray(noise_m**2 * R.T @ system.covariances(factor, placed, weight) @ R)

    return Refined(joint.landmarks, (refined - t) @ R, iteration, noise_m, spread)


def _joint_rows(
    rows: SegmentRows,
    positions: NDArray[np.float64],
    chosen: NDArray[np.bool_],
    of: NDArray[np.int64],
) -> JointRows:
    """Return the rows of the chosen landmarks, without segments that these do not fix."""
    landmark = of[rows.landmark]
    kept = np.flatnonzero(chosen[landmark])
    points, there, segment = rows.points[kept], positions[landmark[kept]], rows.segment[kept]
    _, _, fixed = fit_rigid_each(points, there, np.ones(len(kept)), segment, rows.n_segments)
    return JointRows.of_landmarks(rows, landmark, kept[fixed[segment]])


def _anchor(rows: JointRows) -> tuple[int, int] | None:
    """Return segment and bit of the first iteration that its landmarks fix."""
    for segment, (begin, end) in enumerate(zip(rows.begin[:-1], rows.begin[1:], strict=True)):
        for bit in range(LENGTH):
            seen = (rows.visible[begin:end] >> bit) & 1 > 0
            if fixes_rotation(rows.points[begin:end][seen]):
                return segment, bit
    return None


def _placed(
    rows: JointRows, positions: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the rows (n, d), each segment laid on the positions as it fits best."""
    there = positions[rows.landmark]
    R, t, _ = fit_rigid_each(
        rows.points, there, weight * rows.n_seen, rows.segment, len(rows.segments)
    )
    return np.asarray(np.einsum("nij,nj->ni", R[rows.segment], rows.points) + t[rows.segment])


def _settled(
    system: Equations,
    rows: JointRows,
    positions: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> tuple[NDArray[np.float64], Factor]:
    """Return the positions of the least sum of squares, and the factor of the last matrix."""
    size = np.abs(positions - positions.mean(axis=0)).max()
    factor, before = None, np.inf
    for _ in range(ROUNDS):
        placed = _placed(rows, positions, weight)
        right, matrix = system.normal(positions, placed, weight, with_matrix=factor is None)
        if factor is None:
            factor = Factor(system.levels, matrix)
        moved = system.moved(positions, placed, weight, factor.solve(right))
        step = np.abs(moved - positions).max()
        positions = moved
        if step <= SETTLED * size:
            break
        if step > SLOW * before:
            factor, step = None, np.inf
        before = step
    assert factor is not None
    return positions, factor


def _noise(rows: SegmentRows, joint: JointRows, system: Equations) -> float:
    """Return the standard deviation of an observed coordinate that explains what is left.

    Within segments and between them alike; but where segments surely agree less with one another
    than within, what is between them counts.
    """
    d = joint.points.shape[1]
    q = 3 * d - 3
    inside = np.isin(rows.segment, joint.segments)
    placed = np.isin(rows.iteration_segment, joint.segments).sum()
    within = d * (rows.n_seen[inside] - 1).sum() - q * (placed - len(joint.segments))
    between = d * (len(joint.points) - len(joint.landmarks)) - q * (len(joint.segments) - 1)
    squares, cost = rows.squares[joint.segments].sum(), system.cost.sum()
    variance = (squares + cost) / max(within + between, 1)
    if between > 0 and cost / between > (1 + SURELY * np.sqrt(2 / between)) * variance:
        variance = cost / between
    return float(np.sqrt(variance))
