"""Observations of walls, and the state that is solved for."""

from __future__ import annotations

from dataclasses import dataclass, field

from relmap.core.arrays import Floats, Ints
from relmap.planes.odometry.steps import MotionFactors


@dataclass(frozen=True, eq=False)
class WallEquations:
    """Observations of walls; n observed walls, k observed corners.

    `iteration`, `wall` (n,); `ends` (n, 2, 2), robot frame, metres. `sd` (n,), metres: standard
    deviation of the distance to a wall at its middle. `corner_row` (k,): row of the wall of each
    observed corner. `corner_end` (k,): 0 for the right end, 1 for the left one. `corner` (k,):
    corner number; each belongs to one wall. `corner_sd` (k,), metres: standard deviation along the
    wall. `odometry`: used where walls alone do not determine the motion.
    """

    iteration: Ints
    wall: Ints
    ends: Floats
    sd: Floats
    corner_row: Ints
    corner_end: Ints
    corner: Ints
    corner_sd: Floats
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
