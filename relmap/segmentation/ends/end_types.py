"""Types of the ends of walls, from the geometry of one scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats
from relmap.segmentation.planes import END_TYPES

SURE = 2.5
"""Distance from a limit, in standard deviations, within which an end is cut by it."""
SLACK_RAD = 0.003
SLACK_M = 0.01
SIDES, NAMES = np.array([-1.0, 1.0]), np.array(END_TYPES)
"""Signs of the bearings of right and left ends, and the types by number."""
ALL_ROUND_RAD = np.deg2rad(170.0)
"""Bearing to a side above which the view has no edge."""
Limits = tuple[float, float]
"""Limits of the sensor: half its field of view, centred ahead, radians, and its range, metres."""


def sensor_limits(
    ends: Floats, spread: Floats, joined: Bools, view_rad: float | None, range_m: float | None
) -> Limits:
    """Return the limits of the sensor; missing ones are estimated.

    The edge of the view is the largest bearing of an end (m, 2, 2), as the view is centred ahead.
    The range is only determined if two or more ends, not in corners, have the same maximum
    distance.

    `ends` (m, 2, 2), robot frame, metres; `spread` (m, 2), metres: standard deviation of each end
    along its wall; `joined` (m, 2): whether the end is in a corner with another wall; `view_rad`,
    `range_m`: the field of view, radians, and the range, if known.
    """
    if view_rad is None:
        half = float(np.abs(bearings(ends)).max(initial=0.0))
        half = np.inf if half > ALL_ROUND_RAD else half
    else:
        half = view_rad / 2 if view_rad < 2 * ALL_ROUND_RAD else np.inf
    if range_m is None:
        far = np.hypot(ends[..., 0], ends[..., 1])
        top = far.max(initial=0.0)
        cut = (far > top - SURE * spread - SLACK_M) & ~joined
        range_m = float(top) if cut.sum() > 1 and not (joined & (far >= top)).any() else np.inf
    return half, range_m


def bearings(points: Floats) -> Floats:
    """Return the bearings (...,) of points (..., 2), radians, positive to the left."""
    return np.asarray(np.arctan2(points[..., 1], points[..., 0]))


def type_ends(
    ends: Floats, spread: Floats, joined: Bools, limits: Limits, hidden: Bools
) -> NDArray[np.str_]:
    """Return the type of each end (m, 2), one of `END_TYPES`.

    `ends` (m, 2, 2), robot frame, metres: right and left end of each wall; `spread` (m, 2), metres:
    standard deviation of each end along its wall; `joined` (m, 2): whether the end lies in a corner
    with another wall, so that nothing hides it; `hidden` (m, 2): whether something nearer was seen
    beside the end, from beams in order.
    """
    if len(ends) == 0:
        return np.empty((0, 2), dtype="<U8")
    far = np.hypot(ends[..., 0], ends[..., 1])
    along = ends[:, 1] - ends[:, 0]
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    range_m = np.maximum(far, 1e-9)
    radial = np.abs(ends[..., 0] * along[:, :1] + ends[..., 1] * along[:, 1:]) / range_m
    tangent = np.minimum(np.maximum(1 - radial**2, 0.05), 1)
    turn = SURE * spread * np.sqrt(tangent) / range_m + SLACK_RAD
    bearing = bearings(ends)
    cut_by = {
        "view": SIDES * bearing > limits[0] - turn,
        "range": far > limits[1] - SURE * spread * np.maximum(radial, 0.1) - SLACK_M,
        "occluded": (_hidden(bearing, far, turn, spread) | hidden) & ~joined,
    }
    kind = np.zeros(far.shape, dtype=np.int64)
    for reason in ("occluded", "range", "view"):  # in reverse: the first type in order wins
        kind[cut_by[reason]] = END_TYPES.index(reason)
    return NAMES[kind]


def _hidden(bearing: Floats, far: Floats, turn: Floats, spread: Floats) -> Bools:
    """Return which ends (m, 2) are next to the edge of a nearer wall that extends beyond them."""
    # A wall beyond the right end shows its left end there.
    (own, edge), (own_m, edge_m), (turn, slack), (sd, edge_sd) = (
        (each.T[:, :, None], each.T[::-1, None]) for each in (bearing, far, turn, spread)
    )
    apart = np.abs(own - edge)
    close = np.minimum(apart, 2 * np.pi - apart) < turn + slack
    hidden = close & (edge_m < own_m - (SURE * np.hypot(sd, edge_sd) + 5 * SLACK_M))
    itself = np.arange(len(far))
    hidden[:, itself, itself] = False
    return np.asarray(hidden.any(axis=2).T)
