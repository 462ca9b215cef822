"""Initial poses of all scans in one frame: by landmarks, and by odometry across gaps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import sums_each
from relmap.core.map.pose import squares_across, trajectory
from relmap.core.motion_noise import (
    MotionNoise,
    leaps,
    misses_most,
    missing_turn,
    missing_way,
    motion_noise,
    turns_otherwise,
    unit_of,
)
from relmap.core.refinement.condensing import LENGTH, NOWHERE, SegmentRows
from relmap.core.state.table import NONE, LandmarkState

UNSURE, STILL_M = 0.5, 0.01
"""Largest standard deviation of a motion from landmarks that is compared with odometry, relative to
the distance; and for a robot that stands still, metres."""
BESIDE = 16
"""Tied steps on each side that are compared: if it misses most, odometry is not used here."""
TURNS = 0.25
"""Smallest fraction of steps with turns that are measured well."""

LOOSER = 3.0
"""How many times less certain a pose may be from which odometry goes on than one that is shown."""

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

    Both iterations must be in one segment. `motion` (k, 4, 4); `sd_m`, `sd_rad` (k,): standard
    deviations of a coordinate, metres, and of the angle, radians.
    """

    motion: Floats
    sd_m: Floats
    sd_rad: Floats


def measured_motions(rows: SegmentRows) -> Measured:
    """Return the motions by landmarks alone."""
    k, placed = len(rows.iteration_segment), rows.poses
    found = Measured(np.full((k, 4, 4), np.nan), np.full(k, np.nan), np.full(k, np.nan))
    segment = rows.iteration_segment
    tied = 1 + np.flatnonzero((segment[1:] == segment[:-1]) & (segment[1:] != NOWHERE))
    found.motion[tied] = np.linalg.inv(placed[tied - 1]) @ placed[tied]
    each_m, each_rad = _variances(rows)
    found.sd_m[tied] = np.sqrt(each_m[tied - 1] + each_m[tied])
    found.sd_rad[tied] = np.sqrt(each_rad[tied - 1] + each_rad[tied])
    return found


def _is_sure(odometry: Floats, variance: Floats, unit: float) -> Bools:
    """Return which odometry (k, 4, 4) can be evaluated by motions of variances (k,), square metres.

    Accuracy relative to the motion by landmarks would be biased: noise makes distances longer.
    """
    way = np.linalg.norm(odometry[:, :3, 3], axis=1)
    return np.asarray(np.sqrt(variance) <= np.maximum(UNSURE * way, STILL_M * unit))


def _variances(rows: SegmentRows) -> tuple[Floats, Floats]:
    """Return the variances (k,) of a coordinate of the robot in each iteration, and of its angle.

    Square metres and square radians, of a fit to its observations: the error of their mean, and
    of the rotation times the distance to the robot.  Infinite if there is no observation at all.
    """
    k = len(rows.iteration_segment)
    if not len(rows.points):
        return np.full(k, np.inf), np.full(k, np.inf)
    noise = rows.squares.sum() / max(int(rows.freedoms.sum()), 1)
    row, at = rows.sightings
    points = rows.points[row]
    counts = np.maximum(np.bincount(at, minlength=k), 1)
    middle = sums_each(points, at, k) / counts[:, None]
    lever = np.sum((middle - rows.t) ** 2, axis=1)
    turn = noise / np.maximum(squares_across(points, at, k), 1e-12)
    return np.asarray(noise / counts + lever * turn), np.asarray(turn)


def noise_of(
    odometry: Floats, measured: Measured, rows: SegmentRows
) -> tuple[MotionNoise, Bools, Bools]:
    """Return the noise of odometry, estimated from landmarks, and which steps (k,) are wrong.

    Those that contradict landmarks given its noise, and leaps and those that miss most of the
    motion. The noise is estimated over whole segments, where that of the landmarks has less
    influence.
    """
    unit = unit_of(rows.points)
    sure = _is_sure(odometry, measured.sd_m**2, unit)
    compared = np.where(sure[:, None, None], measured.motion, np.nan)
    single = motion_noise(odometry, compared, unit=unit)
    single = single or MotionNoise(sigma_m=MotionNoise.sigma_m * unit)
    slipped = single.slipped(odometry, measured.motion, measured.sd_m, measured.sd_rad)
    misses, missed = _missed(single.corrected(odometry), single.sigma_rad, measured, slipped, rows)
    missed |= leaps(odometry, np.isfinite(odometry[:, 0, 0]), unit) & np.isnan(measured.sd_m)
    without_slips = odometry.copy()
    without_slips[slipped] = np.nan
    composed, seen, steps = _stretches(without_slips, rows)
    wide = motion_noise(composed, seen, unit=unit)
    if wide is None:
        return replace(single, misses=misses), slipped, missed
    root = np.sqrt(steps)
    noise = replace(
        wide,
        sigma_way=wide.sigma_way * root,
        sigma_m=wide.sigma_m / root,
        sigma_rad=wide.sigma_rad / root,
        turn_rad=single.turn_rad,
        misses=misses,
    )
    return noise, slipped, missed


