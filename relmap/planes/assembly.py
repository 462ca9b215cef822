"""From landmarks to walls: which tracks are one wall, where its line is, and how far it goes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relmap.planes.equations import WallEquations, Walls
from relmap.planes.history import PlaneHistory
from relmap.planes.motion_factors import MotionFactors

FLAT_M = 0.003
SHARP_M = 0.01
"""How sure a wall and its corner can be at best, if there is any noise: nothing real is quite flat
or sharp."""
BLUNT = 3.0
"""How much less sure a corner is than its wall, to begin with."""
OFTEN = 4
"""Sights that make a corner."""


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
        return cls(
            first_of(n_planes, np.column_stack([wall_end, wall_end[corner_of]]) // 2), corner_of
        )


def first_of(n: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each of n walls the first of those that pairs (k, 2) join it to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    n_parts, part = connected_components(graph, directed=False)
    first = np.full(n_parts, n)
    np.minimum.at(first, part, np.arange(n))
    return np.asarray(first[part])


@dataclass(frozen=True, eq=False)
class Assembled:
    """Walls and poses on which all that was seen agrees.

    Attributes
    ----------
    given : WallEquations
        Compact numbers: of iterations, walls and corners.
    typical_m : float
        Noise of a typical observation of a wall, by itself.
    state : Walls
    iterations, walls, corners : int64 arrays
        What the compact numbers stand for.
    rows : (n,) int64
        Rows of the history.
    all_corners : (m,) int64
        Every corner ever numbered.
    settled : bool
        Whether the last solution came to rest.
    reach : (w, 2) float64 or None, metres
        From where to where each wall goes, along it; None where what was seen of it tells.
    """

    given: WallEquations
    typical_m: float
    state: Walls
    iterations: NDArray[np.int64]
    walls: NDArray[np.int64]
    corners: NDArray[np.int64]
    rows: NDArray[np.int64]
    all_corners: NDArray[np.int64]
    settled: bool = True
    reach: NDArray[np.float64] | None = None

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

    def only(self, kept: NDArray[np.bool_]) -> Assembled:
        """Return what some of the rows (n,) showed, with all poses, without solving again."""
        given, state = self.given, self.state
        seen = kept[given.corner_row]
        walls, wall = np.unique(given.wall[kept], return_inverse=True)
        corners, corner = np.unique(given.corner[seen], return_inverse=True)
        row = np.cumsum(kept) - 1
        own = WallEquations(
            given.iteration[kept],
            wall,
            given.ends[kept],
            given.sd[kept],
            row[given.corner_row[seen]],
            given.corner_end[seen],
            corner,
            given.corner_sd[seen],
            given.odometry,
        )
        return replace(
            self,
            given=own,
            state=replace(
                state,
                centre=state.centre[walls],
                angle=state.angle[walls],
                across=state.across[walls],
                along=state.along[corners],
            ),
            walls=self.walls[walls],
            corners=self.corners[corners],
            rows=self.rows[kept],
            reach=None if self.reach is None else self.reach[walls],
        )

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
    usable = np.isfinite(poses[history.iteration, 0, 0]) & ~moving[history.plane]
    wall = numbers.wall_of[history.plane]
    seen = np.bincount(wall[usable], minlength=len(numbers.wall_of))
    rows = np.flatnonzero(usable & (seen[wall] >= OFTEN))
    if not len(rows):
        return None
    iterations, iteration = np.unique(history.iteration[rows], return_inverse=True)
    walls, wall = np.unique(wall[rows], return_inverse=True)
    row, end, corners, corner = _corners(history.corner[rows], numbers.corner_of)
    sd = np.hypot(history.sd[rows], FLAT_M)
    corner_sd = np.hypot(BLUNT * history.sd[rows][row], SHARP_M)
    ends = history.ends[rows]
    odometry = history.odometry.between(iterations) if history.odometry else MotionFactors()
    given = WallEquations(iteration, wall, ends, sd, row, end, corner, corner_sd, odometry)
    state = laid_out(given, poses[iterations])
    typical = float(np.median(history.sd[rows]))
    every = np.arange(len(numbers.corner_of))
    return Assembled(given, typical, state, iterations, walls, corners, rows, every)


def _corners(
    corner: NDArray[np.int64], corner_of: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return row and end of each sight of a corner seen often; those corners, and which it is."""
    row, end = np.nonzero(corner >= 0)
    which = corner_of[corner[row, end]]
    row, end, which = (each[which >= 0] for each in (row, end, which))
    often = np.bincount(which, minlength=1)[which] >= OFTEN
    corners, compact = np.unique(which[often], return_inverse=True)
    row, end = row[often], end[often]
    return row, end, corners, compact


def laid_out(given: WallEquations, poses: NDArray[np.float64]) -> Walls:
    """Return walls and corners as the average of what was seen of them, by given poses."""
    R, t = poses[:, :2, :2], poses[:, :2, 3]
    placed = np.einsum("nij,nej->nei", R[given.iteration], given.ends)
    placed += t[given.iteration][:, None]
    weight = 1 / given.sd**2
    total = np.bincount(given.wall, weight)
    centre = np.column_stack(
        [np.bincount(given.wall, weight * axis) / total for axis in placed.mean(axis=1).T]
    )
    along = placed[:, 1] - placed[:, 0]
    x, y = (np.bincount(given.wall, weight * axis) for axis in along.T)
    angle = np.arctan2(x, -y)
    of = given.wall[given.corner_row]
    off = placed[given.corner_row, given.corner_end] - centre[of]
    reach = (off * directions(angle)[1][of]).sum(axis=1)
    at = np.bincount(given.corner, reach) / np.bincount(given.corner)
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    return Walls(yaw, t, centre, angle, np.zeros(len(angle)), at)
