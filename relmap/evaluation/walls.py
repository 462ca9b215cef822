"""Wall recall and precision by length: mapped, true, and doubled walls."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.evaluation.metrics import align
from relmap.evaluation.truth import Truth
from relmap.planes.walls.table import PlaneTable

NEAR_M, TURN = 0.1, np.cos(np.deg2rad(5.0))
"""Largest distance and rotation (cosine) between walls that coincide."""
SHORT_M = 0.5
"""Shorter walls are not required."""
SAMPLE_M, MOST_SAMPLES = 0.05, 2000
"""Spacing of the points at which walls are compared, and their maximum number."""


def judge_walls(
    planes: PlaneTable,
    truth: Truth,
    poses: Floats,
    true_poses: Floats,
    motion: tuple[Floats, Floats] | None = None,
) -> dict[str, float | None]:
    """Evaluate the mapped walls by their length.

    `poses`, `true_poses` (k, 4, 4): of the same instants, used for alignment without `motion`, R
    (2, 2) and t (2,) from the map to the truth. Returns `wall_recall`, fraction of the observed
    length of true walls over 0.5 m that is mapped; `wall_precision`, fraction of the length of
    mapped walls over 0.5 m that coincides with true ones; `doubled_length`, fraction of all mapped
    length that coincides with another mapped wall. Walls coincide within 0.1 m and 5 degrees, with
    fronts on the same side. None if there is nothing to compare.
    """
    mapped = planes.ends[planes.status == "static"]
    figures = {"doubled_length": doubled_length(mapped)}
    if not len(truth.ends) or not len(poses):
        return figures
    R, t = motion or align(poses[:, :2, 3], true_poses[:, :2, 3])
    there = mapped @ R.T + t
    seen = _seen_parts(truth)
    return figures | {
        "wall_recall": _covered(seen[_lengths(seen) > SHORT_M], there),
        "wall_precision": _covered(there[_lengths(there) > SHORT_M], truth.ends),
    }


def doubled_length(ends: Floats) -> float | None:
    """Return the fraction of the length of walls (w, 2, 2) that coincides with another of them."""
    return _covered(ends, ends, others=True)


def _seen_parts(truth: Truth) -> Floats:
    """Return the parts (s, 2, 2) of true walls over `SHORT_M` that were seen."""
    seen = truth.seen_m
    if len(seen) != len(truth.ends):
        return np.empty((0, 2, 2))
    due = np.isfinite(seen).all(axis=1) & (_lengths(truth.ends) > SHORT_M)
    first, last = truth.ends[due, 0], truth.ends[due, 1]
    share = seen[due] / _lengths(truth.ends[due])[:, None]
    return np.asarray(first[:, None] + share[..., None] * (last - first)[:, None])


def _lengths(ends: Floats) -> Floats:
    return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))


def _covered(ends: Floats, by: Floats, others: bool = False) -> float | None:
    """Return the fraction of the length of walls that coincides with some of those in `by`.

    With `others` the two sets are the same, and no wall is compared with itself.
    """
    length_m = _lengths(ends)
    if not length_m.sum():
        return None
    counts = np.clip(np.ceil(length_m / SAMPLE_M), 1, MOST_SAMPLES).astype(np.int64)
    wall = np.repeat(np.arange(len(ends)), counts)
    rank = np.arange(len(wall)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (rank + 0.5) / counts[wall]
    points = ends[wall, 0] + share[:, None] * (ends[wall, 1] - ends[wall, 0])
    on = np.zeros(len(wall), dtype=bool)
    for k, other in enumerate(by):
        if others:
            on |= _on_wall(points, wall, ends, other, 0.0) & (wall != k)
        else:
            on |= _on_wall(points, wall, ends, other, NEAR_M)
    weight = (length_m / counts)[wall]
    return float(weight[on].sum() / weight.sum())


def _on_wall(points: Floats, wall: Ints, ends: Floats, other: Floats, beyond_m: float) -> Bools:
    """Return which points (n, 2) of walls lie on another wall (2, 2), or just beyond its ends."""
    direction = (ends[:, 1] - ends[:, 0]) / np.maximum(_lengths(ends), 1e-12)[:, None]
    length_m = np.linalg.norm(other[1] - other[0])
    along = (other[1] - other[0]) / max(length_m, 1e-12)
    offset = points - other[0]
    at_m, across_m = offset @ along, offset @ np.array([-along[1], along[0]])
    near = (np.abs(across_m) <= NEAR_M) & (at_m >= -beyond_m) & (at_m <= length_m + beyond_m)
    return np.asarray(near & (direction @ along >= TURN)[wall])
