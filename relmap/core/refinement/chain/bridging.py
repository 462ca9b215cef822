"""Initial poses of all scans in one frame: by landmarks, and by odometry across gaps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import sums_each
from relmap.core.map.pose import trajectory
from relmap.core.motion_noise import MotionNoise, motion_noise
from relmap.core.refinement.condensing import LENGTH, NOWHERE, SegmentRows
from relmap.core.state.table import NONE, LandmarkState

UNSURE, STILL_M = 0.5, 0.01
"""Largest standard deviation of a motion from landmarks that is compared with odometry, relative to
the distance; and for a robot that stands still, metres."""


LARGEST = -2
"""Marks scans solved for before, instead of their current submap."""


@dataclass(frozen=True, eq=False)
class Bridged:
    """All scans, placed by landmarks and odometry.

    `poses` (k, 4, 4), metres; `part` (k,): scans of different parts have different frames: no
    odometry connects them; `hanging` (h,): iterations that landmarks do not connect to the previous
    one.
    """

    poses: Floats
    part: Ints
    hanging: Ints


class Measured(NamedTuple):
    """The motion to each iteration by landmarks alone; NaN where they do not determine it.

    `motion` (k, 4, 4); `sd_m`, `sd_rad` (k,): standard deviations of a coordinate, metres, and of
    the angle, radians.
    """

    motion: Floats
    sd_m: Floats
    sd_rad: Floats


def measured_motions(odometry: Floats, rows: SegmentRows) -> Measured:
    """Return the motions by landmarks alone.

    Both iterations must be in one segment, and accurate enough to evaluate odometry.
    """
    k, placed = len(rows.iteration_segment), _placed(rows)
    found = Measured(np.full((k, 4, 4), np.nan), np.full(k, np.nan), np.full(k, np.nan))
    segment = rows.iteration_segment
    tied = 1 + np.flatnonzero((segment[1:] == segment[:-1]) & (segment[1:] != NOWHERE))
    motions = np.linalg.inv(placed[tied - 1]) @ placed[tied]
    each_m, each_rad = _variances(rows)
    squares_m, squares_rad = each_m[tied - 1] + each_m[tied], each_rad[tied - 1] + each_rad[tied]
    sure = _is_sure(odometry[tied], squares_m)
    tied = tied[sure]
    found.motion[tied] = motions[sure]
    found.sd_m[tied], found.sd_rad[tied] = np.sqrt(squares_m[sure]), np.sqrt(squares_rad[sure])
    return found


def _placed(rows: SegmentRows) -> Floats:
    """Return the pose of each iteration (k, 4, 4) in the frame of its segment."""
    d = rows.points.shape[1]
    placed = np.tile(np.eye(4), (len(rows.iteration_segment), 1, 1))
    placed[:, :d, :d], placed[:, :d, 3] = rows.R, rows.t
    return placed


def _is_sure(odometry: Floats, variance: Floats) -> Bools:
    """Return which odometry (k, 4, 4) can be evaluated by motions of variances (k,), square metres.

    Accuracy relative to the motion by landmarks would be biased: noise makes distances longer.
    """
    way = np.linalg.norm(odometry[:, :3, 3], axis=1)
    return np.asarray(np.sqrt(variance) <= np.maximum(UNSURE * way, STILL_M))


def _variances(rows: SegmentRows) -> tuple[Floats, Floats]:
    """Return the variances (k,) of a coordinate of the robot in each iteration, and of its angle.

    Square metres and square radians, of a fit to its observations: the error of their mean, and
    of the rotation times the distance to the robot.  Infinite if there is no observation at all.
    """
    k = len(rows.iteration_segment)
    if not len(rows.points):
        return np.full(k, np.inf), np.full(k, np.inf)
    noise = rows.squares.sum() / max(int(rows.freedoms.sum()), 1)
    row, bit = np.nonzero((rows.visible[:, None] >> np.arange(LENGTH)) & 1)
    at, points = rows.first_iteration[rows.segment[row]] + bit, rows.points[row]
    counts = np.maximum(np.bincount(at, minlength=k), 1)
    middle = sums_each(points, at, k) / counts[:, None]
    spread = np.bincount(at, np.sum((points - middle[at]) ** 2, axis=1), minlength=k)
    lever = np.sum((middle - rows.t) ** 2, axis=1)
    turn = noise / np.maximum(spread, 1e-12)
    return np.asarray(noise / counts + lever * turn), np.asarray(turn)


def noise_of(odometry: Floats, measured: Measured, rows: SegmentRows) -> tuple[MotionNoise, Bools]:
    """Return the noise of odometry, estimated from landmarks, and which steps (k,) are wrong.

    Wrong steps are found one by one.  The noise is estimated over whole segments, where that of
    the landmarks has less influence.
    """
    single = motion_noise(odometry, measured.motion) or MotionNoise()
    slipped = single.slipped(odometry, measured.motion, measured.sd_m, measured.sd_rad)
    without_slips = odometry.copy()
    without_slips[slipped] = np.nan
    composed, seen, steps = _stretches(without_slips, rows)
    wide = motion_noise(composed, seen)
    if wide is None:
        return single, slipped
    root = np.sqrt(steps)
    return replace(
        wide,
        sigma_way=wide.sigma_way * root,
        sigma_m=wide.sigma_m / root,
        sigma_rad=wide.sigma_rad / root,
    ), slipped


def _stretches(odometry: Floats, rows: SegmentRows) -> tuple[Floats, Floats, float]:
    """Return odometry over whole segments (s, 4, 4), the same by landmarks, and their length."""
    segment = rows.iteration_segment
    inside = np.flatnonzero(segment != NOWHERE)
    _, first, counts = np.unique(segment[inside], return_index=True, return_counts=True)
    first = inside[first]
    steps = int(np.median(counts)) - 1 if len(counts) else 0
    first = first[(counts == steps + 1) & (first + steps < len(segment))]
    first = first[segment[first] == segment[first + steps]] if steps > 0 else first[:0]
    composed = np.tile(np.eye(4), (len(first), 1, 1))
    for step in range(1, steps + 1):
        composed = composed @ odometry[first + step]
    placed, (variance, _) = _placed(rows), _variances(rows)
    seen = np.linalg.inv(placed[first]) @ placed[first + steps]
    sure = _is_sure(composed, variance[first] + variance[first + steps])
    return composed[sure], seen[sure], max(steps, 1)


def bridge(
    table: LandmarkState, rows: SegmentRows, motions: Floats, solved: Floats | None = None
) -> Bridged:
    """Place all scans in one frame: by submaps where these determine them, else by odometry.

    `motions` (k, 4, 4): odometry, without its constant errors; NaN if unknown. `solved` (k, 4, 4):
    poses solved for before the map changed, in the frame of its largest submap; NaN in others.
    """
    k = len(motions)
    poses, part = np.tile(np.eye(4), (k, 1, 1)), np.zeros(k, dtype=np.int64)
    own, submap_of = _poses_in_submaps(table, rows)
    if solved is not None and len(solved) == k:
        known = np.isfinite(solved[:, 0, 0])
        own[known], submap_of[known] = solved[known], LARGEST
    frames: dict[int, tuple[int, Floats]] = {}
    for i in range(k):
        submap = int(submap_of[i])
        if submap in frames:
            part[i], frame = frames[submap]
            poses[i] = frame @ own[i]
            if i and part[i - 1] != part[i] and np.isfinite(motions[i, 0, 0]):
                before = np.flatnonzero(part[:i] == part[i - 1])
                move = poses[i] @ np.linalg.inv(poses[i - 1] @ motions[i])
                frames |= {
                    other: (int(part[i]), move @ lies)
                    for other, (of, lies) in frames.items()
                    if of == part[i - 1]
                }
                poses[before], part[before] = move @ poses[before], part[i]
            continue
        if i and np.isfinite(motions[i, 0, 0]):
            part[i], poses[i] = part[i - 1], poses[i - 1] @ motions[i]
        elif i:
            part[i] = part.max() + 1
        if submap != NONE:
            frames[submap] = int(part[i]), poses[i] @ np.linalg.inv(own[i])
    tied = (submap_of[1:] == submap_of[:-1]) & (submap_of[1:] != NONE)
    return Bridged(poses, part, 1 + np.flatnonzero(~tied))


def _poses_in_submaps(table: LandmarkState, rows: SegmentRows) -> tuple[Floats, Ints]:
    """Return the pose of each iteration (k, 4, 4) in the largest submap that determines it.

    And that submap (k,), or NONE.
    """
    k = len(rows.iteration_segment)
    poses, submap_of = np.full((k, 4, 4), np.nan), np.full(k, NONE)
    submaps, sizes = np.unique(table.submap[table.submap != NONE], return_counts=True)
    for submap in submaps[np.argsort(-sizes, kind="stable")].tolist():
        positions = np.where((table.submap == submap)[:, None], table.position, np.nan)
        found = trajectory(rows, positions, table.landmark_of)
        new = np.isfinite(found[:, 0, 0]) & (submap_of == NONE)
        poses[new], submap_of[new] = found[new], submap
    return poses, submap_of
