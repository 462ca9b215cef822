"""The path over the whole run, using the motion model where the map is not connected.

Where too few static landmarks are in view, as along a single partial wall, the map splits into
submaps. The motion from one scan to the next is still known approximately: rotation and translation
across the wall from the observations, along it from constant motion (`placement`). Such weak links
only give the initial placement of a submap, and are not used in the refinement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.planes.linking.placement import LEVER_M
from relmap.planes.motions import matrices

FEW, ASTRAY_M = 5, 0.3
"""Maximum number of consecutive misplaced scans, and minimum distance from the others."""


def stitched(submaps: Sequence[Floats], motions: Floats) -> Floats:
    """Return the path in the frame of the first submap.

    `submaps`, sequence of (n, 4, 4): ``T_submap_robot`` of every iteration in each submap, the most
    important one first; NaN if undetermined. `motions` (n, 3): yaw, x, y of the motion from the
    previous robot frame to that of each iteration. Returns (n, 4, 4): ``T_map_robot``; if no submap
    determines any, in the frame of the first iteration.
    """
    n = len(motions)
    steps = np.linalg.inv(matrices(motions))
    poses = np.full((n, 4, 4), np.nan)
    submap = np.full(n, -1)
    for number, own in enumerate(submaps):
        free = (submap < 0) & np.isfinite(own[:, 0, 0])
        submap[free], poses[free] = number, own[free]
    if n and not (submap == 0).any():
        submap[0], poses[0] = 0, np.eye(4)
    fixed = np.flatnonzero(submap == 0)
    if not len(fixed):
        return poses
    placed: dict[int, Floats] = {}
    for i in fixed[0] + np.flatnonzero(submap[fixed[0] :]):
        poses[i] = _placed(placed, submap[i], poses[i], poses[i - 1] @ steps[i])
    for i in reversed(range(fixed[0])):
        back = poses[i + 1] @ np.linalg.inv(steps[i + 1])
        poses[i] = _placed(placed, submap[i], poses[i], back)
    return poses


def _placed(placed: dict[int, Floats], submap: int, own: Floats, expected: Floats) -> Floats:
    """Return the pose of an iteration; place its submap at the predicted pose if necessary."""
    if submap < 0:
        return expected
    if submap not in placed:
        placed[submap] = expected @ np.linalg.inv(own)
    return np.asarray(placed[submap] @ own)


def with_strays_put_back(poses: Floats, motions: Floats) -> Floats:
    """Return the poses (n, 4, 4) with the few misplaced ones corrected.

    Misplaced poses deviate from both neighbours according to the motions (n, 3) from scan to scan:
    scans with hardly any known wall, or a wrong one. They are kept if the motions across them do
    not lead to the next pose either: then the map is torn.
    """
    broken = np.concatenate([[False], _astray(poses, motions)])
    run = np.cumsum(broken)
    size = np.bincount(run)
    beside = np.concatenate([[0], size, [0]])
    stray = (size <= FEW) & (size < np.maximum(beside[:-2], beside[2:]))
    led = stitched([np.where(stray[run][:, None, None], np.nan, poses)], motions)
    ends = 1 + np.flatnonzero(_astray(led, motions))
    stray[run[ends] - 1] = False
    return np.where(stray[run][:, None, None], led, poses)


def _astray(poses: Floats, motions: Floats) -> Bools:
    """Return which poses after the first one (n - 1,) do not follow from the motions (n, 3)."""
    off = np.linalg.inv(poses[:-1]) @ poses[1:] @ matrices(motions[1:])
    turn = np.abs(np.arctan2(off[:, 1, 0], off[:, 0, 0]))
    return np.asarray(np.hypot(off[:, 0, 3], off[:, 1, 3]) + LEVER_M * turn > ASTRAY_M)
