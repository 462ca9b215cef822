"""From landmarks to walls: which tracks are one wall, its line, and its extent.

Also the observations and the state that refinement solves for.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.motions import matrices
from relmap.planes.odometry.steps import MotionFactors
from relmap.planes.scans.corners import BLUNT
from relmap.planes.walls.history import PlaneHistory

FLAT_M = 0.003
SHARP_M = 0.01
"""Minimum standard deviations of a wall and of its corner, with noisy data: no real wall is exactly
flat or sharp."""
MISSED, MISSED_M = 0.5, 0.2
"""Standard deviation of a corner due to the distance between the points of its wall there, as a
fraction of that; and the maximum, above which wrong corners would not be rejected."""
OFTEN = 4
"""Observations required for a corner."""


@dataclass(frozen=True, eq=False)
class WallEquations:
    """Observations of walls; n observed walls, k observed corners.

    `iteration`, `wall` (n,); `ends` (n, 2, 2), robot frame, metres. `sd` (n,), metres: standard
    deviation of the distance to a wall at its middle. `corner_row` (k,): row of the wall of each
    observed corner. `corner_end` (k,): 0 for the right end, 1 for the left one. `corner` (k,):
    corner number; each belongs to one wall. `corner_sd` (k,), metres: standard deviation along the
    wall, of which `missed_m` (k,) is due to the distance between beams. `odometry`: used where
    walls alone do not determine the motion.
    """

    iteration: Ints
    wall: Ints
    ends: Floats
    sd: Floats
    corner_row: Ints
    corner_end: Ints
    corner: Ints
    corner_sd: Floats
    missed_m: Floats
    odometry: MotionFactors = field(default_factory=MotionFactors)

    @property
    def n_iterations(self) -> int:
        """Number of iterations."""
        return 1 + int(max(self.iteration[-1], self.odometry.both.max(initial=0)))


@dataclass(eq=False)
class Walls:
    """Poses, wall lines, and positions of corners along them: the state that is solved for.

    `yaw` (i,), `t` (i, 2): pose of each iteration: ``T_map_robot``; `centre` (w, 2): a fixed point
    near each wall; `angle`, `across` (w,): direction of the normal, and distance of the line from
    the centre; `along` (c,): position of each corner along its wall, from the centre.
    """

    yaw: Floats
    t: Floats
    centre: Floats
    angle: Floats
    across: Floats
    along: Floats


@dataclass(frozen=True, eq=False)
class WallNumbers:
    """Assignment of tracks to walls, and of corner numbers to corners.

    `wall_of` (p,): wall of each plane track, identified by the lowest track number of the wall;
    `corner_of` (c,): corner of each corner number, after merging.
    """

    wall_of: Ints
    corner_of: Ints

    def same_as(self, other: WallNumbers) -> bool:
        """Return whether two assignments are equal."""
        return np.array_equal(self.wall_of, other.wall_of) and np.array_equal(
            self.corner_of, other.corner_of
        )


@dataclass(frozen=True, eq=False)
class Assembled:
    """Walls and poses that fit all observations.

    `given`: equations with compact numbers of iterations, walls and corners. `typical_m`: noise of
    a typical single observation of a wall. `iterations`, `walls`, `corners`: original numbers of
    the compact ones. `rows` (n,): rows of the history. `settled`: whether the last solution
    converged. `reach` (w, 2), metres: extent of each wall along itself; None if given by the
    observations.
    """

    given: WallEquations
    typical_m: float
    state: Walls
    iterations: Ints
    walls: Ints
    corners: Ints
    rows: Ints
    settled: bool = True
    reach: Floats | None = None

    @property
    def corner_wall(self) -> Ints:
        """Compact number of the wall of each corner; (c,)."""
        wall = np.zeros(len(self.corners), dtype=np.int64)
        wall[self.given.corner] = self.given.wall[self.given.corner_row]
        return wall

    @property
    def corner_at(self) -> Floats:
        """Positions of the corners; (c, 2), map frame, metres."""
        wall, state = self.corner_wall, self.state
        normal, along = directions(state.angle[wall])
        return (
            state.centre[wall] + state.across[wall][:, None] * normal + state.along[:, None] * along
        )

    @property
    def corner_sd(self) -> Floats:
        """Standard deviation of the average of each corner along its wall; (c,) metres."""
        weight = np.bincount(self.given.corner, 1 / self.given.corner_sd**2)
        return np.asarray(1 / np.sqrt(weight))

    def only(self, kept: Bools) -> Assembled:
        """Return the walls of some rows (n,) with all poses, without solving again."""
        given, state = self.given, self.state
        seen = kept[given.corner_row]
        walls, wall = np.unique(given.wall[kept], return_inverse=True)
        corners, corner = np.unique(given.corner[seen], return_inverse=True)
        row = np.cumsum(kept) - 1
        observed = given.iteration[kept], wall, given.ends[kept], given.sd[kept]
        ends = row[given.corner_row[seen]], given.corner_end[seen], corner
        sds = given.corner_sd[seen], given.missed_m[seen]
        lines = state.centre[walls], state.angle[walls], state.across[walls]
        return replace(
            self,
            given=WallEquations(*observed, *ends, *sds, given.odometry),
            state=Walls(state.yaw, state.t, *lines, state.along[corners]),
            walls=self.walls[walls],
            corners=self.corners[corners],
            rows=self.rows[kept],
            reach=None if self.reach is None else self.reach[walls],
        )

    def poses(self, n: int) -> Floats:
        """Return ``T_map_robot`` of all iterations (n, 4, 4); NaN where unknown."""
        poses = np.full((n, 4, 4), np.nan)
        poses[self.iterations] = matrices(np.column_stack([self.state.yaw, self.state.t]))
        return poses


def directions(angle: Floats) -> tuple[Floats, Floats]:
    """Return unit normals (n, 2) at these angles, and directions along the walls, right to left."""
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    return normal, np.column_stack([normal[:, 1], -normal[:, 0]])


def assemble(
    history: PlaneHistory, numbers: WallNumbers, poses: Floats, moving: Bools
) -> Assembled | None:
    """Place all observations of walls by given poses.

    `poses` (i, 4, 4): ``T_map_robot``; NaN where unknown. `moving` (p,): plane tracks ignored
    because they move. Returns None if no iteration has a pose.
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
    ends = history.ends[rows]
    corner_sd = np.hypot(BLUNT * history.sd[rows][row], SHARP_M)
    missed_m = _missed_m(ends, history.places[rows], history.spacing_rad)[row, end]
    corner_sd = np.hypot(corner_sd, missed_m)
    motions = history.factors(iterations)
    given = WallEquations(iteration, wall, ends, sd, row, end, corner, corner_sd, missed_m, motions)
    state = laid_out(given, poses[iterations])
    typical = float(np.median(history.sd[rows]))
    return Assembled(given, typical, state, iterations, walls, corners, rows)


