"""Which links between a scan and those before are believed; where none is, a submap ends.

A motion that nothing measured would be invented, and one that few walls tell may be wrong: from
there on the whole map would lie elsewhere.  So the run breaks, and goes on in a frame of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.planes.motions import APART_M, APART_RAD
from relmap.planes.observation import PlaneObservation
from relmap.planes.placement import LEVER_M, Match, PlanarMotion, worth
from relmap.planes.tracks import PlaneTracks

SUPPORTED = 0.375
"""Share of the walls and corners of the poorer side that must agree on a motion."""
EXPECTED, NEAR_M, NEAR_RAD = 0.3, 0.25, np.deg2rad(5.0)
"""The same for going on as before, which is a motion so near the usual one."""
JUMP_M, JUMP = 0.5, 3.0
"""A step longer than this and so many usual ones is a jump."""
USUAL, KNOWN = 200, 5
"""Last steps that tell which are usual, and how few do not."""
CROSSING = np.sin(np.deg2rad(10.0)) ** 2
"""Walls whose directions spread less than by this hold no motion along themselves."""
STEADY = 5
"""Scans whose typical motion the robot is expected to go on with."""
VARYING = 20
"""So many steps tell how much the speed varies."""
UNSURE = 0.05
"""Share of a step that is not known at least, where the robot is taken to go on as before."""
VARYING_M = 0.15
"""Steps that vary by more are not bridged where nothing measures them."""
TORN_M = 1.0
"""A map is torn where it disagrees with a link, or with weak links in a row, by more."""


def believed(
    tracks: PlaneTracks,
    seen: PlaneObservation,
    found: tuple[PlanarMotion, Match],
    usual: PlanarMotion,
) -> bool:
    """Tell whether enough of the walls expected and of those seen agree on a motion.

    One that does not is nothing: it may be a speck, or just have come into view.
    """
    motion, match = found
    recent = tracks.missed == tracks.missed.min(initial=0)
    turned = abs((motion.yaw - usual.yaw + np.pi) % (2 * np.pi) - np.pi)
    near = turned < NEAR_RAD and np.hypot(*(motion.t - usual.t)) < NEAR_M
    supported = EXPECTED if near else SUPPORTED
    return match.score >= supported * (min(worth(tracks, seen, recent)) - 1)


def usual_motion(motions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how a robot went last (3,): the median of some of its motions (n, 3) so far."""
    last = np.sort(motions[-STEADY:], axis=0)
    return np.asarray(last[len(last) // 2]) if len(last) else np.zeros(3)


def farthest_m(before: NDArray[np.float64]) -> float:
    """Return how far a robot goes at most from one scan to the next, metres.

    Parameters
    ----------
    before : (n, 3) float64
        yaw, x, y of all motions so far.
    """
    if len(before) < KNOWN:
        return np.inf
    last = np.sort(_lengths(before[-USUAL:]))
    return JUMP_M + JUMP * float(last[len(last) // 2])


def measured_along(tracks: PlaneTracks, seen: PlaneObservation, match: Match) -> bool:
    """Tell whether matched walls tell the whole motion: by a corner, or as they cross."""
    known = np.isfinite(tracks.corner_at[match.tracks, :, 0])
    if (known & seen.static[match.walls]).any():
        return True
    of = np.zeros(len(match.walls), dtype=np.int64)
    return bool(spread(seen.along[match.walls], of, 1)[0] >= CROSSING)


def unsure_m(before: NDArray[np.float64]) -> float:
    """Return by how much the length of a step may be off where nothing measures it, metres.

    It is taken for the median of the last motions that were measured, of those (n, 3) so far: that
    is the less sure the more they differ.
    """
    if not len(before):
        return np.inf
    low, middle, high = np.quantile(_lengths(before[-VARYING:]), (0.25, 0.5, 0.75))
    return float(max((high - low) / 2 / np.sqrt(STEADY), UNSURE * middle))


def _lengths(motions: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hypot(motions[:, 1], motions[:, 2])


def disagreement(poses: NDArray[np.float64], motions: NDArray[np.float64]) -> tuple[int, float]:
    """Return at how many links a path is torn, and how far off it is at the others on average.

    As the motions that were measured from scan to scan have it; metres.

    Parameters
    ----------
    poses : (k, 4, 4) float64
    motions : (k, 3) float64
        yaw, x, y from the robot frame before into that of each iteration.
    """
    off_m = _off_m(poses, motions)
    off_m = off_m[np.isfinite(off_m)]
    torn = off_m > TORN_M
    return int(torn.sum()), float(off_m[~torn].sum() / max((~torn).sum(), 1))


def torn_links(
    poses: NDArray[np.float64], motions: NDArray[np.float64], weak: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return before which scans (t,) a path goes another way than its links.

    Parameters
    ----------
    poses : (k, 4, 4) float64
    motions : (k, 3) float64
        yaw, x, y from the robot frame before into that of each iteration.
    weak : (w,) int64
        Links that may be off by as much as a torn map.
    """
    way_m, turn = _off(poses, motions)
    torn = (way_m > APART_M) | (turn > APART_RAD)
    torn[weak - 1] = way_m[weak - 1] + LEVER_M * turn[weak - 1] > TORN_M
    return 1 + np.flatnonzero(torn)


def _off_m(poses: NDArray[np.float64], motions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much a path disagrees with each of its links, NaN where it is not known."""
    way_m, turn = _off(poses, motions)
    return np.asarray(way_m + LEVER_M * turn)


def _off(
    poses: NDArray[np.float64], motions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the same by the way, metres, and by the turn, radians."""
    relative = np.linalg.inv(poses[1:]) @ poses[:-1]
    turn = np.arctan2(relative[:, 1, 0], relative[:, 0, 0]) - motions[1:, 0]
    way_m = np.hypot(*(relative[:, :2, 3] - motions[1:, 1:]).T)
    return way_m, np.abs((turn + np.pi) % (2 * np.pi) - np.pi)


def stretched_m(
    poses: NDArray[np.float64], before: NDArray[np.float64], weak: NDArray[np.int64]
) -> float:
    """Return by how much the way over weak links in a row differs most between two paths, metres.

    Parameters
    ----------
    poses, before : (k, 4, 4) float64
    weak : (w,) int64, ascending
        Iterations before which too little was seen; those of other submaps are passed over.
    """
    weak = weak[(weak > 0) & (weak < len(poses))]
    if not len(weak):
        return 0.0
    breaks = np.flatnonzero(np.diff(weak) > 1)
    first, last = weak[np.append(0, breaks + 1)] - 1, weak[np.append(breaks, len(weak) - 1)]
    ways = [
        np.linalg.norm(path[last, :2, 3] - path[first, :2, 3], axis=1) for path in (poses, before)
    ]
    return float(np.nan_to_num(np.abs(ways[0] - ways[1])).max())


def spread(along: NDArray[np.float64], of: NDArray[np.int64], n: int) -> NDArray[np.float64]:
    """Return how much the directions (k, 2) of the walls of each of n scans spread, (n,).

    The smaller eigenvalue of the sum of the directions' outer products.
    """
    x, y = along.T
    xx, xy, yy = (np.bincount(of, v, minlength=n) for v in (x * x, x * y, y * y))
    return np.asarray((xx + yy) / 2 - np.hypot((xx - yy) / 2, xy))
