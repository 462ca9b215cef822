"""Joint least squares over all observations of walls and corners.

A partially seen wall constrains the rotation and the distance across, but not the position along
itself. Points with isotropic weights cannot represent this, so walls have their own residuals: the
distances of two points of each observation from the wall's line, and the position of each static
corner along the line. Where needed, odometry constrains pairs of poses
(`relmap.planes.odometry.steps`).
"""

from __future__ import annotations

from copy import copy
from functools import partial

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.gauss_newton import gauss_newton
from relmap.core.refinement.schur import Elimination, Linearised, NormalEquations
from relmap.planes.walls.assembly import WallEquations, Walls

MOST = 0.9
ROUNDING = 1e-13
"""Residuals up to this fraction of the largest coordinate are treated as rounding."""
SPREAD = 1 / np.sqrt(12)
"""Positions of the two points that represent a wall, in sizes from its middle. A line fitted to
points spread evenly over the wall is as accurate as one fitted to these two, each with twice the
variance of the middle."""
STRETCH = 8
"""Number of scans whose equations are summed before they go to the sparse matrix."""
MUCH = 0.25
"""A corner seen in a smaller fraction of the stretches that saw its wall is a block by itself."""
LOOSE_POSE, LOOSE, LEAST = 1e-10, 1e-12, 1e-9
"""Damping of poorly determined poses and other unknowns, as a fraction of the diagonal, and in
weights of an observation."""
FARTHEST, FARTHEST_RAD = 1.0, np.pi / 2
"""Largest step of a pose, in sizes of the map, and largest rotation."""
UNSURE = 1e-3
"""Gain per unknown, in squared standard deviations, below which to stop."""
REST = 0.03
"""Steps longer than this, metres and radians, indicate that the solution does not converge."""
USUAL = 3.0
"""A residual below this multiple of the typical one, of all or of its scan, is not an outlier."""

Seen = tuple[Floats, Ints, Ints, Ints]


