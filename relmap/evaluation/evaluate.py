"""Compare a result with the truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.evaluation import metrics
from relmap.evaluation.truth import Truth
from relmap.io.results import Result


@dataclass(frozen=True)
class Evaluation:
    """The figures of one result; None where one cannot be had.

    Attributes
    ----------
    landmark_rmse_m : float or None
        Of the mapped static landmarks against their true places, after rigid alignment.
    coverage : float or None
        Share of the static true landmarks seen in at least ten of the mapped iterations that
        stand in the map.
    landmarks_per_true : float or None
        Mapped landmarks for each true one that they stand for; 1 is right.
    purity : float or None
        Share of the observations that are of what most of their landmark's are of.
    ate_m : float or None
        Absolute trajectory error: RMSE of the positions after rigid alignment.
    rpe_m : float or None
        Relative pose error from one iteration to the next: RMSE of its shift.
    counts : dict
        What the figures rest on.
    notes : tuple of str
        Why figures are missing that this truth could give.
    """

    landmark_rmse_m: float | None
    coverage: float | None
    landmarks_per_true: float | None
    purity: float | None
    ate_m: float | None
    rpe_m: float | None
    counts: dict[str, int]
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Identified:
    """Every labelled observation with what it truly is of.

    Attributes
    ----------
    landmark : (n,) int64
        Label in the result.
    true_id : (n,) int64
        Negative where it is not known.
    iteration : (n,) int64
    seen_id, seen_iteration : (s,) int64
        All observations of the mapped iterations, those without a label too.
    """

    landmark: NDArray[np.int64]
    true_id: NDArray[np.int64]
    iteration: NDArray[np.int64]
    seen_id: NDArray[np.int64]
    seen_iteration: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MatchedLandmarks:
    """The mapped static landmarks whose true places are known, paired.

    Attributes
    ----------
    position, truth : (p, 3) float64, metres
        In the map frame of the result, and in that of the truth.
    R, t : (3, 3), (3,) float64
        ``truth ~ position @ R.T + t``.
    """

    position: NDArray[np.float64]
    truth: NDArray[np.float64]
    R: NDArray[np.float64]
    t: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Overlay:
    """The truth, brought into the map frame of a result.

    Attributes
    ----------
    landmarks_map : (m, 3) float64, metres
        All true landmarks whose places are known.
    path_map : (k, 3) float64, metres
        True positions of the robot; may be empty.
    errors_map : (p, 2, 3) float64, metres
        Mapped place and true place of each landmark that can be compared.
    """

    landmarks_map: NDArray[np.float64]
    path_map: NDArray[np.float64]
    errors_map: NDArray[np.float64]


def evaluate(result: Result, truth: Truth, log: ObservationLog | None = None) -> Evaluation:
    """Compare a result with the truth.

    Parameters
    ----------
    result : Result
    truth : Truth
    log : ObservationLog, optional
        The log that was mapped: its ids tell what each observation truly is of.  Without them the
        figures about landmarks are None, unless the association was known and the labels are ids.

    Raises
    ------
    RelmapError
        Where the log is not the one that was mapped.
    """
    identified = identify(result, log)
    matched = match_landmarks(result, truth, identified)
    ate_m, rpe_m, poses = _trajectory_errors(result, truth)
    counts = {
        "landmarks": len(result.landmarks.landmark),
        "mapped": int(result.mapped.sum()),
        "true_landmarks": len(truth.landmark_ids),
        "matched_poses": poses,
    }
    figures: dict[str, float | None] = dict.fromkeys(
        ("landmark_rmse_m", "coverage", "landmarks_per_true", "purity")
    )
    if identified is not None and matched is not None:
        counts["matched_landmarks"] = len(matched.position)
        counts["identified_observations"] = int((identified.true_id >= 0).sum())
        figures = _landmark_figures(result, truth, identified, matched)
    notes = []
    placed = np.isfinite(truth.landmarks_map).all(axis=1).any()
    if placed and matched is not None and not len(matched.position):
        notes.append("no landmark RMSE: no mapped landmark is one of the true ones")
    if len(truth.stamps_s) and not poses:
        notes.append(metrics.NO_COMMON_TIMES)
    return Evaluation(**figures, ate_m=ate_m, rpe_m=rpe_m, counts=counts, notes=tuple(notes))


def overlay(result: Result, truth: Truth, log: ObservationLog | None = None) -> Overlay | None:
    """Bring the truth into the map frame; None where nothing tells which landmark is which.

    Raises
    ------
    RelmapError
        Where the log is not the one that was mapped.
    """
    matched = match_landmarks(result, truth, identify(result, log))
    if matched is None:
        return None
    R, t = matched.R, matched.t
    placed = truth.landmarks_map[np.isfinite(truth.landmarks_map).all(axis=1)]
    pairs = np.stack([matched.position, (matched.truth - t) @ R], axis=1)
    return Overlay((placed - t) @ R, (truth.poses[:, :3, 3] - t) @ R, pairs)


def identify(result: Result, log: ObservationLog | None) -> Identified | None:
    """Tell what each observation truly is of; None where nothing tells it.

    Raises
    ------
    RelmapError
        Where the log is not the one that was mapped.
    """
    tracks = result.tracks
    if log is not None:
        log = mapped_part(result, log)
    if log is None or log.ids is None:
        if result.summary.get("association") != "known":
            return None
        seen = (tracks.landmark, tracks.iteration)
        return Identified(tracks.landmark, tracks.landmark, tracks.iteration, *seen)
    order = np.argsort(log.rows, kind="stable")
    at = order[np.searchsorted(log.rows[order], tracks.row)]
    return Identified(tracks.landmark, log.ids[at], tracks.iteration, log.ids, log.iteration)


def mapped_part(result: Result, log: ObservationLog) -> ObservationLog:
    """Return the iterations of the log that were mapped.

    Raises
    ------
    RelmapError
        Where the log is not the one that was mapped.
    """
    scans = result.summary.get("scans")
    if not (isinstance(scans, list) and len(scans) == 2 and all(type(s) is int for s in scans)):
        raise RelmapError("summary.json of the result: scans is not a pair of iteration numbers")
    part = log.between(*scans)
    tracks = result.tracks
    order = np.argsort(part.rows, kind="stable")
    at = np.searchsorted(part.rows[order], tracks.row)
    same = [part.first_iteration, part.end_iteration] == scans and bool((at < len(order)).all())
    if same:
        at = order[at]
        same = np.array_equal(part.rows[at], tracks.row)
        same = same and np.array_equal(part.iteration[at], tracks.iteration)
    if not same:
        raise RelmapError("the log is not the one that was mapped: its rows or iterations differ")
    return part


def match_landmarks(
    result: Result, truth: Truth, identified: Identified | None
) -> MatchedLandmarks | None:
    """Pair the mapped static landmarks with their true places and align the two.

    Returns
    -------
    MatchedLandmarks or None
        None where nothing tells which is which.
    """
    if identified is None:
        return None
    labels, ids = _standing_for(result, identified, static=True)
    at = _find(truth.landmark_ids, ids)
    comparable = (truth.status == "static") & np.isfinite(truth.landmarks_map).all(axis=1)
    there = (at >= 0) & comparable[at] if len(comparable) else at >= 0
    position = result.landmarks.position[_find(result.landmarks.landmark, labels[there])]
    true_position = truth.landmarks_map[at[there]]
    R, t = np.eye(3), np.zeros(3)
    d = 2 if result.planar else 3
    R[:d, :d], t[:d] = metrics.align(position[:, :d], true_position[:, :d])
    return MatchedLandmarks(position, true_position, R, t)


def _standing_for(
    result: Result, identified: Identified, static: bool = False
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the labels of mapped landmarks and the true ids that they stand for."""
    labels, ids, _ = metrics.majority_ids(identified.landmark, identified.true_id)
    wanted = result.mapped
    if static:
        wanted = wanted & (result.landmarks.status == "static")
    chosen = np.isin(labels, result.landmarks.landmark[wanted])
    return labels[chosen], ids[chosen]


