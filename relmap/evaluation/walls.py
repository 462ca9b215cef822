"""Figures of merit of walls: recall and precision by length, and of their corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.evaluation import metrics
from relmap.evaluation.metrics import Matched, align
from relmap.evaluation.truth import Truth
from relmap.planes.walls.table import PlaneTable

NEAR_M, PARALLEL = 0.1, np.cos(np.deg2rad(5.0))
"""Largest distance and rotation (cosine) between walls that coincide."""
SHORT_M = 0.5
"""Shorter walls are not required."""
SAMPLE_M, MOST_SAMPLES = 0.05, 2000
"""Spacing of the points at which walls are compared, and their maximum number."""
TURN = np.cos(np.deg2rad(20.0))
"""Largest rotation between a wall and its match (cosine)."""
APART_M = 0.5
"""Largest distance between a mapped corner and its match."""
ROUNDS = 4
OFTEN = 10
"""Observations of a corner after which it counts as missing."""


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
        near = _on_wall(points, wall, ends, other, 0.0 if others else NEAR_M)
        on |= near & (wall != k) if others else near
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
    return np.asarray(near & (direction @ along >= PARALLEL)[wall])


@dataclass(frozen=True, eq=False)
class MatchedCorners(Matched):
    """Matched mapped corners (p, 2) and true ones.

    `wall`, `end` (p,): the true corner of each; `n_false`: mapped corners that match no true one.
    """

    wall: Ints
    end: Ints
    n_false: int


def judge_corners(
    planes: PlaneTable, truth: Truth, true_poses: Floats, matched: MatchedCorners | None
) -> tuple[dict[str, float | None], dict[str, int], list[str]]:
    """Evaluate the corners of a map as `judge_landmarks` does, given its `match_corners`."""
    counts = {
        "planes": len(planes.plane),
        "mapped_planes": int((planes.status == "static").sum()),
        "true_planes": len(truth.ends),
        "matched_poses": len(true_poses),
    }
    if not len(truth.ends):
        return {}, counts, []
    due = np.flatnonzero(truth.corner_scans.ravel() >= OFTEN)
    if matched is None:
        n_false, coverage = len(_corners(planes)[0]), 0.0 if len(due) and len(true_poses) else None
        counts |= {"matched_corners": 0, "false_corners": n_false, "due_corners": len(due)}
        note = f"no corner RMSE: {_why_unmatched(planes, true_poses)}"
        return {"coverage": coverage}, counts, [note]
    corner = 2 * matched.wall + matched.end
    counts |= {"matched_corners": len(corner), "false_corners": matched.n_false}
    coverage = float(np.isin(due, corner).mean()) if len(due) else None
    figures = {
        "corner_rmse_m": matched.rmse_m,
        "coverage": coverage,
        "landmarks_per_true": len(corner) / len(np.unique(corner)),
    }
    return figures, counts | {"due_corners": len(due)}, []


def _corners(planes: PlaneTable) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and end of each mapped corner."""
    row, end = np.nonzero((planes.corner >= 0) & (planes.status == "static")[:, None])
    return row, end


def _why_unmatched(planes: PlaneTable, true_poses: Floats) -> str:
    """Return the reason why `match_corners` found nothing."""
    if not len(_corners(planes)[0]):
        return "no corner is mapped"
    if not fixes_rotation(true_poses[:, :2, 3]):
        return "corners are matched by the path, which shares no two poses with the truth"
    return "the map is too far off: none of its corners is close to a true one"


def match_corners(
    planes: PlaneTable, truth: Truth, poses: Floats, true_poses: Floats
) -> MatchedCorners | None:
    """Pair mapped corners with true ones and align the two, starting from the paths.

    A corner is paired with the nearest true one at the same end of a wall that faces the same way.

    `planes`: the mapped walls, map frame, metres; `poses`, `true_poses` (k, 4, 4): ``T_map_robot``
    of the same instants, as mapped and true. Returns None if there is no path to start from, or
    nothing can be paired.
    """
    row, end = _corners(planes)
    position, normal = planes.ends[row, end], planes.normal[row]
    if not fixes_rotation(true_poses[:, :2, 3]) or not len(row) or not len(truth.ends):
        return None
    along = truth.ends[:, 1] - truth.ends[:, 0]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    front = np.column_stack([-along[:, 1], along[:, 0]])
    R, t = fit_rigid(poses[:, :2, 3], true_poses[:, :2, 3])
    for _ in range(ROUNDS):
        there = position @ R.T + t
        apart = np.linalg.norm(truth.ends[:, end].swapaxes(0, 1) - there[:, None], axis=2)
        apart[normal @ R.T @ front.T < TURN] = np.inf
        wall = apart.argmin(axis=1)
        near = apart.min(axis=1) < APART_M
        target = truth.ends[wall, end]
        if not fixes_rotation(target[near]):
            return None
        R, t = fit_rigid(position[near], target[near])
    found, there = position[near], target[near]
    rmse_m = metrics.rms(found @ R.T + t - there)
    return MatchedCorners(found, there, R, t, rmse_m, wall[near], end[near], int((~near).sum()))