class WallSystem:
    """The residuals of the walls of one set of observations, poses eliminated; a `Problem`.

    `given`: equations in the order of iterations. `held`: damping of poses, walls and corners in
    each step, as a fraction of the diagonal; if not 0, steps that increase the cost are rejected.
    Undamped steps straighten long chains in a few rounds, but drift in weakly determined
    directions, as along a corridor.

    Attributes: `settled`: whether the last step that `refine` took was short.
    """

    def __init__(self, given: WallEquations, held: float = 0.0) -> None:
        self.settled, self._held = False, held
        self._latest: tuple[Walls, Linearised] | None = None
        self._set(given)
        self._rows, self._factors = _seen(given), given.odometry
        self._iteration = np.concatenate([self._rows[1], given.odometry.iteration])
        scans = np.unique(self._rows[1])
        self._scan = np.searchsorted(scans, self._iteration).clip(max=len(scans) - 1)
        self._prepare(given)

    def _set(self, given: WallEquations) -> None:
        sd = np.sqrt(2) * given.sd
        self._sd = np.concatenate([sd, sd, given.corner_sd, given.odometry.residual_sd])
        least_m = ROUNDING * float(np.abs(given.ends).max())
        self.rounding = float(np.sum((least_m / self._sd) ** 2))

    def refine(self, state: Walls, rounds: int, doubtful: float, by_scan: bool = True) -> Walls:
        """Return the optimal state by damped Gauss-Newton.

        The first iteration is fixed.

        `state`: initial state; `rounds`: maximum number of steps; `doubtful`: residual, in standard
        deviations, above which the weight decreases (Geman and McClure, 1987): a wrongly associated
        wall should have no influence; `by_scan`: whether a scan with large residuals overall is
        treated as not yet converged instead of wrong.
        """
        weigh = partial(self._weights, doubtful=doubtful, by_scan=by_scan)
        unsure, monotone = UNSURE * self._n_unknowns, self._held > 0
        found = gauss_newton(
            self, state, weigh, rounds, unsure=unsure, monotone=monotone, reuse=False
        )
        self.settled = False
        if found.last is not None:
            step = np.abs(_unknowns(found.state) - _unknowns(found.last))
            most = int(MOST * len(step))
            self.settled = bool(np.partition(step, most)[most] < REST)
        return found.state

    def reweighted(self, given: WallEquations) -> WallSystem:
        """Return the system of the same observations with other standard deviations."""
        system = copy(self)
        system._set(given)
        return system

    def residuals(self, state: Walls) -> Floats:
        """Return the deviations of points and corners, in standard deviations."""
        return np.asarray(self._linearised(state).off / self._sd)

    def off(self, state: Walls) -> tuple[Floats, Floats]:
        """Return the deviations of walls (n, 2), at two points, and of corners (k,)."""
        off = self._linearised(state).off[: len(self._rows[1])]
        return _by_kind(off, len(self._rows[3]))

    def equations(
        self, state: Walls, weight: Floats, with_matrix: bool, damping: float
    ) -> NormalEquations:
        """Return the normal equations of walls and corners."""
        equations = self._poses.equations(
            self._linearised(state),
            weight / self._sd**2,
            LOOSE_POSE + self._held + damping,
            with_matrix,
        )
        if with_matrix:
            self.pattern.hold(equations.matrix, LOOSE + self._held + damping, LEAST)
        return equations

    def stepped(
        self, state: Walls, equations: NormalEquations, step: Floats, weight: Floats
    ) -> Walls | None:
        """Return the state after a step; None if the step is too long."""
        poses = equations.eliminated_steps(step)
        everywhere = np.concatenate([state.t, state.centre])
        farthest_m = FARTHEST * float(np.ptp(everywhere, axis=0).max())
        too_far = np.abs(poses[:, 1:]).max() > farthest_m
        if too_far or np.abs(poses[:, 0]).max() > FARTHEST_RAD:
            return None
        return Walls(
            state.yaw + poses[:, 0],
            state.t + poses[:, 1:],
            state.centre,
            state.angle + step[self._line],
            state.across + step[self._line + 1],
            state.along + step[self._place],
        )

    def corner_covariances(self, state: Walls, doubtful: float) -> Floats:
        """Return the covariances of the line and position of each corner; (c, 3, 3).

        For the direction of the normal, radians, the distance across and the position along,
        metres, with the first iteration fixed.
        """
        weight = self._weights(self.residuals(state), doubtful, by_scan=False)
        values = self.equations(state, weight, with_matrix=True, damping=0.0).matrix
        wall, (_, _, of, corner) = np.zeros(len(state.along), dtype=np.int64), self._rows
        wall[corner] = of[len(of) - len(corner) :]
        line = self._line[wall]
        self.pattern.factorise(values)
        chosen = np.column_stack([line, line + 1, self._place])
        return self.pattern.parts(self.pattern.inverse(values), chosen)

    def _weights(self, residual: Floats, doubtful: float, by_scan: bool) -> Floats:
        """Return the weights of residuals that treat large ones as outliers."""
        from relmap.core.linalg.order_kernels import medians

        size, n = np.abs(residual), len(self._rows[1])
        typical = np.median(size[:n])  # for walls: initially, the map may come from odometry
        if by_scan:
            typical = np.maximum(typical, medians(self._scan[:n], size[:n]))[self._scan]
        return np.asarray(1 / (1 + (size / np.maximum(doubtful, USUAL * typical)) ** 2) ** 2)

    def _linearised(self, state: Walls) -> Linearised:
        """Return residuals and Jacobians; those of the last state are cached."""
        if self._latest is None or self._latest[0] is not state:
            found = _linearised(state, self._rows)
            if len(self._factors):
                found = self._factors.added_to(found, state.yaw, state.t)
            self._latest = state, found
        return self._latest[1]

    def _prepare(self, given: WallEquations) -> None:
        """Determine the blocks of unknowns and their positions in the equations.

        A wall and its corners form a block; the unknowns seen in a stretch form a clique.
        """
        n_walls, stretch = int(given.wall.max()) + 1, given.iteration // STRETCH
        width, block, place = _blocks(given, stretch, n_walls)
        meeting = np.tile(len(width) + np.arange(len(given.odometry)), 2)
        width = np.append(width, np.full(len(given.odometry), 3))
        seen = np.concatenate([given.wall, block[given.corner], meeting])
        both = given.odometry.both.T.ravel() // STRETCH
        at = np.concatenate([stretch, stretch[given.corner_row], both])
        self.pattern = Pattern.of_pairs(width, at, seen)
        first = self.pattern.first
        self._line, self._place = first[:n_walls], first[block] + place
        other = np.concatenate([self._line[given.wall] + 1] * 2 + [self._place[given.corner]])
        unknown = np.column_stack([self._line[self._rows[2]], other])
        met = (first[meeting][:, None] + np.arange(3)).ravel()
        unknown = np.concatenate([unknown, np.column_stack([met, met])])
        iteration = self._iteration
        poses = np.arange(given.n_iterations)
        rows = np.argsort(iteration, kind="stable")
        starts = np.searchsorted(iteration[rows], np.append(poses, len(poses)))
        free = (poses > 0).astype(np.float64)
        self._poses = Elimination(self.pattern, unknown, starts, rows, poses // STRETCH, free=free)
        self._n_unknowns = self.pattern.n_unknowns + 3 * (len(poses) - 1)
        self.freedoms = max(len(iteration) - self._n_unknowns, 1)


def _unknowns(state: Walls) -> Floats:
    return np.concatenate([state.yaw, state.t.ravel(), state.angle, state.across, state.along])


def wall_residuals(given: WallEquations, state: Walls) -> tuple[Floats, Floats]:
    """Return the deviations of walls (n, 2), at two points, and of corners (k,)."""
    return _by_kind(_linearised(state, _seen(given)).off, len(given.corner))


def _by_kind(off: Floats, n_corners: int) -> tuple[Floats, Floats]:
    """Return the residuals of walls (n, 2) and of corners (k,)."""
    walls, corners = np.split(off, [len(off) - n_corners])
    return walls.reshape(2, -1).T, corners


def _seen(given: WallEquations) -> Seen:
    """Return points (r, 2), robot frame: two of each wall, and the corners; and their walls."""
    n = len(given.iteration)
    row = np.concatenate([np.arange(n), np.arange(n), given.corner_row])
    middle = given.ends.mean(axis=1)
    reach = SPREAD * (given.ends[:, 1] - given.ends[:, 0])
    corners = given.ends[given.corner_row, given.corner_end]
    points = np.concatenate([middle - reach, middle + reach, corners])
    return points, given.iteration[row], given.wall[row], given.corner


def _linearised(state: Walls, seen: Seen) -> Linearised:
    """Return the residuals, and their Jacobians by the pose and by walls and corners."""
    from relmap.planes.refinement.system_kernels import linearised

    walls = state.centre, state.angle, state.across, state.along
    return Linearised(*linearised(seen, (state.yaw, np.ascontiguousarray(state.t)), walls))


def _blocks(given: WallEquations, stretch: Ints, n_walls: int) -> tuple[Ints, Ints, Ints]:
    """Return the size of each block, and the block and offset of each corner (c,).

    The first blocks are the walls, with the corners seen in most observations of them; other
    corners are separate, so that they are not coupled to everything seen with the wall.
    """
    n_corners = int(given.corner.max(initial=-1)) + 1
    wall = np.zeros(n_corners, dtype=np.int64)
    wall[given.corner] = given.wall[given.corner_row]
    times = np.bincount(np.unique(stretch * n_walls + given.wall) % n_walls, minlength=n_walls)
    key = stretch[given.corner_row] * n_corners + given.corner
    corner_times = np.bincount(np.unique(key) % max(n_corners, 1), minlength=n_corners)
    alone = corner_times < MUCH * times[wall]
    with_wall = np.bincount(wall[~alone], minlength=n_walls)
    block = np.where(alone, n_walls + np.cumsum(alone) - 1, wall)
    place, rows = np.zeros(n_corners, dtype=np.int64), np.flatnonzero(~alone)
    rows = rows[np.argsort(wall[rows], kind="stable")]
    place[rows] = 2 + np.arange(len(rows)) - (np.cumsum(with_wall) - with_wall)[wall[rows]]
    return np.append(2 + with_wall, np.ones(alone.sum(), dtype=np.int64)), block, place
