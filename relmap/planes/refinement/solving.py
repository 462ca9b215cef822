"""Solving for walls, corners and poses, with estimation of the noise of each wall and corner.

Also covariances of the refined map, and residuals of stretches and joined corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.refinement.joint import Refined
from relmap.core.refinement.residuals import SegmentResiduals, merge_residuals
from relmap.planes.refinement.system import WallSystem, wall_residuals
from relmap.planes.walls.assembly import FLAT_M, Assembled, directions
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.table import mapped_corners

EXACT_M = 1e-7
"""Minimum standard deviation of walls for noise-free data."""
SHARPER = 0.1
"""Factor by which the least noise is lowered at a time, down to that of the observations."""
MEDIAN = 1.4826
"""Standard deviation of a normal variable relative to the median of its magnitude."""
KNOWN_BY = 4.0
"""Weight of the prior noise of a wall or corner, in observations."""
LAST = (8, 4.0)
"""Maximum steps of the last solution, and the residual above which an observation is an outlier."""
SHARPLY = (6, 4.0)
"""The same, for solutions with less noise than the least noise of walls."""
STRETCH = 8
"""Number of iterations whose residuals are reported together."""


def refined(assembled: Assembled, rounds: Sequence[tuple[int, float]], held: float) -> Assembled:
    """Solve for walls, corners and poses, estimating the noise of each wall and corner.

    `rounds`, sequence of (int, float): maximum steps of each solution, between which the noise of
    each wall and corner is estimated, and the residual above which an observation is an outlier:
    infinite in the first rounds; `held`: see `WallSystem`.
    """
    return _solved(WallSystem(assembled.given, held), assembled, rounds)


def refined_to_the_noise(assembled: Assembled, held: float) -> Assembled:
    """Solve for walls, corners and poses at the accuracy of the observations.

    If they are more accurate than real walls, the least noise is lowered step by step, so that
    outliers are rejected before the noise is small (graduated non-convexity; Blake and Zisserman,
    1987). Otherwise the map is returned unchanged.
    """
    if assembled.typical_m >= FLAT_M:
        return assembled
    given, best, share = assembled.given, assembled, 1.0
    system = WallSystem(given, held)
    while share * FLAT_M > max(assembled.typical_m, EXACT_M):
        share *= SHARPER
        corner_sd = np.maximum(share * given.corner_sd, given.missed_m)
        lower = replace(given, sd=share * given.sd, corner_sd=corner_sd)
        best = _solved(system, replace(best, given=lower), (SHARPLY,), by_scan=False)
    return best


def _solved(
    system: WallSystem,
    assembled: Assembled,
    rounds: Sequence[tuple[int, float]],
    by_scan: bool = True,
) -> Assembled:
    """Solve in rounds, with a system of the same observations; see `WallSystem.refine`."""
    given, state, settled = assembled.given, assembled.state, True
    for most, doubtful in rounds:
        own = system.reweighted(given)
        state = own.refine(state, most, doubtful, by_scan)
        across, along = own.off(state)
        given, settled = assembled.given, own.settled
        wall = _learnt(given.wall, across.mean(axis=1) / given.sd)
        corner = _learnt(given.corner, along / given.corner_sd)
        sd, corner_sd = given.sd * wall[given.wall], given.corner_sd * corner[given.corner]
        given = replace(given, sd=sd, corner_sd=corner_sd)
    return replace(assembled, given=given, state=state, settled=settled)


def _learnt(of: Ints, residual: Floats) -> Floats:
    """Return the factors for the standard deviations of each, at least 1.

    The median is used: single outliers are left to the robust weights of the refinement.
    """
    from relmap.core.linalg.order_kernels import medians

    n = np.bincount(of)
    squares = n * (MEDIAN * medians(of, np.abs(residual))) ** 2
    return np.asarray(np.sqrt(np.maximum((KNOWN_BY + squares) / (KNOWN_BY + n), 1.0)))


def corner_covariances(assembled: Assembled) -> Floats:
    """Return the covariances of the corners (c, 2, 2), map frame, square metres.

    Relative to the robot pose of the first iteration. Parts connected to it only by the motion
    model have variances of square kilometres. If the residuals of most stretches are larger than
    the noise explains, as errors of a wall in several scans are alike, the covariances are scaled
    by their squared ratio.
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
    stretches = _stretches(assembled, *wall_residuals(given, assembled.state))
    scale = max(float(np.median(stretches.residual)), 1.0) ** 2
    return np.asarray(scale * J @ spread @ J.transpose(0, 2, 1))


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
