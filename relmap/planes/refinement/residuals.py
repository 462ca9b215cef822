"""Covariances of a refined map of walls, and residuals of stretches and joined corners."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.residuals import SegmentResiduals, merge_residuals
from relmap.planes.refinement.solving import LAST
from relmap.planes.refinement.system import WallSystem, wall_residuals
from relmap.planes.walls.assembly import Assembled, directions
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.table import mapped_corners

STRETCH = 8
"""Number of iterations whose residuals are reported together."""


def corner_covariances(assembled: Assembled) -> Floats:
    """Return the covariances of the corners (c, 2, 2), map frame, square metres.

    Relative to the robot pose of the first iteration. Parts connected to it only by the motion
    model have variances of square kilometres.
    """
    given, state = assembled.given, assembled.state
    if not len(given.corner):
        return np.empty((0, 2, 2))
    odometry = given.odometry
    seen = np.unique(np.concatenate([given.iteration, odometry.both.ravel()]))
    state = replace(state, yaw=state.yaw[seen], t=state.t[seen])
    iteration, both = (np.searchsorted(seen, each) for each in (given.iteration, odometry.both))
    odometry = replace(odometry, both=both)
    system = WallSystem(replace(given, iteration=iteration, odometry=odometry))
    spread = system.corner_covariances(state, LAST[1])
    wall = assembled.corner_wall
    normal, along = directions(state.angle[wall])
    by_angle = state.along[:, None] * normal - state.across[wall][:, None] * along
    J = np.stack([by_angle, normal, along], axis=2)
    return np.asarray(J @ spread @ J.transpose(0, 2, 1))


def refined_walls(assembled: Assembled, history: PlaneHistory) -> Refined:
    """Return a refined map of walls in the form used for points; its landmarks are corners."""
    across, along = wall_residuals(assembled.given, assembled.state)
    mapped, given = mapped_corners(assembled), assembled.given
    merges = merge_residuals(
        assembled.corners,
        given.corner,
        history.corner[assembled.rows[given.corner_row], given.corner_end],
        along[:, None],
        np.ones(len(along)),
        given.corner_sd**2,
    )
    spread: Any = lambda: corner_covariances(assembled)[mapped]  # noqa: E731
    return Refined(
        landmarks=assembled.corners[mapped],
        positions=assembled.corner_at[mapped],
        anchor_iteration=int(assembled.iterations[0]),
        noise_m=assembled.typical_m,
        segments=_stretches(assembled, across, along),
        merges=merges,
        spread=spread,
    )


def _stretches(assembled: Assembled, across: Floats, along: Floats) -> SegmentResiduals:
    """Compare the squared residuals of each stretch with their expectation under noise alone."""
    given, state = assembled.given, assembled.state
    stretch = assembled.iterations // STRETCH
    stretches, of = np.unique(stretch[given.iteration], return_inverse=True)
    s, at_corner = len(stretches), of[given.corner_row]
    squares = np.bincount(of, ((across / given.sd[:, None]) ** 2).sum(axis=1) / 2, minlength=s)
    squares += np.bincount(at_corner, (along / given.corner_sd) ** 2, minlength=s)
    seen = np.unique(given.iteration)
    poses = np.bincount(np.searchsorted(stretches, stretch[seen]), minlength=s)
    n = 2 * np.bincount(of, minlength=s) + np.bincount(at_corner, minlength=s)
    middle = state.centre[given.wall]
    centre = np.column_stack([np.bincount(of, axis, minlength=s) for axis in middle.T])
    return SegmentResiduals(
        first_iteration=np.maximum(STRETCH * stretches, assembled.iterations[0]),
        middle=centre / np.bincount(of, minlength=s)[:, None],
        residual=np.sqrt(squares / np.maximum(n - 3 * poses, 1)),
    )
