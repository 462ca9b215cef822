"""Where the frame of the tracks lies in that of a scan: the motion on which most walls agree.

As with points it is a rough one, good for telling who is who, and forgotten afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.planes.matching import Match, match_walls
from relmap.planes.observation import PlaneObservation
from relmap.planes.tracks import PlaneTracks, wrapped

ROUGHLY = 3.0
"""Tolerances of a guess, in units of those of the final match."""
REACH_M = 3.0
TURN_RAD = np.deg2rad(45.0)
"""How far the wider search goes between two scans."""
HELD = 1e-2
"""Weight of going on as before, where nothing that is seen tells: a wall's is 1."""
ROUNDS = 3
CONTENT = 0.8
"""Share of what could agree that must, before a wider search is spared."""
DOUBT = 2.0
"""Walls and corners more that must agree on a sudden motion than on going on as before: single
walls look alike."""
TIE = 0.1
"""Standing still must agree by so much better than going on: along a single partial wall nothing
but rounding tells the two apart."""
SUDDEN_M = 0.75
LEVER_M = 3.0
"""A turn is as sudden as the way that it takes a wall at this distance."""
LEAST_M = 0.02
"""Noise of a corner that its weight is reckoned with at least."""


@dataclass(frozen=True, eq=False)
class PlanarMotion:
    """A motion in the plane from one robot frame into another: ``R(yaw) @ p + t``."""

    yaw: float
    t: NDArray[np.float64]

    def then(self, other: PlanarMotion) -> PlanarMotion:
        """Return this motion followed by another."""
        c, s = np.cos(other.yaw), np.sin(other.yaw)
        turned = np.array([c * self.t[0] - s * self.t[1], s * self.t[0] + c * self.t[1]])
        return PlanarMotion(self.yaw + other.yaw, turned + other.t)


STILL = PlanarMotion(0.0, np.zeros(2))


def place(
    tracks: PlaneTracks, seen: PlaneObservation, before: PlanarMotion
) -> tuple[PlanarMotion, Match] | None:
    """Find the motion of the tracks' frame into the scan's, and who is who by it.

    Tried are to go on as before, to stand still, and where neither will do, every pair of a track's
    corner and a corner of the scan: with the direction of its wall one corner fixes a motion.

    Parameters
    ----------
    tracks : PlaneTracks
    seen : PlaneObservation
    before : PlanarMotion
        The motion between the two scans before.  Where walls seen leave a direction open, as along
        a single partial one, the robot is taken to go on like that (motion model).

    Returns
    -------
    (motion, match) or None
        None where no wall agrees.
    """
    best, still = (_settled(tracks, seen, guess) for guess in (before, STILL))
    if still[1].score > best[1].score + TIE:
        best = still
    recent = tracks.missed == tracks.missed.min(initial=0)
    possible = min(_worth(tracks, seen, recent))
    if best[1].score < CONTENT * possible:
        for guess in _guesses(tracks, seen, best[1].score):
            found = _settled(tracks, seen, guess)
            if found[1].score > best[1].score + _doubt(found[0], before):
                best = found
    return best if len(best[1].tracks) else None


def _doubt(motion: PlanarMotion, before: PlanarMotion) -> float:
    """Return how many walls and corners more must agree on a motion, the more sudden it is."""
    jumps = [
        np.hypot(*(motion.t - usual.t)) + LEVER_M * abs(motion.yaw - usual.yaw)
        for usual in (before, STILL)
    ]
    return float(0.5 + DOUBT * min(1.0, min(jumps) / SUDDEN_M))


