"""The errors of a path, unless the times or the axes of the truth make them meaningless."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats
from relmap.core.geometry.alignment import rotation_of_moment
from relmap.core.geometry.motions import transforms
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
