"""Figures of merit of maps and trajectories, as in `relmap evaluate`, on plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid, rotation_of_moment

MATCH_S = 0.01
"""Tolerance for matching two stamps (that of the TUM benchmark's tools)."""


@dataclass(frozen=True, eq=False)
class Matched:
    """Mapped landmarks, paired with the true ones and aligned.

    `position`, `truth` (p, d), metres: in the map frame of the result, and in that of the truth;
    `R` (d, d), `t` (d,): ``truth ~ position @ R.T + t``.
    """

    position: Floats
    truth: Floats
    R: Floats
    t: Floats
    rmse_m: float | None


def rms(errors: Floats) -> float | None:
    """Return the root mean square of the lengths of error vectors (n, d); None if n is 0."""
    if not len(errors):
        return None
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def align(source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return the rigid motion (no scale) that brings the source closest to the target.

    `source`, `target` (n, d), metres: d is 2 or 3; row i of one belongs to row i of the other.
    Returns `R` (d, d); `t` (d,): ``target ~ source @ R.T + t``; no motion at all where there are no
    points.
    """
    d = source.shape[1]
    if not len(source):
        return np.eye(d), np.zeros(d)
    return fit_rigid(source, target)


def align_poses(poses: Floats, others: Floats, d: int) -> tuple[Floats, Floats]:
    """Return the motion that best aligns poses to others, by whole poses: one suffices.

    `poses`, `others` (k, 4, 4): of the same instants; `d`: 2 to align in the plane, or 3. Returns
    `R` (d, d), `t` (d,): ``others ~ poses @ R.T + t`` for the positions.
    """
    turns = others[:, :d, :d] @ poses[:, :d, :d].transpose(0, 2, 1)
    R = rotation_of_moment(turns.sum(axis=0)).T
    return R, (others[:, :d, 3] - poses[:, :d, 3] @ R.T).mean(axis=0)


def aligned_rmse(source: Floats, target: Floats) -> float | None:
    """Return the `rms` of the distances after `align`."""
    R, t = align(source, target)
    return rms(source @ R.T + t - target)


def majority_ids(landmark: Ints, true_id: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the true landmark of each mapped one, by majority of its observations.

    `landmark`, `true_id` (n,): label and true id of each observation; a negative true id is unknown
    and does not count. Returns `labels` (m,): the landmarks with at least one known observation,
    ascending. `ids` (m,): their true ids; the smaller id on a tie. `agreeing` (m,): number of their
    observations with that id.
    """
    known = true_id >= 0
    pairs = np.column_stack([landmark[known], true_id[known]])
    pairs, votes = np.unique(pairs, axis=0, return_counts=True)
    order = np.lexsort((pairs[:, 1], -votes, pairs[:, 0]))
    labels, first = np.unique(pairs[order, 0], return_index=True)
    best = order[first]
    return labels, pairs[best, 1], votes[best]


def purity(landmark: Ints, true_id: Ints) -> float | None:
    """Return the fraction of observations that agree with the majority of their landmark.

    `landmark`, `true_id` (n,): as for `majority_ids`. Returns None if no observation has a true id.
    """
    known = int((true_id >= 0).sum())
    if not known:
        return None
    return int(majority_ids(landmark, true_id)[2].sum()) / known


def seen_often(true_id: Ints, iteration: Ints, iterations: int = 10) -> Ints:
    """Return the true ids that were seen in at least a number of iterations, ascending.

    `true_id`, `iteration` (n,): for each observation; negative ids are left out. `iterations`:
    required number of iterations.
    """
    pairs = np.unique(np.column_stack([true_id, iteration])[true_id >= 0], axis=0)
    ids, counts = np.unique(pairs[:, 0], return_counts=True)
    return np.asarray(ids[counts >= iterations], np.int64)


def match_stamps(stamps_s: Floats, others_s: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which stamps (n,) match which others (m,): index arrays of equal length.

    Each is matched to the nearest other within `MATCH_S`; no other is used twice.
    """
    gap, nearest = (np.asarray(a) for a in cKDTree(others_s[:, None]).query(stamps_s[:, None]))
    close = np.flatnonzero(gap <= MATCH_S)
    close = close[np.argsort(gap[close], kind="stable")]
    _, first = np.unique(nearest[close], return_index=True)
    mine = np.sort(close[first])
    return mine, nearest[mine]


def ate(poses: Floats, true_poses: Floats, planar: bool) -> float | None:
    """Return the absolute trajectory error: RMSE of the positions after rigid alignment, metres.

    `poses`, `true_poses` (k, 4, 4): T_map_robot of the same instants; `planar`: whether to align
    and compare in the plane. Returns None if k is 0. See Sturm et al., "A benchmark for the
    evaluation of RGB-D SLAM systems", IROS 2012.
    """
    d = 2 if planar else 3
    return aligned_rmse(poses[:, :d, 3], true_poses[:, :d, 3])


def rpe(poses: Floats, true_poses: Floats, instant: NDArray[np.intp]) -> float | None:
    """Return the relative pose error between consecutive instants: RMSE of the translation, metres.

    `poses`, `true_poses` (k, 4, 4): T_map_robot of the same instants. `instant` (k,) int,
    ascending: number of each instant; only consecutive numbers are compared. Returns None if there
    is no such pair. See Sturm et al. as for `ate`.
    """
    step = np.flatnonzero(np.diff(instant) == 1)
    motion = np.linalg.solve(poses[step], poses[step + 1])
    true_motion = np.linalg.solve(true_poses[step], true_poses[step + 1])
    return rms(np.linalg.solve(true_motion, motion)[:, :3, 3])
