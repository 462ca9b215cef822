"""Matching mapped corners of walls to true ones, and their figures of merit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.evaluation import metrics
from relmap.evaluation.metrics import Matched
from relmap.evaluation.truth import Truth
from relmap.planes.walls.table import PlaneTable

TURN = np.cos(np.deg2rad(20.0))
"""Largest rotation between a wall and its match (cosine)."""
APART_M = 0.5
"""Largest distance between a mapped corner and its match."""
ROUNDS = 4
OFTEN = 10
"""Observations of a corner after which it counts as missing."""


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
    """Evaluate a map of walls, given what `match_corners` returns for it.

    Returns figures, counts and notes as `relmap.evaluation.landmarks.judge_landmarks` does.
    """
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
    along /= np.linalg.norm(along, axis=1, keepdims=True)
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
