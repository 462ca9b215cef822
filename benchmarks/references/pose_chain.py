"""Batch least squares over observations with ids and odometry, in the plane: a reference.

It shares no code with the mapper's refinement.  Unknown are all poses, all landmarks and odometry's
constant errors (scale of distances and of turns, turn missed per metre).  The cost is
Cauchy's, of the observations and of the steps of odometry, each in its standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CAUCHY = 7.0
"""Standard deviations where Cauchy's weight is a half, and Huber's 0.7."""
CONSTANT = 0.03
"""Standard deviation of each constant error."""
CHUNK = 100
"""Number of scans placed by odometry at a time, before all are solved again."""
ROUGH, FINE = 1e-3, 1e-7
"""Relative gain of the cost below which the start, and the solution, has converged."""
HELD = 1e12
"""Information that fixes the first pose, or a given landmark."""
MOST_DAMPED = 1e4


class Problem(NamedTuple):
    """A log: `k` poses, `n` observations of `m` landmarks.

    Attributes
    ----------
    points : (n, 2) float64, robot frame, metres
    pose, landmark : (n,) int64
    roots : (n, 2, 2) float64
        Each scales a residual to unit covariance.
    motion : (k, 3) float64
        Odometry x, y, yaw from the pose before to each; NaN where unknown.
    sd : (k, 2) float64
        Its standard deviations: of a coordinate, metres, and of the yaw, radians.
    """

    points: Floats
    pose: Ints
    landmark: Ints
    roots: Floats
    motion: Floats
    sd: Floats

    def between(self, begin: int, end: int) -> Problem:
        """Return the part of poses begin:end; landmarks keep their numbers."""
        seen = (self.pose >= begin) & (self.pose < end)
        motion = self.motion[begin:end].copy()
        motion[:1] = np.nan
        return Problem(
            self.points[seen],
            self.pose[seen] - begin,
            self.landmark[seen],
            self.roots[seen],
            motion,
            self.sd[begin:end],
        )


@dataclass(frozen=True, eq=False)
class State:
    """Poses (k, 3) x, y, yaw; landmarks (m, 2), NaN if not placed; constant errors (3,); cost."""

    poses: Floats
    landmarks: Floats
    constant: Floats
    cost: float = np.inf


class Loss(NamedTuple):
    """Cost of squared residuals (n,), and the weight of each in least squares."""

    cost: Callable[[Floats], Floats]
    weight: Callable[[Floats], Floats]


SQUARE = CAUCHY**2
ROBUST = Loss(
    lambda squares: SQUARE * np.log1p(squares / SQUARE), lambda squares: 1 / (1 + squares / SQUARE)
)
"""Cauchy's."""
CONVEX = Loss(
    lambda squares: 2 * SQUARE * (np.sqrt(1 + squares / SQUARE) - 1),
    lambda squares: 1 / np.sqrt(1 + squares / SQUARE),
)
"""Huber's, smoothed: it has fewer local minima."""


def start(problem: Problem) -> State:
    """Return a start: the scans are placed by odometry, a chunk at a time, and solved each time.

    Stretches not connected by odometry are solved one by one, and aligned by the landmarks that
    they share.
    """
    cuts = np.flatnonzero(np.isnan(problem.motion[:, 0])).tolist()
    begins = [*sorted({0, *cuts}), len(problem.motion)]
    whole: State | None = None
    for begin, end in pairwise(begins):
        part = _stretch(problem.between(begin, end), int(problem.landmark.max()) + 1)
        whole = part if whole is None else _joined(whole, part)
    assert whole is not None
    return whole


def solved(
    problem: Problem,
    state: State,
    given: Floats | None = None,
    fine: float = FINE,
    loss: Loss = ROBUST,
) -> State:
    """Return the state of least cost, found from another one.

    Parameters
    ----------
    problem : Problem
    state : State
    given : (m, 2) float64, optional
        Landmarks with fixed positions; NaN for the others.
    fine : float
        Relative gain below which it is finished.
    loss : Loss
    """
    if given is not None:
        here = np.where(np.isfinite(given), given, state.landmarks)
        state = replace(state, landmarks=here)
    state = replace(state, cost=_cost(problem, state, loss))
    damping = 0.0
    while damping < MOST_DAMPED:
        after = _stepped(problem, state, damping, given, loss)
        if after.cost > state.cost:
            damping = max(10 * damping, 1e-4)
            continue
        gain = state.cost - after.cost
        state, damping = after, damping / 10 if damping > 1e-4 else 0.0
        if gain < fine * state.cost:
            break
    return state


