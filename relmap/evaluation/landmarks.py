"""Matching mapped points to true ones, and their metrics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints, positions_of
from relmap.core.errors import RelmapError
from relmap.core.geometry.motions import transforms
from relmap.datasets.base import ObservationLog
from relmap.evaluation import metrics
from relmap.evaluation.metrics import Matched
from relmap.evaluation.pairing import moved, paired
from relmap.evaluation.truth import Truth
from relmap.io.results import Result

ELSEWHERE = 10.0
"""Ratio of the distances from its own true place and from another above which ids disagree."""


@dataclass(frozen=True, eq=False)
class Identified:
    """Labelled observations and their true landmarks.

    `landmark` (n,): label in the result; `true_id` (n,): negative if unknown; `seen_id`,
    `seen_iteration` (s,): all observations of the mapped iterations, including those without a
    label.
    """

    landmark: Ints
    true_id: Ints
    seen_id: Ints
    seen_iteration: Ints


@dataclass(frozen=True, eq=False)
class Overlay:
    """The truth, transformed into the map frame of a result.

    `landmarks_map` (m, 3), metres: all true landmarks with known positions. `path_map` (k, 3),
    metres: true positions of the robot; may be empty. `errors_map` (p, 2, 3), metres: mapped and
    true position of each landmark that can be compared.
    """

    landmarks_map: Floats
    path_map: Floats
    errors_map: Floats


def judge_landmarks(
    result: Result, truth: Truth, log: ObservationLog | None
) -> tuple[dict[str, float | None], dict[str, int], list[str]]:
    """Evaluate a map of points.

    `log`: the log that was mapped; its ids are the true association. Returns `figures`: the
    landmark figures of `Evaluation`, where available, `counts`: counts behind the figures and
    `notes`: reasons for missing figures.
    """
    counts = {
        "landmarks": len(result.landmarks.landmark),
        "mapped": int(result.mapped.sum()),
        "true_landmarks": len(truth.landmark_ids),
        "matched_poses": len(truth.poses_of(result)[0]),
    }
    if "merged" in result.summary:
        return _judged_by_place(result, truth, counts)
    identified = identify(result, log)
    matched = match_landmarks(result, truth, identified)
    if identified is None or matched is None:
        return {}, counts, []
    counts |= {
        "matched_landmarks": len(matched.position),
        "identified_observations": int((identified.true_id >= 0).sum()),
    }
    placed = np.isfinite(truth.landmarks_map).all(axis=1).any()
    notes = []
    if placed and not len(matched.position):
        notes.append("no landmark RMSE: no mapped landmark matches a true one")
    notes += _other_ids(result, truth, matched)
    _, ids = _standing_for(result, identified)
    often = metrics.seen_often(identified.seen_id, identified.seen_iteration)
    due = np.intersect1d(often, truth.landmark_ids[truth.status == "static"])
    figures = {
        "landmark_rmse_m": matched.rmse_m,
        "coverage": len(np.intersect1d(due, ids)) / len(due) if len(due) else None,
        "landmarks_per_true": len(ids) / len(np.unique(ids)) if len(ids) else None,
        "purity": metrics.purity(identified.landmark, identified.true_id),
    }
    return figures, counts, notes


def _other_ids(result: Result, truth: Truth, matched: Matched) -> list[str]:
    """Return a note if the ids of the truth are not those of the log.

    Then landmarks lie at the true places of others once the paths are aligned. Without a common
    path, the error is more than half of their extent.
    """
    d = 2 if result.planar else 3
    own = matched.truth[:, :d]
    poses, true_poses, _ = truth.poses_of(result)
    if len(own) and len(poses):
        R, t = metrics.align_poses(poses, true_poses, d)
        placed = matched.position[:, :d] @ R.T + t
        path_m = metrics.ate(poses, true_poses, result.planar) or 0.0
        least_m = ELSEWHERE * (path_m + cKDTree(own).query(placed)[0])
        n = int((np.linalg.norm(placed - own, axis=1) > least_m).sum())
    else:
        spread_m = metrics.rms(own - own.mean(axis=0)) if len(own) else None
        n = len(own) if 2 * (matched.rmse_m or 0.0) > (spread_m or 0.0) else 0
    if n < 2:
        return []
    found = f"{n} of {len(own)} landmarks are not where their ids are in the truth"
    place = ", but where other ids are" if len(poses) else ""
    return [f"{found}{place}: do the ids of the truth and of the log agree?"]


def _judged_by_place(
    result: Result, truth: Truth, counts: dict[str, int]
) -> tuple[dict[str, float | None], dict[str, int], list[str]]:
    """Evaluate a merged map, which has no tracks, by position, as `judge_landmarks` does."""
    d = 2 if result.planar else 3
    rows = result.mapped & (result.landmarks.status == "static")
    position = result.landmarks.position[rows][:, :d]
    placed = np.isfinite(truth.landmarks_map).all(axis=1) & (truth.status == "static")
    places = truth.landmarks_map[placed][:, :d]
    poses, true_poses, _ = truth.poses_of(result)
    few = "no landmark RMSE: a merged map is matched by place, for which too little is known"
    if len(poses) < 3 or min(len(position), len(places)) <= d:
        return {}, counts, [few]
    R, t = metrics.align(poses[:, :d, 3], true_poses[:, :d, 3])
    T, pairs = paired(position, places, transforms(R, t))
    errors = moved(position[pairs[:, 0]], T) - places[pairs[:, 1]]
    counts |= {"matched_landmarks": len(pairs)}
    note = f"landmarks were matched by place, {len(pairs)} of {len(position)}: the map was merged"
    return {"landmark_rmse_m": metrics.rms(errors)}, counts, [note]


def overlay(result: Result, truth: Truth, log: ObservationLog | None) -> Overlay | None:
    """Transform the truth into the map frame, or without a map into that of the path.

    `log`: the log that was mapped. Returns None if no ids match landmarks, and the paths share
    fewer than three instants. Raises `RelmapError` if the log is not the one that was mapped.
    """
    if result.mapped.any():
        if (matched := match_landmarks(result, truth, identify(result, log))) is None:
            return None
        R, t = matched.R, matched.t
        pairs = np.stack([matched.position, (matched.truth - t) @ R], axis=1)
    else:
        poses, true_poses, _ = truth.poses_of(result)
        if len(poses) < 3:
            return None
        R, t = metrics.align(poses[:, :3, 3], true_poses[:, :3, 3])
        pairs = np.empty((0, 2, 3))
    placed = truth.landmarks_map[np.isfinite(truth.landmarks_map).all(axis=1)]
    return Overlay((placed - t) @ R, (truth.poses[:, :3, 3] - t) @ R, pairs)


def identify(result: Result, log: ObservationLog | None) -> Identified | None:
    """Return the true landmark of each observation, if known; RelmapError as for `mapped_part`."""
    tracks = result.tracks
    if log is not None:
        log = mapped_part(result, log)
    if log is None or log.ids is None:
        if result.summary.get("association") != "known":
            return None
        return Identified(tracks.landmark, tracks.landmark, tracks.landmark, tracks.iteration)
    at = positions_of(log.rows, tracks.row)
    return Identified(tracks.landmark, log.ids[at], log.ids, log.iteration)


def mapped_part(result: Result, log: ObservationLog) -> ObservationLog:
    """Return the mapped iterations of a log; RelmapError if it is not the one that was mapped."""
    scans = result.summary.get("scans")
    if not (isinstance(scans, list) and len(scans) == 2 and all(type(s) is int for s in scans)):
        raise RelmapError("summary.json of the result: scans is not a pair of iteration numbers")
    part = log.between(*scans)
    tracks = result.tracks
    at = positions_of(part.rows, tracks.row)
    same = [part.first_iteration, part.end_iteration] == scans and bool((at >= 0).all())
    same = same and np.array_equal(part.iteration[at], tracks.iteration)
    if not same:
        raise RelmapError("the log is not the one that was mapped: its rows or iterations differ")
    return part


def match_landmarks(
    result: Result, truth: Truth, identified: Identified | None, often: bool = False
) -> Matched | None:
    """Pair the mapped static landmarks with their true positions and align the two.

    `often`: whether to leave out landmarks seen in fewer than ten iterations. The alignment is in
    the x-y plane if the result is planar. Returns None if no ids match the landmarks.
    """
    if identified is None:
        return None
    labels, ids = _standing_for(result, identified, result.landmarks.status == "static")
    if often:
        seen = metrics.seen_often(identified.seen_id, identified.seen_iteration)
        labels, ids = labels[np.isin(ids, seen)], ids[np.isin(ids, seen)]
    at = positions_of(truth.landmark_ids, ids)
    comparable = (truth.status == "static") & np.isfinite(truth.landmarks_map).all(axis=1)
    there = (at >= 0) & comparable[at] if len(comparable) else at >= 0
    position = result.landmarks.position[positions_of(result.landmarks.landmark, labels[there])]
    true_position = truth.landmarks_map[at[there]]
    R, t = np.eye(3), np.zeros(3)
    d = 2 if result.planar else 3
    R[:d, :d], t[:d] = metrics.align(position[:, :d], true_position[:, :d])
    errors = position @ R.T + t - true_position
    return Matched(position, true_position, R, t, metrics.rms(errors[:, :d]))


def _standing_for(
    result: Result, identified: Identified, wanted: Bools | bool = True
) -> tuple[Ints, Ints]:
    """Return the labels of mapped landmarks and their true ids."""
    labels, ids, _ = metrics.majority_ids(identified.landmark, identified.true_id)
    chosen = np.isin(labels, result.landmarks.landmark[result.mapped & wanted])
    return labels[chosen], ids[chosen]
