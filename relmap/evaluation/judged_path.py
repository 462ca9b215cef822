"""The errors of a path, unless the times or the axes of the truth make them meaningless.

Checked relations: R. Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous
Robots 27, 2009.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats
from relmap.core.geometry.alignment import rotation_of_moment
from relmap.core.geometry.motions import transforms
from relmap.datasets import Relations
from relmap.datasets.scans import planar_poses
from relmap.evaluation import metrics
from relmap.evaluation.truth import Truth
from relmap.io.results import Result

OTHER_AXES = "no RPE: the poses of the truth have other axes"
"""Beginning of the note that says so."""
FEWEST = 3
"""Poses that leave an error after alignment."""
PART = 0.5
"""Fraction of the poses below which it is said that errors are of these only."""
UNEXPLAINED = 0.7
"""Largest error with other axes, relative to the error without, that shows that axes differ; of
few steps less, as a turn explains some of any."""
MIRRORED = 0.2
"""Largest error of the mirrored path, relative to the error, that shows that a map is mirrored."""
TURNED_RAD = np.deg2rad(20.0)
"""Smallest angle between the steps in different axes: a smaller one may be an error of the map."""
ROUNDING_M = 1e-6
"""Errors below this may be due to rounding."""
UNIT = 100.0
"""Ratio of the sizes of two paths that only different units explain."""
AT_SCANS_S = 0.03
"""Largest time from either end of a relation to a scan for which the path is not interpolated
much: a robot turns by a degree meanwhile."""


def judge_path(result: Result, truth: Truth) -> tuple[dict[str, float | None], list[str]]:
    """Compare a path with the true one.

    Returns `figures`: `ate_m` and `rpe_m` of `Evaluation`, where available; `notes`: reasons for
    missing ones, and which part of the run they are of.
    """
    poses, true_poses, instants = truth.poses_of(result)
    n, of = len(poses), len(result.stamps_s)
    if not len(truth.stamps_s):
        return {}, []
    spans = f"({_span(result.stamps_s)}, true: {_span(truth.stamps_s)})"
    missing = "no ATE and no RPE: "
    if not n:
        return {}, [f"{missing}no pose of the result has the time of a true one {spans}"]
    common = f"{n} of {of} poses have the times of true ones"
    if n < min(FEWEST, of):
        return {}, [f"{missing}only {common} {spans}"]
    notes = [f"ATE and RPE are of a part of the path: {common} {spans}"] * (n < PART * of)
    notes += _apart(result)
    notes += _other_unit(poses, true_poses)
    ate_m, note = _ate(poses, true_poses, result.planar)
    notes += note
    rpe_m = metrics.rpe(poses, true_poses, instants)
    if rpe_m is not None:
        rpe_m, note = _rpe(poses, true_poses, instants, rpe_m)
        notes += note
    elif n > 1:
        notes.append(f"no RPE: {common}, and other true poses lie between them")
    return {"ate_m": ate_m, "rpe_m": rpe_m}, notes


def _span(stamps_s: Floats) -> str:
    return f"{stamps_s.min():.10g} to {stamps_s.max():.10g} s" if len(stamps_s) else "none"


def _apart(result: Result) -> list[str]:
    """Return a note if the path leaves out other submaps."""
    submaps, counts = (result.summary.get(name) for name in ("submaps", "counts"))
    scans = counts.get("iterations") if isinstance(counts, dict) else None
    if not isinstance(submaps, list) or len(submaps) < 2 or not isinstance(scans, int):
        return []
    which = f"the path is that of the map, the first of {len(submaps)} submaps"
    return [f"{which}: {len(result.poses)} of {scans} scans"]


def _other_unit(poses: Floats, true_poses: Floats) -> list[str]:
    """Return a note if the paths differ so much in size that one is not in metres."""
    found_m, true_m = (
        metrics.rms(at - at.mean(axis=0)) or 0.0 for at in (poses[:, :3, 3], true_poses[:, :3, 3])
    )
    if not min(found_m, true_m) or max(found_m, true_m) < UNIT * min(found_m, true_m):
        return []
    times = true_m / found_m
    return [
        f"the true path is {times:.4g} times as large as that of the result: are both in metres?"
    ]


def _ate(poses: Floats, true_poses: Floats, planar: bool) -> tuple[float | None, list[str]]:
    """Return the ATE; for a path in the plane None, and a note, if the true plane is another.

    A note also if it is the mirror image of the true one.
    """
    ate_m = metrics.ate(poses, true_poses, planar)
    in_space_m = metrics.ate(poses, true_poses, False)
    if not planar or ate_m is None or in_space_m is None:
        return ate_m, []
    if in_space_m >= UNEXPLAINED * ate_m or ate_m < ROUNDING_M:
        return ate_m, []
    mirrored_m = metrics.ate(np.diag([1.0, -1.0, -1.0, 1.0]) @ poses, true_poses, planar)
    if mirrored_m is not None and mirrored_m < MIRRORED * ate_m:
        why = "the path is the mirror image of the true one: y and bearings must be positive to the"
        return ate_m, [f"{why} left; mirrored, its ATE is {mirrored_m:.4f} m"]
    why = "the true path lies in another plane than that of x and y, as in the axes of a camera"
    return None, [f"no ATE: {why}; aligned in space it is {in_space_m:.4f} m"]


def _rpe(
    poses: Floats, true_poses: Floats, instant: NDArray[np.intp], rpe_m: float
) -> tuple[float | None, list[str]]:
    """Return the RPE; None, and a note, if the true poses have other axes than the robot."""
    step = np.flatnonzero(np.diff(instant) == 1)
    moved, truly = (
        np.linalg.solve(each[step], each[step + 1])[:, :3, 3] for each in (poses, true_poses)
    )
    R = rotation_of_moment(truly.T @ moved).T  # from the axes of the result to the truth's
    turned_m = metrics.rpe(poses, true_poses @ transforms(R, np.zeros(3)), instant)
    lengths = np.linalg.norm(moved, axis=1) @ np.linalg.norm(truly, axis=1)
    alike = (moved * truly).sum() >= np.cos(TURNED_RAD) * lengths
    assert turned_m is not None
    if alike or turned_m >= UNEXPLAINED * (1 - 3 / len(step)) * rpe_m:
        return rpe_m, []
    which = "than those of the result, as those of a camera"
    return None, [f"{OTHER_AXES} {which}; with these turned it is {turned_m:.4f} m"]


def judge_relations(result: Result, truth: Truth) -> tuple[dict[str, float | None], list[str]]:
    """Return the errors of checked relations, and how many there are away from scans."""
    every = relation_errors(result.stamps_s, result.poses, truth.relations)
    if every is None:
        none = "no checked relation lies within the times of the result"
        return {}, [none] * bool(truth.relations)
    figures: dict[str, float | None] = {"relation_m": every.shift_m, "relation_rad": every.turn_rad}
    at_scans = relation_errors(result.stamps_s, result.poses, truth.relations, AT_SCANS_S)
    n = at_scans.n if at_scans else 0
    error = f": {at_scans.shift_m:.3f} m, {at_scans.turn_rad:.4f} rad" if at_scans else ""
    which = f"{n} of {every.n} checked relations have both ends within {AT_SCANS_S} s of scans"
    return figures, [f"{which}{error}; the path is interpolated to the others"] * (n < every.n)


class RelationErrors(NamedTuple):
    """Mean error of `n` relations, metres and radians."""

    shift_m: float
    turn_rad: float
    n: int


def relation_errors(
    stamps_s: Floats, poses: Floats, relations: tuple[Relations, ...], near_s: float = np.inf
) -> RelationErrors | None:
    """Return the mean error of a path against checked relations (Kuemmerle et al., 2009).

    `stamps_s` (k,), ascending. `poses` (k, 4, 4): ``T_map_robot``; interpolated in between.
    `relations`: the same relations by several clocks; the clock with most relations within the
    stamps is used. `near_s`: largest time from either end of a relation to a stamp; interpolation
    adds its own error to the others. Returns None if there is no such relation within the stamps.
    """
    if not len(stamps_s) or not relations:
        return None
    both_s = [np.column_stack([one.begin_s, one.end_s]) for one in relations]
    inside = [((ends >= stamps_s[0]) & (ends <= stamps_s[-1])).all(axis=1) for ends in both_s]
    best = int(np.argmax([rows.sum() for rows in inside]))
    rows, own = inside[best], relations[best]
    away_s = np.asarray(cKDTree(stamps_s[:, None]).query(both_s[best][..., None])[0])
    rows &= away_s.max(axis=1) <= near_s
    if not rows.any():
        return None
    T_begin = _poses_at(stamps_s, poses, own.begin_s[rows])
    T_end = _poses_at(stamps_s, poses, own.end_s[rows])
    off = np.linalg.inv(own.T_begin_end[rows]) @ np.linalg.inv(T_begin) @ T_end
    shift = np.hypot(off[:, 0, 3], off[:, 1, 3])
    turn = np.abs(np.arctan2(off[:, 1, 0], off[:, 0, 0]))
    return RelationErrors(float(shift.mean()), float(turn.mean()), int(rows.sum()))


def _poses_at(stamps_s: Floats, poses: Floats, when: Floats) -> Floats:
    """Return planar poses at given times, interpolated between those of the scans."""
    yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    x, y, angle = (np.interp(when, stamps_s, values) for values in (*poses[:, :2, 3].T, yaw))
    return planar_poses(x, y, angle)