def _missed(
    odometry: Floats, sigma_rad: float, measured: Measured, slipped: Bools, rows: SegmentRows
) -> tuple[bool, Bools]:
    """Return whether odometry misses most of the motion, and in which stretches (k,) it does.

    With gaps next to these. A single step may be an error of landmarks. `sigma_rad`: noise of a
    turn of `odometry`, per step.
    """
    known = np.isfinite(odometry[:, 0, 0])
    tied = known & np.isfinite(measured.sd_m)
    turns_less = missing_turn(odometry, measured.motion, measured.sd_rad)[1]
    without_slips = np.where(slipped[:, None, None], measured.motion, odometry)
    over, turns, turns_less_over, _ = _missing_over(without_slips, sigma_rad, rows)
    missed = over | missing_way(odometry, measured.motion, measured.sd_m, unit_of(rows.points))
    misses = misses_most(tied, missed)
    if turns.sum() > TURNS * tied.sum():  # Fewer may be errors of landmarks.
        misses |= misses_most(turns, turns_less_over)
    _, turns, _, wrong_over = _missing_over(odometry, sigma_rad, rows)
    misses |= misses_most(turns, wrong_over)
    missed |= slipped & turns_less
    return misses, known & (missed | ~tied) & _beside_missed(missed, tied)


def _missing_over(
    odometry: Floats, sigma_rad: float, rows: SegmentRows
) -> tuple[Bools, Bools, Bools, Bools]:
    """Return in which steps (k,) odometry misses most of the way over their whole segment.

    Then, in which steps the segment turns measurably, in which of these odometry misses that, and
    in which of those it turns otherwise.
    """
    segment, k = rows.iteration_segment, len(rows.iteration_segment)
    begins = np.append(True, segment[1:] != segment[:-1])[:k]
    first = np.maximum.accumulate(np.where(begins, np.arange(k), 0))
    composed = np.tile(np.eye(4), (k, 1, 1))
    for step in range(1, LENGTH):
        now = np.flatnonzero((np.arange(k) - first == step) & (segment != NOWHERE))
        composed[now] = composed[now - 1] @ odometry[now]
    last = np.flatnonzero(np.append(begins[1:], True)[:k])
    of, first = np.cumsum(begins) - 1, first[last]
    placed, (each_m, each_rad) = rows.poses, _variances(rows)
    seen = np.linalg.inv(placed[first]) @ placed[last]
    inside = ~begins & (segment != NOWHERE)
    sd_m = np.sqrt(each_m[first] + each_m[last])
    way = missing_way(composed[last], seen, sd_m, unit_of(rows.points))
    turn = missing_turn(composed[last], seen, np.sqrt(each_rad[first] + each_rad[last]))
    wrong = turn[1] & turns_otherwise(composed[last], seen, sigma_rad)
    return inside & way[of], inside & turn[0][of], inside & turn[1][of], inside & wrong[of]


def _beside_missed(missed: Bools, tied: Bools) -> Bools:
    """Return for which steps (k,) most of the next tied ones, on one side, are missed."""
    judges, beyond = np.flatnonzero(tied), np.zeros(BESIDE, dtype=bool)
    sums = np.append(0, np.cumsum(np.concatenate([beyond, missed[judges], beyond])))
    mostly = sums[BESIDE:] - sums[:-BESIDE] > BESIDE / 2
    n = np.searchsorted(judges, np.arange(len(missed)))
    return np.asarray(mostly[n] | mostly[n + BESIDE])


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
    placed, (variance, _) = rows.poses, _variances(rows)
    seen = np.linalg.inv(placed[first]) @ placed[first + steps]
    sure = _is_sure(composed, variance[first] + variance[first + steps], unit_of(rows.points))
    return composed[sure], seen[sure], max(steps, 1)


def bridge(
    table: LandmarkState,
    rows: SegmentRows,
    motions: Floats,
    noise_m: float,
    solved: Floats | None = None,
) -> Bridged:
    """Place all scans in one frame: by submaps where these determine them, else by odometry.

    `motions` (k, 4, 4): odometry, without its constant errors; NaN if unknown. `noise_m`: standard
    deviation of an observed coordinate: two landmarks side by side determine no turn. `solved`
    (k, 4, 4): poses solved for before the map changed, in the frame of the first submap; NaN in
    others.
    """
    k = len(motions)
    poses, part = np.tile(np.eye(4), (k, 1, 1)), np.zeros(k, dtype=np.int64)
    own, submap_of = _poses_in_submaps(table, rows, noise_m)
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


def _poses_in_submaps(
    table: LandmarkState, rows: SegmentRows, noise_m: float
) -> tuple[Floats, Ints]:
    """Return the pose of each iteration (k, 4, 4) in the largest submap that determines it.

    And that submap (k,), or NONE.
    """
    k = len(rows.iteration_segment)
    poses, submap_of = np.full((k, 4, 4), np.nan), np.full(k, NONE)
    for submap in table.submaps:
        positions = np.where((table.submap == submap)[:, None], table.position, np.nan)
        found = trajectory(rows, positions, table.landmark_of, noise_m / LOOSER)
        new = np.isfinite(found[:, 0, 0]) & (submap_of == NONE)
        poses[new], submap_of[new] = found[new], submap
    return poses, submap_of