def _find(keys: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return where each wanted number stands in the keys, -1 where it does not."""
    if not len(keys):
        return np.full(len(wanted), -1, np.intp)
    order = np.argsort(keys, kind="stable")
    at = order[np.searchsorted(keys[order], wanted).clip(0, len(keys) - 1)]
    return np.where(keys[at] == wanted, at, -1)


def _landmark_figures(
    result: Result, truth: Truth, identified: Identified, matched: MatchedLandmarks
) -> dict[str, float | None]:
    """Return the figures about landmarks, by name."""
    _, ids = _standing_for(result, identified)
    d = 2 if result.planar else 3
    errors = (matched.position @ matched.R.T + matched.t - matched.truth)[:, :d]
    often = metrics.seen_often(identified.seen_id, identified.seen_iteration)
    static = truth.landmark_ids[truth.status == "static"]
    due = np.intersect1d(often, static)
    return {
        "landmark_rmse_m": metrics.rms(errors),
        "coverage": len(np.intersect1d(due, ids)) / len(due) if len(due) else None,
        "landmarks_per_true": len(ids) / len(np.unique(ids)) if len(ids) else None,
        "purity": metrics.purity(identified.landmark, identified.true_id),
    }


def _trajectory_errors(result: Result, truth: Truth) -> tuple[float | None, float | None, int]:
    """Return ATE, RPE and the number of poses that have a true one."""
    mine, other = metrics.match_stamps(result.stamps_s, truth.stamps_s)
    poses, true_poses = result.poses[mine], truth.poses[other]
    ate_m = metrics.ate(poses, true_poses, result.planar)
    return ate_m, metrics.rpe(poses, true_poses, other), len(mine)
