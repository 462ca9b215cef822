"""Steps that may be wrong without large residuals: jumps, and unsteady ones by one landmark only.

Motion is used here to name such steps only, not in the map.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import sums_each
from relmap.planes3d.adjustment import PlaneAdjustment, Scene, Sightings

LOOSE = 1e-12
"""Damping of poses that are undetermined without a landmark, as a fraction of the diagonal with
it."""
LOST, DISPLACED = 0.02, 0.005
"""Standard deviation of the position without a landmark, and displacement, as fractions of the
range, above which a scan depends on it."""
UNSTEADY, UNUSUAL = 0.02, 1.5
"""Difference of an unsteady step from those before and after, as a fraction of the range, and as a
multiple of the median."""
JERK, SEVERAL = 8.0, 6
"""A step that differs by this multiple of the median from those before and after is unreliable
whatever it depends on; of fewer steps than the second value, one that is unsteady."""


def fragile(
    seen: Sightings, scene: Scene, systematic: float, reach_m: Floats
) -> tuple[Ints, Floats]:
    """Return scans that would be elsewhere, or anywhere, without one landmark: (f,).

    `scene`: the poses (p) and planes on which the observations agree; `systematic`: see
    `PlaneAdjustment`; `reach_m` (p,): range of the scans. Returns also the direction (f, 3) in
    which each depends on that landmark, map frame. A scan may occur several times.
    """
    problem = PlaneAdjustment(seen, systematic)
    linear = problem.linearised(scene)
    root = np.sqrt(problem.weights(linear.off))
    by_pose = (linear.by_eliminated * root[:, None]).reshape(-1, 3, 6)
    off = (linear.off * root).reshape(-1, 3)
    # Rotations count by how far they move points at the range.
    by_pose[:, :, :3] /= reach_m[seen.scan, None, None]
    pair, of = np.unique(np.column_stack([seen.scan, seen.plane]), axis=0, return_inverse=True)
    scan, count = pair[:, 0], len(reach_m)
    matrix = sums_each(np.einsum("nki,nkj->nij", by_pose, by_pose), of.ravel(), len(pair))
    pull = sums_each(np.einsum("nki,nk->ni", by_pose, off), of.ravel(), len(pair))
    whole = sums_each(matrix, scan, count)[scan]
    matrix, pull = whole - matrix, sums_each(pull, scan, count)[scan] - pull
    # By the whole: what rounding leaves of a direction without a landmark is not information.
    scale = 1 / np.sqrt(np.maximum(np.einsum("nii->ni", whole), 1e-12))
    matrix = matrix * scale[:, None] * scale[:, :, None] + LOOSE * np.eye(6)
    covariance = np.linalg.inv(matrix) * scale[:, None] * scale[:, :, None]
    way = (covariance @ pull[:, :, None])[:, 3:, 0]
    variance, axes = np.linalg.eigh(covariance[:, 3:, 3:])
    lost = np.sqrt(np.maximum(variance[:, 2], 0.0)) > LOST * reach_m[scan]
    way_m = np.linalg.norm(way, axis=1)
    displaced = ~lost & (way_m > DISPLACED * reach_m[scan])
    along = np.concatenate([axes[lost, :, 2], way[displaced] / way_m[displaced, None]])
    return np.concatenate([scan[lost], scan[displaced]]), along


def changes(place: Floats, iteration: Ints) -> Floats:
    """Return by how much each step (p - 1, 3) differs from the mean of those before and after.

    `place` (p, 3), `iteration` (p,): of the scans. Steps are per iteration.
    """
    step = np.diff(place, axis=0) / np.diff(iteration)[:, None]
    if len(step) < 2:
        return np.zeros_like(step)
    around = np.concatenate([step[1:2], step, step[-2:-1]])
    return np.asarray(step - (around[:-2] + around[2:]) / 2)


def unreliable_steps(
    seen: Sightings, scene: Scene, systematic: float, iteration: Ints, reach_m: Floats
) -> Bools:
    """Return which steps (p - 1,) are unsteady in a direction that depends on one landmark.

    So are those that are unsteady by far. Parameters as of `fragile`, and the iterations (p,) of
    the scans.
    """
    scan, along = fragile(seen, scene, systematic, reach_m)
    change = changes(scene.t, iteration)
    size_m = np.linalg.norm(change, axis=1)
    usual_m = float(np.median(size_m))
    jerk_m = JERK * usual_m if len(change) >= SEVERAL else 0.0
    least_m = UNSTEADY * np.minimum(reach_m[1:], reach_m[:-1])
    found = np.asarray(size_m > np.maximum(least_m, jerk_m))
    for step in (scan - 1, scan):
        inside = (step >= 0) & (step < len(change))
        row = step[inside]
        change_m = np.abs(np.einsum("ni,ni->n", change[row], along[inside]))
        found[row[change_m > np.maximum(least_m[row], UNUSUAL * usual_m)]] = True
    return found
