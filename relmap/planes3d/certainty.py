"""How well the observations of a submap determine its planes, and each step from scan to scan.

Some steps may be wrong without large residuals: jumps, and unsteady ones by one landmark only.
Motion is used here to name such steps only, not in the map.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import sums_each
from relmap.planes3d.adjustment import PlaneAdjustment, Scene, Sightings, across

AROUND, AT_ONCE = 12, 12
"""Scans before and after a step from which its covariance is computed, and steps processed at
once."""
LOOSE, LOOSE_PLANE = 1e-11, 1e-9
"""Damping that keeps undetermined poses and planes finite, as a fraction of the diagonal."""
LOOSE_POSE = 1e-12
"""Damping of poses that are undetermined without a landmark, as a fraction of the diagonal with
it."""
LOST, DISPLACED = 0.02, 0.005
"""Standard deviation of the position without a landmark, and displacement, as fractions of the
range, above which a scan depends on it."""
UNSTEADY, UNUSUAL = 0.02, 1.5
"""Difference of an unsteady step from those before and after, as a fraction of the range, and as a
multiple of the median."""
NEARBY = 8
"""Maximum number of steps between one that depends on a landmark and others it is compared with."""
JERK, SEVERAL = 8.0, 6
"""A step that differs by this multiple of the median from those before and after is unreliable
whatever it depends on; of fewer steps than the second value, one that is unsteady."""
UNLIKE = 0.01
"""So is one that differs by that multiple of the median, and by this fraction of the range, from
most of the `NEARBY` steps before or after, along the axes of the scans: several landmarks may move
with the sensor for some scans. Where the sensor itself stops, some steps are listed as well."""
TURN_JERK, TURN_RAD = 6.0, np.deg2rad(5.0)
"""So is one whose rotation differs by this multiple of the median, and by more than the second
value: a room that looks the same from two sides gives a fast turn as a slow one."""


def plane_covariances(seen: Sightings, scene: Scene, systematic: float) -> Floats:
    """Return the covariance of each plane in the frame of the first scan.

    `scene`, `systematic`: see `step_covariances`. Returns (l, 4, 4): of the normal, and of the
    offset ``normal @ x`` of its points, metres.
    """
    problem = PlaneAdjustment(seen, systematic)
    weight, pattern = problem.weights(problem.residuals(scene)), problem.pattern
    factor = problem.equations(scene, weight, True, 0.0).matrix
    pattern.factorise(factor)
    own = pattern.first[:, None] + np.arange(3)
    by = np.zeros((len(own), 4, 3))
    for k, axis in enumerate(across(scene.normal)):
        by[:, :3, k], by[:, 3, k] = axis, (axis * scene.base).sum(axis=1)
    by[:, 3, 2] = 1.0
    return np.asarray(by @ pattern.parts(pattern.inverse(factor), own) @ by.transpose(0, 2, 1))


def step_covariances(seen: Sightings, scene: Scene, systematic: float) -> Floats:
    """Return the covariance of each step, of its rotation and its translation.

    Only scans within 12 of a step count: what scans farther away add, as at a revisit, is left out,
    so that the cost is linear in the number of scans.

    `scene`: the poses (p) and planes on which the observations agree; `systematic`: common error of
    the points of an observation, as a fraction of their noise. Returns (p - 1, 6, 6): rotation
    vector, radians, and translation, metres, along the axes of the later scan.
    """
    problem = PlaneAdjustment(seen, systematic)
    linear = problem.linearised(scene)
    root = np.sqrt(problem.weights(linear.off))[:, None]
    by_pose = (linear.by_eliminated * root).reshape(-1, 3, 6)
    by_plane = (linear.by_kept * root).reshape(-1, 3, 3)
    last = len(scene.R) - 1
    found = np.zeros((last, 6, 6))
    for first in range(0, last, AT_ONCE):
        steps = np.arange(first, min(first + AT_ONCE, last))
        begin, end = max(first - AROUND, 0), min(first + AT_ONCE + AROUND, last + 1)
        rows = np.arange(*np.searchsorted(seen.scan, [begin, end]))
        matrix = _reduced(
            seen.scan[rows] - begin, seen.plane[rows], by_pose[rows], by_plane[rows], end - begin
        )
        found[steps] = _of_steps(matrix, scene, begin, steps)
    return found


def _reduced(scan: Ints, plane: Ints, by_pose: Floats, by_plane: Floats, count: int) -> Floats:
    """Return the information (6 count, 6 count) of poses, with the planes eliminated."""
    number = np.unique(plane, return_inverse=True)[1]
    poses, planes = np.zeros((count, count, 6, 6)), np.zeros((number.max() + 1, 3, 3))
    mixed = np.zeros((len(planes), count, 6, 3))
    np.add.at(poses, (scan, scan), np.einsum("nki,nkj->nij", by_pose, by_pose))
    np.add.at(planes, number, np.einsum("nki,nkj->nij", by_plane, by_plane))
    np.add.at(mixed, (number, scan), np.einsum("nki,nkj->nij", by_pose, by_plane))
    trace = np.trace(planes, axis1=1, axis2=2)
    planes += LOOSE_PLANE * trace[:, None, None] * np.eye(3)
    # The inverse of a strip, whose tilt is hardly determined, may not be positive definite.
    root, right = np.linalg.cholesky(planes), mixed.reshape(len(planes), -1, 3).transpose(0, 2, 1)
    eliminated = np.linalg.solve(root, right).transpose(2, 0, 1).reshape(6 * count, -1)
    whole = poses.transpose(0, 2, 1, 3).reshape(6 * count, -1)
    return np.asarray(whole - eliminated @ eliminated.T)


def _of_steps(matrix: Floats, scene: Scene, begin: int, steps: Ints) -> Floats:
    """Return the covariances (s, 6, 6) of steps from the information of the poses around them."""
    covariance = _inverse(matrix, steps[0] - begin).reshape(len(matrix) // 6, 6, -1, 6)
    found = np.empty((len(steps), 6, 6))
    one, none = np.eye(3), np.zeros((3, 3))
    for row, k in enumerate(steps.tolist()):
        a, R = k - begin, scene.R[k + 1]
        x, y, z = scene.t[k + 1] - scene.t[k]
        # A rotation of the earlier scan moves the later one.
        arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        by = np.block([[-one, none, one, none], [arm, -one, none, one]])
        by = np.kron(np.eye(2), R.T) @ by
        found[row] = by @ covariance[a : a + 2, :, a : a + 2].reshape(12, 12) @ by.T
    return found


def _inverse(matrix: Floats, fixed: int) -> Floats:
    """Return the covariance (n, n) of poses in the frame of one of them."""
    free = np.delete(np.arange(len(matrix)), 6 * fixed + np.arange(6))
    part = matrix[np.ix_(free, free)]
    scale = 1 / np.sqrt(np.maximum(np.diag(part), 1e-12 * np.diag(part).max()))
    part = part * scale * scale[:, None] + LOOSE * np.eye(len(free))
    covariance = np.zeros_like(matrix)
    covariance[np.ix_(free, free)] = np.linalg.inv(part) * scale * scale[:, None]
    return covariance


def fragile(
    seen: Sightings, scene: Scene, systematic: float, reach_m: Floats
) -> tuple[Ints, Ints, Floats]:
    """Return scans that would be elsewhere, or anywhere, without one landmark: (f,).

    `scene`: the poses (p) and planes on which the observations agree; `systematic`: see
    `PlaneAdjustment`; `reach_m` (p,): range of the scans. Returns also that landmark (f,), and the
    direction (f, 3) in which each scan depends on it, map frame. A scan may occur several times.
    """
    problem = PlaneAdjustment(seen, systematic)
    linear = problem.linearised(scene)
    root = np.sqrt(problem.weights(linear.off))
    by_pose = (linear.by_eliminated * root[:, None]).reshape(-1, 3, 6)
    off = (linear.off * root).reshape(-1, 3)
    # Rotations count by how far they move points at the range.
    by_pose[:, :, :3] /= reach_m[seen.scan, None, None]
    pair, of = np.unique(np.column_stack([seen.scan, seen.plane]), axis=0, return_inverse=True)
    (scan, plane), count = pair.T, len(reach_m)
    matrix = sums_each(np.einsum("nki,nkj->nij", by_pose, by_pose), of.ravel(), len(pair))
    pull = sums_each(np.einsum("nki,nk->ni", by_pose, off), of.ravel(), len(pair))
    whole = sums_each(matrix, scan, count)[scan]
    matrix, pull = whole - matrix, sums_each(pull, scan, count)[scan] - pull
    # By the whole: what rounding leaves of a direction without a landmark is not information.
    scale = 1 / np.sqrt(np.maximum(np.einsum("nii->ni", whole), 1e-12))
    matrix = matrix * scale[:, None] * scale[:, :, None] + LOOSE_POSE * np.eye(6)
    covariance = np.linalg.inv(matrix) * scale[:, None] * scale[:, :, None]
    way = (covariance @ pull[:, :, None])[:, 3:, 0]
    variance, axes = np.linalg.eigh(covariance[:, 3:, 3:])
    lost = np.sqrt(np.maximum(variance[:, 2], 0.0)) > LOST * reach_m[scan]
    way_m = np.linalg.norm(way, axis=1)
    displaced = ~lost & (way_m > DISPLACED * reach_m[scan])
    along = np.concatenate([axes[lost, :, 2], way[displaced] / way_m[displaced, None]])
    rows = np.concatenate([np.flatnonzero(lost), np.flatnonzero(displaced)])
    return scan[rows], plane[rows], along


def turn_changes(R: Floats, iteration: Ints) -> Floats:
    """Return by how much each rotation (p - 1, 3) differs from those before and after, radians.

    `R` (p, 3, 3): of the scans; see `changes`. Rotation vectors are along the axes of the scans.
    """
    return changes(Rotation.from_matrix(R[:-1].transpose(0, 2, 1) @ R[1:]).as_rotvec(), iteration)


def changes(step: Floats, iteration: Ints) -> Floats:
    """Return by how much steps (p - 1, 3) differ from the mean of those before and after.

    Per iteration; `iteration` (p,): of the scans.
    """
    step = step / np.diff(iteration)[:, None]
    if len(step) < 2:
        return np.zeros_like(step)
    around = np.concatenate([step[1:2], step, step[-2:-1]])
    return np.asarray(step - (around[:-2] + around[2:]) / 2)


def unreliable_steps(
    seen: Sightings, scene: Scene, systematic: float, iteration: Ints, reach_m: Floats
) -> Bools:
    """Return which steps (p - 1,) are unsteady in a direction that depends on one landmark.

    It also returns those that are unsteady by far, that are unlike most of those before or after,
    or whose rotation is unsteady. Parameters as of `fragile`, and the iterations (p,) of the scans.
    """
    scan, landmark, along = fragile(seen, scene, systematic, reach_m)
    change = changes(np.diff(scene.t, axis=0), iteration)
    size_m = np.linalg.norm(change, axis=1)
    usual_m = float(np.median(size_m))
    jerk_m = JERK * usual_m if len(change) >= SEVERAL else 0.0
    range_m = np.minimum(reach_m[1:], reach_m[:-1])
    least_m = UNSTEADY * range_m
    found = np.asarray(size_m > np.maximum(least_m, jerk_m))
    if len(change) >= NEARBY:
        usual = usual_steps(scene.R, scene.t, iteration)
        unlike_m = np.array([np.linalg.norm(each - each[0], axis=1).max() for each in usual])
        found |= unlike_m > np.maximum(UNLIKE * range_m, JERK * np.median(unlike_m))
    turn = np.linalg.norm(turn_changes(scene.R, iteration), axis=1)
    if len(turn) >= SEVERAL:
        found |= turn > max(TURN_RAD, TURN_JERK * float(np.median(turn)))
    step = np.diff(scene.t, axis=0) / np.diff(iteration)[:, None]
    limit_m = np.maximum(least_m, UNUSUAL * usual_m)
    for rows in (np.flatnonzero(landmark == one) for one in np.unique(landmark)):
        own = np.concatenate([scan[rows] - 1, scan[rows]])
        inside = (own >= 0) & (own < len(step))
        own, way = own[inside], np.tile(along[rows], (2, 1))[inside]
        for differs in (change[own], _unlike_others(step, own)):
            off_m = np.abs(np.einsum("ni,ni->n", differs, way))
            found[own[off_m > limit_m[own]]] = True
    return found


def usual_steps(R: Floats, t: Floats, iteration: Ints) -> list[Floats]:
    """Return each step (p - 1), and the medians of those before and of those after it: (1..3, 3).

    Per iteration, along the axes of the earlier scan, metres; medians of at least half of `NEARBY`
    steps. `R` (p, 3, 3), `t` (p, 3), `iteration` (p,): of the scans.
    """
    step = np.einsum("nji,nj->ni", R[:-1], np.diff(t, axis=0)) / np.diff(iteration)[:, None]
    around = [(step[max(k - NEARBY, 0) : k], step[k + 1 :][:NEARBY]) for k in range(len(step))]
    usual = [[np.median(x, axis=0) for x in each if 2 * len(x) >= NEARBY] for each in around]
    return [np.array([own, *each]) for own, each in zip(step, usual, strict=True)]


def _unlike_others(step: Floats, own: Ints) -> Floats:
    """Return by how much steps (k,) differ from the nearest that do not depend on their landmark.

    What moves does so steadily for some scans. `step` (p - 1, 3): all; `own` (k,): all that depend
    on the landmark. 0 where no other is near.
    """
    far = [-1 - NEARBY], np.setdiff1d(np.arange(len(step)), own), [len(step) + NEARBY]
    others = np.concatenate(far)
    at = np.searchsorted(others, own)
    other = np.column_stack([others[at - 1], others[at]])
    near = (np.abs(other - own[:, None]) <= NEARBY)[:, :, None]
    sums = (near * step[other.clip(0, len(step) - 1)]).sum(axis=1)
    return np.where(near.any(axis=1), step[own] - sums / np.maximum(near.sum(axis=1), 1), 0.0)
