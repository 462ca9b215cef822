"""Joint least squares over all observations of walls and corners.

A wall seen in part says nothing along itself, however often it is seen, but all the more about the
turn and the distance across.  Points of equal weight in all directions cannot say this, so walls
have equations of their own: each observation of a wall tells how far from the wall's line two of
its points are, and each static corner how far along the line it is.  Where the robot was is a
nuisance, as in `relmap.core.refinement.joint`.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.cholesky import Pattern
from relmap.planes.equations import WallEquations, Walls, between_neighbours, open_along

SETTLED = 0.01
"""Step, in typical standard deviations, of a settled solution: most unknowns do no more."""
MOST = 0.9
NEAR = 0.005
"""Step, metres and radians, of a solution that is good enough to go on from with other weights."""
SPREAD = 1 / np.sqrt(12)
"""Where the two points are that stand for a wall: so many sizes from its middle, either way.

A line fitted to points spread evenly over the wall is as sure as if it were fitted to these two,
each twice as uncertain (in variance) as the middle."""
STRETCH = 8
"""Scans whose equations are added up before they go to the sparse matrix; most see the same."""
MUCH = 0.25
"""A corner seen in a smaller share of the stretches in which its wall was is a block by itself."""
LOOSE, LEAST = 1e-12, 1e-9
"""What holds an unknown that hangs by too little, as a share of what holds it otherwise, and in
weights of an observation."""
FIRMER, FIRMEST = 1e3, 1.0
"""By how much it is held more firmly where a step is not taken, and when no more."""
FARTHEST, FARTHEST_RAD = 1.0, np.pi / 2
"""No step moves a pose farther than so many sizes of the map, nor turns it by more."""
REST = 0.03
"""Steps longer than this, metres and radians, are those of a solution that does not settle."""

Weights = tuple[NDArray[np.float64], NDArray[np.float64]]


class WallSystem:
    """The equations of the walls of one set of observations, poses eliminated.

    Parameters
    ----------
    given : WallEquations
        In the order of iterations.

    Attributes
    ----------
    settled : bool
        Whether the last steps that `refine` took were short.
    """

    def __init__(self, given: WallEquations) -> None:
        self._given = given
        self.settled = False
        self._seen = _seen(given)
        self._open_along = open_along(given)
        every = np.arange(given.iteration[-1] + 2)
        self._begin = np.searchsorted(given.iteration, every)
        self._corner_begin = np.searchsorted(given.iteration[given.corner_row], every)
        self._prepare()

    def refine(
        self,
        state: Walls,
        rounds: int,
        doubtful: float,
        by_scan: bool = True,
        settled: bool = True,
    ) -> Walls:
        """Return the state on which all observations agree best, by damped Gauss-Newton.

        The first iteration stays where it is.

        Parameters
        ----------
        state : Walls
            Where to start.
        rounds : int
            Most steps.
        doubtful : float
            Residual, in standard deviations, from which one counts less and less (Geman and
            McClure, 1987): a wall taken for another one should not count at all.
        by_scan : bool
            Whether a scan that is off as a whole is taken for misplaced as yet, rather than wrong.
        settled : bool
            Whether it should settle, rather than come near only.
        """
        from relmap.core.linalg.order_kernels import smallest

        enough = SETTLED * float(np.median(self._given.sd)) if settled else NEAR
        self.settled = False
        for _ in range(rounds):
            stepped = self._stepped(state, doubtful, by_scan)
            if stepped is None:
                break
            state, step = stepped
            typical = smallest(step, int(MOST * len(step)))
            self.settled = typical < REST
            if typical < enough:
                break
        return between_neighbours(state, self._open_along)

    def reweighted(self, given: WallEquations) -> WallSystem:
        """Return the system of the same observations with other standard deviations."""
        system = copy(self)
        system._given = given
        return system

    def residuals(self, state: Walls) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how far walls (n, 2), at two points, and corners (k,) are from their places."""
        from relmap.planes.refinement_kernels import residuals

        return residuals(self._seen, _arrays(state))

    def _stepped(
        self, state: Walls, doubtful: float, by_scan: bool
    ) -> tuple[Walls, NDArray[np.float64]] | None:
        """Return the next state and the step to it; None where none is short enough.

        All unknowns are held the more firmly until one is (Levenberg-Marquardt).
        """
        weights = self._weights(state, doubtful, by_scan)
        everywhere = np.concatenate([state.t, state.centre])
        farthest_m, firmer = FARTHEST * float(np.ptp(everywhere, axis=0).max()), 1.0
        while LOOSE * firmer <= FIRMEST:
            poses, lines, corners = self._step(state, weights, firmer)
            after = Walls(
                state.yaw + poses[:, 0],
                state.t + poses[:, 1:],
                state.centre,
                state.angle + lines[:, 0],
                state.across + lines[:, 1],
                state.along + corners,
            )
            step = np.abs(np.concatenate([poses.ravel(), lines.ravel(), corners]))
            if (
                np.abs(poses[:, 1:]).max() <= farthest_m
                and np.abs(poses[:, 0]).max() <= FARTHEST_RAD
            ):
                return after, step
            firmer *= FIRMER
        return None

    def corner_covariances(self, state: Walls, doubtful: float) -> NDArray[np.float64]:
        """Return how sure each corner's wall and place are; (c, 3, 3).

        Of the direction of the normal, radians, the distance across and the place along, metres,
        with the first iteration where it is.
        """
        values = self._equations(state, self._weights(state, doubtful, by_scan=False), 1.0)[0]
        wall = np.zeros(len(state.along), dtype=np.int64)
        wall[self._given.corner] = self._given.wall[self._given.corner_row]
        line = self._line[wall]
        self._pattern.factorise(values)
        chosen = np.column_stack([line, line + 1, self._corner])
        return self._pattern.parts(self._pattern.inverse(values), chosen)

    def _weights(self, state: Walls, doubtful: float, by_scan: bool) -> Weights:
        """Return the weights of walls and corners where their residuals put them in doubt."""
        from relmap.planes.refinement_kernels import observation_weights

        sd = np.sqrt(2) * self._given.sd, self._given.corner_sd
        begins = self._begin, self._corner_begin
        return observation_weights(self.residuals(state), sd, begins, doubtful, by_scan)

    def _step(
        self, state: Walls, weights: Weights, firmer: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the step of poses (i, 3), lines (w, 2) and corners (c,), held so much firmer."""
        from relmap.planes.refinement_kernels import pose_steps

        values, right, away, alone = self._equations(state, weights, firmer)
        self._pattern.factorise(values)
        step = self._pattern.solve(values, right)
        poses = pose_steps(self._stretches, away, alone, step)
        return poses, step[self._line[:, None] + [0, 1]], step[self._corner]

    def _equations(
        self, state: Walls, weights: Weights, firmer: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the matrix and what else `wall_equations` gives."""
        from relmap.planes.refinement_kernels import wall_equations

        begins, values = (self._begin, self._corner_begin), np.zeros(self._pattern.size)
        right, away, alone = wall_equations(
            self._seen,
            _arrays(state),
            weights,
            begins,
            self._open_along,
            self._stretches,
            values,
            firmer,
        )
        self._pattern.hold(values, LOOSE * firmer, LEAST)
        return values, right, away, alone

    def _prepare(self) -> None:
        """Find out which unknowns stand together in the equations, and where.

        Those of a wall and its corners are a block; what was seen in a stretch is a clique.
        """
        given = self._given
        n_walls, stretch = int(given.wall.max()) + 1, given.iteration // STRETCH
        width, block, place = _blocks(given, stretch, n_walls)
        seen = np.concatenate([given.wall, block[given.corner]])
        at = np.concatenate([stretch, stretch[given.corner_row]])
        key, row = np.unique(at * len(width) + seen, return_inverse=True)
        clique, member = key // len(width), key % len(width)
        begin = np.searchsorted(clique, np.arange(clique[-1] + 2))
        self._pattern = Pattern.of_cliques(width, begin, member)
        first = self._pattern.first
        self._line, self._corner = first[:n_walls], first[block] + place
        # The same within each stretch, whose unknowns are in the order of elimination too.
        order = np.lexsort((first[member], clique))
        size = width[member[order]]
        ends = np.cumsum(size)
        unknowns = np.repeat(first[member[order]] - (ends - size), size) + np.arange(ends[-1])
        begin = np.concatenate([[0], ends])[begin]
        local = np.empty_like(order)
        local[order] = ends - size - begin[clique[order]]
        line = local[row[: len(stretch)]]
        corner = local[row[len(stretch) :]] + place[given.corner]
        last = np.minimum(STRETCH * np.arange(len(begin)), len(self._begin) - 1)
        entry = self._pattern.entries(begin, unknowns)
        self._stretches = last, begin, unknowns, entry, line, corner


def _blocks(
    given: WallEquations, stretch: NDArray[np.int64], n_walls: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the size of each block, and of each corner (c,) its block and its place in that.

    The first blocks are the walls', with the corners seen in much of what was seen of them; others
    stand alone, lest they are tied to all that was ever seen with the wall.
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


def wall_residuals(
    given: WallEquations, state: Walls
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far walls (n, 2), at two points, and corners (k,) are from their places."""
    from relmap.planes.refinement_kernels import residuals

    return residuals(_seen(given), _arrays(state))


def _seen(given: WallEquations) -> Any:
    """Return what the kernels know of observations."""
    middle = given.ends.mean(axis=1, keepdims=True)
    reach = SPREAD * (given.ends[:, 1:] - given.ends[:, :1])
    points = middle + np.array([[-1.0], [1.0]]) * reach
    corner_at = given.ends[given.corner_row, given.corner_end]
    return given.iteration, given.wall, points, given.corner_row, corner_at, given.corner


def _arrays(state: Walls) -> Any:
    """Return what the kernels know of a state."""
    turn = np.column_stack([np.cos(state.yaw), np.sin(state.yaw)])
    normal = np.column_stack([np.cos(state.angle), np.sin(state.angle)])
    return turn, state.t, state.centre, normal, state.across, state.along