def _stretch(problem: Problem, m: int) -> State:
    k = len(problem.motion)
    state = State(np.zeros((k, 3)), np.full((m, 2), np.nan), np.zeros(3))
    for begin in range(0, k, CHUNK):
        end = min(begin + CHUNK, k)
        for i in range(max(begin, 1), end):
            state.poses[i] = _moved(state.poses[i - 1], problem.motion[i], state.constant)
        part = problem.between(0, end)
        landmarks = placed(part, state)
        found = solved(
            part, State(state.poses[:end], landmarks, state.constant), None, ROUGH, CONVEX
        )
        state = replace(state, landmarks=found.landmarks, constant=found.constant)
        state.poses[:end] = found.poses
    return state


def _moved(pose: Floats, motion: Floats, constant: Floats) -> Floats:
    x, y, yaw = motion
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    ahead = np.array([cos * x - sin * y, sin * x + cos * y]) / (1 + constant[0])
    turn = (yaw + np.hypot(x, y) * constant[2]) / (1 + constant[1])
    return np.append(pose[:2] + ahead, pose[2] + turn)


def placed(problem: Problem, state: State) -> Floats:
    """Return the landmarks, new ones at their first observation."""
    R = _rotations(state.poses[problem.pose, 2])
    seen = np.einsum("nij,nj->ni", R, problem.points) + state.poses[problem.pose, :2]
    own, first = np.unique(problem.landmark, return_index=True)
    landmarks = state.landmarks.copy()
    new = np.isnan(landmarks[own, 0])
    landmarks[own[new]] = seen[first[new]]
    return landmarks


def _joined(whole: State, part: State) -> State:
    """Return both, the second aligned to the landmarks of the first."""
    shared = np.isfinite(whole.landmarks[:, 0]) & np.isfinite(part.landmarks[:, 0])
    R, t = laid_on(part.landmarks[shared], whole.landmarks[shared])
    turn = np.arctan2(R[1, 0], R[0, 0])
    poses = np.column_stack([part.poses[:, :2] @ R.T + t, part.poses[:, 2] + turn])
    landmarks = np.where(np.isfinite(whole.landmarks), whole.landmarks, part.landmarks @ R.T + t)
    return State(np.concatenate([whole.poses, poses]), landmarks, whole.constant)


