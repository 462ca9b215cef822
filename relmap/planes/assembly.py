"""From landmarks to walls: which tracks are one wall, where its line is, and how far it goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relmap.planes.history import PlaneHistory
from relmap.planes.refinement import WallEquations, Walls, medians, refine_walls

FLAT_M = 0.003
SHARP_M = 0.01
"""How sure a wall and its corner can be at best, if there is any noise: nothing real is quite flat
or sharp."""
EXACT_M = 1e-7
"""How sure they can be at best where there is none."""
BLUNT = 3.0
"""How much less sure a corner is than its wall, to begin with."""
OFTEN = 4
"""Sights that make a corner."""
MEDIAN = 1.4826
"""The standard deviation of what is normal, in units of the median of its size."""
KNOWN_BY = 4.0
"""Observations that what was assumed of a wall or corner counts for against what was seen of it."""
ROUNDS = ((2, 20.0), (3, 8.0), (9, 4.0))
"""Most steps of each solution, between which the noise of each wall and corner is learnt, and the
residual from which an observation is in doubt: none is before the rest has fallen into place."""


@dataclass(frozen=True, eq=False)
class WallNumbers:
    """Which wall each track of a wall is, and which of its corners each number is.

    Attributes
    ----------
    wall_of : (p,) int64
        Of each plane track; by the lowest number of the tracks of a wall.
    corner_of : (c,) int64
        Of each corner, after merging.
    """

    wall_of: NDArray[np.int64]
    corner_of: NDArray[np.int64]

    @classmethod
    def apart(cls, n_planes: int, n_corners: int) -> WallNumbers:
        """Let every track be a wall of its own."""
        return cls(np.arange(n_planes), np.arange(n_corners))

    def same_as(self, other: WallNumbers) -> bool:
        """Tell whether nothing differs."""
        return np.array_equal(self.wall_of, other.wall_of) and np.array_equal(
            self.corner_of, other.corner_of
        )

    @classmethod
    def of(
        cls, n_planes: int, wall_end: NDArray[np.int64], corner_of: NDArray[np.int64]
    ) -> WallNumbers:
        """Join tracks whose corners turned out to be the same."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        a, b = wall_end // 2, wall_end[corner_of] // 2
        graph = coo_array((np.ones(len(a)), (a, b)), shape=(n_planes, n_planes))
        n, part = connected_components(graph, directed=False)
        first = np.full(n, n_planes)
        np.minimum.at(first, part, np.arange(n_planes))
        return cls(first[part], corner_of)


@dataclass(frozen=True, eq=False)
class Assembled:
    """Walls and poses on which all that was seen agrees.

    Attributes
    ----------
    given : WallEquations
        Compact numbers: of iterations, walls and corners.
    state : Walls
    iterations, walls, corners : int64 arrays
        What the compact numbers stand for.
    rows : (n,) int64
        Rows of the history.
    all_corners : (m,) int64
        Every corner ever numbered.
    """

    given: WallEquations
    state: Walls
    iterations: NDArray[np.int64]
    walls: NDArray[np.int64]
    corners: NDArray[np.int64]
    rows: NDArray[np.int64]
    all_corners: NDArray[np.int64]

    @property
    def corner_wall(self) -> NDArray[np.int64]:
        """Compact number of the wall of each corner; (c,)."""
        wall = np.zeros(len(self.corners), dtype=np.int64)
        wall[self.given.corner] = self.given.wall[self.given.corner_row]
        return wall

    @property
    def corner_at(self) -> NDArray[np.float64]:
        """Where the corners are; (c, 2), map frame, metres."""
        wall, state = self.corner_wall, self.state
        normal, along = directions(state.angle[wall])
        return (
            state.centre[wall] + state.across[wall][:, None] * normal + state.along[:, None] * along
        )

    @property
    def corner_sd(self) -> NDArray[np.float64]:
        """How sure the average behind each corner is, along its wall; (c,) metres."""
        weight = np.bincount(self.given.corner, 1 / self.given.corner_sd**2)
        return np.asarray(1 / np.sqrt(weight))

    def poses(self, n: int) -> NDArray[np.float64]:
        """Return ``T_map_robot`` of all iterations (n, 4, 4); NaN where there is none."""
        poses = np.full((n, 4, 4), np.nan)
        poses[self.iterations] = np.eye(4)
        c, s = np.cos(self.state.yaw), np.sin(self.state.yaw)
        poses[self.iterations, 0, 0] = poses[self.iterations, 1, 1] = c
        poses[self.iterations, 1, 0], poses[self.iterations, 0, 1] = s, -s
        poses[self.iterations, :2, 3] = self.state.t
        return poses


