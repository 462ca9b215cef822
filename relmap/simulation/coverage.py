"""How often each wall and its ends were seen, and which part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.simulation.sensor import BuildingScan

OFTEN, POINTS, CELL_M = 10, 5, 0.05
"""Number of scans, and of points in each, for a place of a wall to count as seen; and
resolution."""
STRAIGHT, CHORD_M, SAME_M = np.cos(np.deg2rad(5.0)), 0.2, 1e-6
"""Walls shorter than this that continue this straight (cosine) form no corner."""


def times_seen(walls: Floats, scans: Sequence[BuildingScan]) -> Ints:
    """Count the scans that saw each wall (w, 6), and its right and left end; (w, 3)."""
    counts = np.zeros((len(walls), 3), dtype=np.int64)
    for scan in scans:
        corner = scan.seen.end_type == "corner"
        counts[np.unique(scan.seen.wall), 0] += 1
        # No two stretches of a wall share a true end.
        counts[scan.seen.wall[corner[:, 0]], 1] += 1
        counts[scan.seen.wall[corner[:, 1]], 2] += 1
    counts[:, 1:][_go_on(walls[:, :4].reshape(-1, 2, 2))] = 0
    return counts


def _go_on(ends: Floats) -> Bools:
    """Return at which ends (w, 2) of walls (w, 2, 2) another wall continues, as in a curve."""
    along = ends[:, 1] - ends[:, 0]
    length_m = np.linalg.norm(along, axis=1)
    along /= length_m[:, None]
    follows = np.linalg.norm(ends[:, None, 1] - ends[None, :, 0], axis=2) < SAME_M
    follows &= np.minimum(length_m[:, None], length_m) < CHORD_M
    follows &= along @ along.T > STRAIGHT
    return np.column_stack([follows.any(axis=0), follows.any(axis=1)])


def seen_extents(walls: Floats, trajectory: Floats, scans: Sequence[BuildingScan]) -> Floats:
    """Return the observed extent of each wall, metres from its first end.

    `walls` (w, 6), map frame, metres: static walls; `trajectory` (k, 4, 4); `scans`: sequence of k
    BuildingScan. Returns (w, 2): NaN where it was not seen by `POINTS` points in each of `OFTEN`
    scans.
    """
    first, along = walls[:, :2], walls[:, 2:4] - walls[:, :2]
    length_m = np.linalg.norm(along, axis=1)
    covered = [np.zeros(int(np.ceil(length / CELL_M)) + 1, np.int64) for length in length_m]
    for pose, scan in zip(trajectory, scans, strict=True):
        wall = scan.wall
        at = scan.points[:, :2] @ pose[:2, :2].T + pose[:2, 3] - first[wall]
        t_m = np.clip((at * along[wall]).sum(axis=1) / length_m[wall], 0.0, length_m[wall])
        for k in np.flatnonzero(np.bincount(wall[wall >= 0]) >= POINTS).tolist():
            own = t_m[wall == k]
            covered[k][round(own.min() / CELL_M) : round(own.max() / CELL_M) + 1] += 1
    extents = np.full((len(walls), 2), np.nan)
    for k, count in enumerate(covered):
        often = np.flatnonzero(count >= OFTEN)
        if len(often):
            extents[k] = np.minimum(often[[0, -1]] * CELL_M, length_m[k])
    return extents