def laid_on(source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return the rotation and translation that best align points (n, 2) to others."""
    here, there = source - source.mean(axis=0), target - target.mean(axis=0)
    turn = np.arctan2(
        np.sum(here[:, 0] * there[:, 1] - here[:, 1] * there[:, 0]), np.sum(here * there)
    )
    R = _rotations(np.array([turn]))[0]
    return R, target.mean(axis=0) - R @ source.mean(axis=0)


def _rotations(yaw: Floats) -> Floats:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([np.stack([cos, -sin], 1), np.stack([sin, cos], 1)], 1)


class _Rows(NamedTuple):
    """Residuals (n, r) of one kind, their Jacobians (n, r, c), and the unknowns (n, c) of these."""

    residual: Floats
    jacobian: Floats
    unknown: Ints


def _rows(problem: Problem, state: State) -> Iterator[_Rows]:
    k = len(problem.motion)
    pose, landmark = problem.pose, problem.landmark
    away = state.landmarks[landmark] - state.poses[pose, :2]
    back = np.swapaxes(_rotations(state.poses[pose, 2]), 1, 2)
    across = np.column_stack([away[:, 1], -away[:, 0]])
    by_yaw = np.einsum("nij,nj->ni", back, across)
    jacobian = np.concatenate([-back, by_yaw[:, :, None], back], axis=2)
    residual = np.einsum("nij,nj->ni", back, away) - problem.points
    unknown = np.column_stack(
        [3 * pose[:, None] + np.arange(3), 3 * k + 2 * landmark[:, None] + np.arange(2)]
    )
    yield _Rows(np.einsum("nij,nj->ni", problem.roots, residual), problem.roots @ jacobian, unknown)
    b = np.flatnonzero(np.isfinite(problem.motion[:, 0]))
    a, motion = b - 1, problem.motion[b]
    scale, turn_scale, per_m = state.constant
    between = state.poses[b, :2] - state.poses[a, :2]
    back = np.swapaxes(_rotations(state.poses[a, 2]), 1, 2)
    went, turned = np.einsum("nij,nj->ni", back, between), state.poses[b, 2] - state.poses[a, 2]
    way = np.hypot(motion[:, 0], motion[:, 1])
    off = (1 + turn_scale) * _wrapped(turned) - motion[:, 2] - per_m * way
    residual = np.column_stack([(1 + scale) * went - motion[:, :2], _wrapped(off)])
    jacobian = np.zeros((len(b), 3, 9))
    jacobian[:, :2, :2], jacobian[:, :2, 3:5] = -(1 + scale) * back, (1 + scale) * back
    across = np.column_stack([between[:, 1], -between[:, 0]])
    jacobian[:, :2, 2] = (1 + scale) * np.einsum("nij,nj->ni", back, across)
    jacobian[:, 2, 2], jacobian[:, 2, 5] = -(1 + turn_scale), 1 + turn_scale
    jacobian[:, :2, 6], jacobian[:, 2, 7], jacobian[:, 2, 8] = went, _wrapped(turned), -way
    sd = problem.sd[b][:, [0, 0, 1]]
    last = 3 * k + 2 * len(state.landmarks) + np.arange(3)
    unknown = np.concatenate([3 * a[:, None] + np.arange(6), np.tile(last, (len(b), 1))], axis=1)
    yield _Rows(residual / sd, jacobian / sd[:, :, None], unknown)


def _wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _cost(problem: Problem, state: State, loss: Loss) -> float:
    cost = float(np.sum((state.constant / CONSTANT) ** 2))
    for rows in _rows(problem, state):
        squares = np.sum(rows.residual**2, axis=1)
        cost += float(loss.cost(squares).sum())
    return cost


def _stepped(
    problem: Problem, state: State, damping: float, given: Floats | None, loss: Loss
) -> State:
    """Return the state after a damped step of iteratively reweighted least squares."""
    k, m = len(state.poses), len(state.landmarks)
    size = 3 * k + 2 * m + 3
    matrix: Any = sparse.csc_array((size, size))
    right = np.zeros(size)
    for rows in _rows(problem, state):
        weight = np.sqrt(loss.weight(np.sum(rows.residual**2, axis=1)))
        jacobian, residual = rows.jacobian * weight[:, None, None], rows.residual * weight[:, None]
        n, r, c = jacobian.shape
        columns = np.broadcast_to(rows.unknown[:, None], (n, r, c)).ravel()
        J = sparse.csr_array(
            (jacobian.ravel(), columns, np.arange(0, n * r * c + 1, c)), shape=(n * r, size)
        )
        matrix = matrix + J.T @ J
        right -= J.T @ residual.ravel()
    held = np.zeros(size)
    held[-3:] = CONSTANT**-2
    right[-3:] -= state.constant / CONSTANT**2
    if given is None:
        held[:3] = HELD
    else:
        held[3 * k : -3] = np.where(np.isfinite(given), HELD, 0.0).ravel()
    held += damping * matrix.diagonal() + 1e-9
    options = {"SymmetricMode": True}
    solver = splu(
        (matrix + sparse.diags_array(held)).tocsc(), "MMD_AT_PLUS_A", 0.0, options=options
    )
    step = solver.solve(right)
    landmarks = state.landmarks + step[3 * k : -3].reshape(m, 2)
    if given is not None:
        landmarks = np.where(np.isfinite(given), given, landmarks)
    after = State(state.poses + step[: 3 * k].reshape(k, 3), landmarks, state.constant + step[-3:])
    return replace(after, cost=_cost(problem, after, loss))