def directions(angle: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return unit vectors (n, 2) of normals at these angles, and along the walls, right to left."""
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    return normal, np.column_stack([normal[:, 1], -normal[:, 0]])


def assemble(
    history: PlaneHistory,
    numbers: WallNumbers,
    poses: NDArray[np.float64],
    moving: NDArray[np.bool_],
) -> Assembled | None:
    """Lay everything seen of walls where the poses put it.

    Parameters
    ----------
    history : PlaneHistory
    numbers : WallNumbers
    poses : (i, 4, 4) float64
        ``T_map_robot``; NaN where there is none.
    moving : (p,) bool
        Plane tracks that say nothing, for they move.

    Returns
    -------
    Assembled or None
        None where no iteration has a pose.
    """
    rows = np.flatnonzero(np.isfinite(poses[history.iteration, 0, 0]) & ~moving[history.plane])
    if not len(rows):
        return None
    iterations, iteration = np.unique(history.iteration[rows], return_inverse=True)
    walls, wall = np.unique(numbers.wall_of[history.plane[rows]], return_inverse=True)
    ends = history.ends[rows]
    corner = history.corner[rows]
    corner = np.where(corner >= 0, numbers.corner_of[corner], -1)
    times = np.bincount(corner[corner >= 0], minlength=len(numbers.corner_of))
    row, end = np.nonzero((corner >= 0) & (times[corner] >= OFTEN))
    corners, compact = np.unique(corner[row, end], return_inverse=True)
    typical = float(np.median(history.sd[rows]))
    flat, sharp = min(FLAT_M, typical), min(SHARP_M, BLUNT * typical)
    sd = np.hypot(history.sd[rows], max(flat, EXACT_M))
    corner_sd = np.hypot(BLUNT * history.sd[rows][row], max(sharp, EXACT_M))
    given = WallEquations(iteration, wall, ends, sd, row, end, compact, corner_sd)
    R, t = poses[iterations, :2, :2], poses[iterations, :2, 3]
    placed = np.einsum("nij,nej->nei", R[iteration], ends) + t[iteration][:, None]
    weight = 1 / sd**2
    total = np.bincount(wall, weight)
    centre = np.column_stack(
        [np.bincount(wall, weight * axis) / total for axis in placed.mean(axis=1).T]
    )
    along = placed[:, 1] - placed[:, 0]
    x, y = (np.bincount(wall, weight * axis) for axis in along.T)
    angle = np.arctan2(x, -y)
    of = wall[row]
    reach = ((placed[row, end] - centre[of]) * directions(angle)[1][of]).sum(axis=1)
    at = np.bincount(compact, reach) / np.bincount(compact)
    state = Walls(np.arctan2(R[:, 1, 0], R[:, 0, 0]), t, centre, angle, np.zeros(len(walls)), at)
    every = np.arange(len(numbers.corner_of))
    return Assembled(given, state, iterations, walls, corners, rows, every)


def refined(assembled: Assembled, rounds: Sequence[tuple[int, float]] = ROUNDS) -> Assembled:
    """Solve for walls, corners and poses, learning on the way how noisy each wall and corner is."""
    given, state = assembled.given, assembled.state
    for most, doubtful in rounds:
        state = refine_walls(given, state, most, doubtful)
        given = _reweighted(assembled.given, state)
    return replace(assembled, given=given, state=state)


def _reweighted(given: WallEquations, state: Walls) -> WallEquations:
    """Return the equations with the noise that each wall and corner shows in the residuals."""
    from relmap.planes.refinement import across_residuals, along_residuals

    wall = _learnt(given.wall, across_residuals(given, state) / given.sd)
    corner = _learnt(given.corner, along_residuals(given, state) / given.corner_sd)
    return replace(
        given, sd=given.sd * wall[given.wall], corner_sd=given.corner_sd * corner[given.corner]
    )


def _learnt(of: NDArray[np.int64], residual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by what the standard deviations of each are to be multiplied, at least 1.

    The median tells: single sights that are quite wrong are for the refinement to leave out.
    """
    n = np.bincount(of)
    squares = n * (MEDIAN * medians(of, np.abs(residual))) ** 2
    return np.asarray(np.sqrt(np.maximum((KNOWN_BY + squares) / (KNOWN_BY + n), 1.0)))
