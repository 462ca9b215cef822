"""Which walls of a scan are which tracks: normal, offset and gap along the wall (section II)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from relmap.planes.observation import PlaneObservation
from relmap.planes.tracks import PlaneTracks, wrapped

SIGMAS = 4.0
"""Tolerance, in standard deviations of what two walls differ by."""
TURN_RAD = np.deg2rad(8.0)
ACROSS_M = 0.12
GAP_M = 0.4
"""How far one wall may be off in two scans, whatever the noise: walls are not quite flat, and their
ends not quite where they are seen."""


@dataclass(frozen=True, eq=False)
class Match:
    """Walls of a scan and the tracks that they continue, one to one.

    Attributes
    ----------
    tracks, walls : (k,) int64
    score : float
        How well they agree: each wall counts for 1 at most, each corner too.
    """

    tracks: NDArray[np.int64]
    walls: NDArray[np.int64]
    score: float


def match_walls(tracks: PlaneTracks, seen: PlaneObservation, widened: float = 1.0) -> Match:
    """Match walls of a scan to tracks carried into its frame.

    Parameters
    ----------
    tracks : PlaneTracks
    seen : PlaneObservation
    widened : float
        What all tolerances are multiplied by, where the tracks are carried only roughly.
    """
    agreement = _agreement(
        tracks.angle, tracks.offset, tracks.ends, tracks.sd, tracks.corner_at, seen, widened
    )
    rows, walls = linear_sum_assignment(-agreement)
    there = agreement[rows, walls] > 0
    rows, walls = rows[there], walls[there]
    return Match(rows, walls, float(agreement[rows, walls].sum()))


def _agreement(
    angle: NDArray[np.float64],
    offset: NDArray[np.float64],
    ends: NDArray[np.float64],
    sd: NDArray[np.float64],
    corner_at: NDArray[np.float64],
    seen: PlaneObservation,
    widened: float,
) -> NDArray[np.float64]:
    """Return how well tracks (..., n) agree with walls (m,): (..., n, m), 0 for not at all."""
    spread = np.hypot(sd[..., None], seen.sd)
    size = np.hypot(*np.moveaxis(ends[..., 1, :] - ends[..., 0, :], -1, 0))
    shorter = np.minimum(size[..., None], seen.size)
    turn = wrapped(np.arctan2(seen.normal[:, 1], seen.normal[:, 0]) - angle[..., None])
    turn_gate = TURN_RAD * widened + np.minimum(SIGMAS * np.sqrt(12) * spread / shorter, 0.5)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = normal @ seen.ends.mean(axis=1).T - offset[..., None]
    across_gate = ACROSS_M * widened + SIGMAS * spread
    along = np.einsum("mea,ma->me", seen.ends, seen.along)
    there = np.einsum("...nea,ma->...nme", ends, seen.along)
    gap = np.maximum(along[:, 0] - there[..., 1], there[..., 0] - along[:, 1])
    closeness = (
        1
        - 0.3 * (turn / turn_gate) ** 2
        - 0.3 * (across / across_gate) ** 2
        - 0.3 * np.clip(gap / (GAP_M * widened), 0, 1)
    )
    ok = (np.abs(turn) < turn_gate) & (np.abs(across) < across_gate) & (gap < GAP_M * widened)
    corner = np.einsum("...nea,ma->...nme", corner_at, seen.along)
    off = np.where(seen.static, np.abs(corner - along), np.nan) / (GAP_M * widened)
    same = np.nansum(np.clip(1 - off**2, 0, 1), axis=-1)
    return np.where(ok, closeness + same, 0.0)