def _worth(
    tracks: PlaneTracks, seen: PlaneObservation, recent: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return the score if all tracks seen last were seen again, and if all walls were known."""
    return (
        float(recent.sum() + np.isfinite(tracks.corner_at[recent, :, 0]).sum()),
        float(len(seen) + seen.static.sum()),
    )


def _settled(
    tracks: PlaneTracks, seen: PlaneObservation, motion: PlanarMotion
) -> tuple[PlanarMotion, Match]:
    """Fit a guess to what agrees with it, and see again what agrees."""
    widened = ROUGHLY
    for _ in range(ROUNDS):
        match = match_walls(tracks.carried(motion.yaw, motion.t), seen, widened)
        if not len(match.tracks):
            return motion, match
        motion = motion.then(_correction(tracks.carried(motion.yaw, motion.t), seen, match))
        widened = max(1.0, widened / 2)
    return motion, match_walls(tracks.carried(motion.yaw, motion.t), seen)


def _correction(tracks: PlaneTracks, seen: PlaneObservation, match: Match) -> PlanarMotion:
    """Return the small motion that brings tracks onto the walls that they match (least squares)."""
    i, j = match.tracks, match.walls
    normal, ends = tracks.normal[i], seen.ends[j]
    # Both ends of a wall seen lie on the line of its track.
    n = np.repeat(normal, 2, axis=0)
    p = ends.reshape(-1, 2)
    rows = [np.column_stack([n[:, 1] * p[:, 0] - n[:, 0] * p[:, 1], n])]
    rights = [(n * p).sum(axis=1) - np.repeat(tracks.offset[i], 2)]
    weights = [np.repeat(1 / (1 + (tracks.sd[i] / LEAST_M) ** 2), 2)]
    # A corner seen again lies at its place along the wall.
    both = np.isfinite(tracks.corner_at[i, :, 0]) & seen.static[j]
    k, end = np.nonzero(both)
    u, c = seen.along[j[k]], tracks.corner_at[i[k], end]
    off = (u * (ends[k, end] - c)).sum(axis=1)
    near = np.abs(off) < 0.5
    rows.append(np.column_stack([u[:, 1] * c[:, 0] - u[:, 0] * c[:, 1], u])[near])
    rights.append(off[near])
    weights.append(np.full(near.sum(), 0.3))
    rows.append(np.column_stack([np.zeros(2), np.eye(2)]))
    rights.append(np.zeros(2))
    weights.append(np.full(2, HELD))
    A, b, w = np.concatenate(rows), np.concatenate(rights), np.concatenate(weights)
    normal_matrix = A.T @ (A * w[:, None]) + 1e-9 * np.eye(3)
    yaw, x, y = np.linalg.solve(normal_matrix, A.T @ (w * b))
    return PlanarMotion(float(yaw), np.array([x, y]))


def _guesses(tracks: PlaneTracks, seen: PlaneObservation, score: float) -> list[PlanarMotion]:
    """Return the most promising motions that bring a corner onto a corner, best first."""
    row, end = np.nonzero(np.isfinite(tracks.corner_at[:, :, 0]))
    wall, side = np.nonzero(seen.static)
    a, b = np.nonzero(end[:, None] == side)
    row, end, wall = row[a], end[a], wall[b]
    angle = np.arctan2(seen.normal[wall, 1], seen.normal[wall, 0])
    yaw = wrapped(angle - tracks.angle[row])
    c, s = np.cos(yaw), np.sin(yaw)
    at = tracks.corner_at[row, end]
    turned = np.column_stack([c * at[:, 0] - s * at[:, 1], s * at[:, 0] + c * at[:, 1]])
    t = seen.ends[wall, end] - turned
    far = np.hypot(t[:, 0], t[:, 1])
    order = np.argsort(far + np.abs(yaw), kind="stable")
    possible = order[(far[order] < REACH_M) & (np.abs(yaw[order]) < TURN_RAD)]
    scored = [(match_walls(tracks.carried(yaw[k], t[k]), seen, ROUGHLY).score, k) for k in possible]
    promising = [k for found, k in sorted(scored, key=lambda pair: -pair[0])[:3] if found > score]
    return [PlanarMotion(float(yaw[k]), t[k]) for k in promising]