def _missed_m(ends: Floats, places: Ints, spacing_rad: float) -> Floats:
    """Return how far corners may be from the ends (n, 2, 2) of walls, robot frame; (n, 2), metres.

    The farther a wall and the more grazing the beams, the larger the distance between its points.
    0 where two walls meet, at one of `places` (n, 2), for their lines determine the corner.
    """
    along = ends[:, 1] - ends[:, 0]
    off_m = np.abs(ends[:, 0, 0] * along[:, 1] - ends[:, 0, 1] * along[:, 0]) / np.hypot(*along.T)
    apart_m = spacing_rad * (ends**2).sum(axis=2) / np.maximum(off_m, 1e-9)[:, None]
    meet = np.bincount(places.ravel())[places] > 1
    return np.where(meet, 0.0, np.minimum(MISSED * apart_m, MISSED_M))


def _corners(corner: Ints, corner_of: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Return row and end of each observation of frequent corners; these corners, and the index."""
    row, end = np.nonzero(corner >= 0)
    which = corner_of[corner[row, end]]
    row, end, which = (each[which >= 0] for each in (row, end, which))
    often = np.bincount(which, minlength=1)[which] >= OFTEN
    corners, compact = np.unique(which[often], return_inverse=True)
    row, end = row[often], end[often]
    return row, end, corners, compact


def laid_out(given: WallEquations, poses: Floats) -> Walls:
    """Return walls and corners as averages of their observations, by given poses."""
    R, t = poses[:, :2, :2], poses[:, :2, 3]
    c, s = R[given.iteration, 0, 0], R[given.iteration, 1, 0]
    ends = placed(given.ends, c, s, t[given.iteration])
    weight = 1 / given.sd**2
    total = np.bincount(given.wall, weight)
    centre = np.column_stack(
        [np.bincount(given.wall, weight * axis) / total for axis in ends.mean(axis=1).T]
    )
    along = ends[:, 1] - ends[:, 0]
    x, y = (np.bincount(given.wall, weight * axis) for axis in along.T)
    angle = np.arctan2(x, -y)
    of = given.wall[given.corner_row]
    off = ends[given.corner_row, given.corner_end] - centre[of]
    reach = (off * directions(angle)[1][of]).sum(axis=1)
    at = np.bincount(given.corner, reach) / np.bincount(given.corner)
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    return Walls(yaw, t, centre, angle, np.zeros(len(angle)), at)


def placed(ends: Floats, c: Floats, s: Floats, t: Floats) -> Floats:
    """Return the ends (n, 2, 2) of walls, rotated by cosine and sine (n,) and moved by t (n, 2)."""
    x, y = ends[..., 0], ends[..., 1]
    moved = np.empty_like(ends)
    moved[..., 0] = c[:, None] * x - s[:, None] * y + t[:, :1]
    moved[..., 1] = s[:, None] * x + c[:, None] * y + t[:, 1:]
    return moved
