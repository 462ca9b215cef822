"""Odometry of logs: the motion of the robot between iterations.

A motion is the pose (4, 4) of the robot in its own frame one iteration before; NaN if unknown.
Motions come from the log itself or from a file beside it:

* ``odometry.csv`` or ``odometry.csv.gz``: header ``iteration,x,y,yaw`` or
  ``iteration,x,y,z,qx,qy,qz,qw``, the motion from the previous iteration to this one. Without a row
  the motion is unknown, and so it is where sorting by time gives a scan another predecessor.
* ``odometry.tum``: lines ``t x y z qx qy qz qw``, poses in one odometry frame, at the log's times
  or at others: poses are interpolated.
"""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from relmap.core.arrays import Floats, Ints
from relmap.core.odometry import motion_from_velocity
from relmap.datasets.assembly import MAX_COORDINATE_M, iteration_column, metres_column
from relmap.datasets.base import ObservationLog
from relmap.datasets.headers import file_beside
from relmap.datasets.number_rows import read_rows
from relmap.datasets.scans import ScanLog, planar_poses, poses_of
from relmap.datasets.table import Column, Table, read_table
from relmap.datasets.textfile import invalid, replacing, warn

TABLES, TRAJECTORY = ("odometry.csv", "odometry.csv.gz"), "odometry.tum"
"""Names of the odometry files beside a log."""

GAP = 10.0
"""Multiple of the usual time between two poses above which there is a gap."""

RARE = 0.75
"""Number of poses per scan below which interpolated motions are worth a warning."""

LEAST_GAP_S = 2.0
"""Minimum time between two speeds that is a gap: they may be logged only when they change."""

Log = TypeVar("Log", ObservationLog, ScanLog)

_PLANAR, _SPATIAL = ("x", "y", "yaw"), ("x", "y", "z", "qx", "qy", "qz", "qw")
_COLUMNS = (
    iteration_column("iteration"),
    metres_column("x"),
    metres_column("y"),
    metres_column("z", required=False),
    Column("yaw", -1e3, 1e3, "radians", required=False),
    *(Column(name, -1.001, 1.001, required=False) for name in _SPATIAL[3:]),
)
_TUM_LIMITS = (1e12, *[MAX_COORDINATE_M] * 3, *[1.001] * 4)
_UNIT = 1e-2
"""Tolerance of the length of a quaternion, for rounded files."""


def motions(poses: Floats) -> Floats:
    """Return the motion from the previous to each of the poses (k, 4, 4); NaN for the first."""
    found = np.full(poses.shape, np.nan)
    found[1:] = relative(poses[:-1], poses[1:])
    return found


def path_of(odometry: Floats) -> Floats:
    """Return the poses (k, 4, 4) integrated from motions; unknown motions are ignored."""
    steps = np.where(np.isnan(odometry), np.eye(4), odometry)
    return np.array([*accumulate(steps[1:], np.matmul, initial=np.eye(4))])


def moved_frame(odometry: Floats, T_robot_other: Floats) -> Floats:
    """Return the motions (k, 4, 4) of a frame (4, 4) fixed on the robot."""
    return np.asarray(relative(T_robot_other, np.eye(4)) @ odometry @ T_robot_other)


def driven(
    file: Path, stamps_s: Floats, speed_m_s: Floats, turn_rad_s: Floats, at_s: Floats
) -> Floats:
    """Return the motions of a vehicle between times, integrated from forward and angular speed.

    `file`: named in the warning of gaps. `stamps_s`, `speed_m_s`, `turn_rad_s` (n,): each speed and
    turn rate applies until the next stamp; the stamps ascend. `at_s` (k,). Returns (k, 4, 4): NaN
    for the first, before the first stamp, later than `GAP` usual steps after the last, and across a
    gap between stamps, also longer than `LEAST_GAP_S`.
    """
    step = np.diff(stamps_s)
    usual = float(np.median(step)) if len(step) else 1.0
    before = np.searchsorted(stamps_s, at_s, side="right") - 1
    known = (before >= 0) & (at_s <= stamps_s[-1] + GAP * usual)
    before = np.maximum(before, 0)
    arcs = motion_from_velocity(speed_m_s[: len(step)], turn_rad_s[: len(step)], step).T
    begun = np.concatenate([np.zeros((1, 3)), arcs])
    yaw = np.cumsum(begun[:, 2])
    start = np.concatenate([[0.0], yaw[:-1]])
    xy = np.cumsum(_turned(begun[:, :2], start), axis=0)
    lasts_s = at_s - stamps_s[before]
    rest = motion_from_velocity(speed_m_s[before], turn_rad_s[before], lasts_s).T
    x, y = (xy[before] + _turned(rest[:, :2], yaw[before])).T
    poses = planar_poses(x, y, yaw[before] + rest[:, 2])
    gap = np.append(step > max(GAP * usual, LEAST_GAP_S), False)
    if gap.any():
        warn(file, f"{gap.sum()} gaps: the motion across them is unknown")
    poses[~known | (gap[before] & (at_s > stamps_s[before]))] = np.nan
    found = motions(poses)
    part = (np.cumsum(gap) - gap)[before]
    found[1:][part[1:] != part[:-1]] = np.nan
    return found


def _turned(xy: Floats, yaw: Floats) -> Floats:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.column_stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]])


def relative(a: Floats, b: Floats) -> Floats:
    """Return the poses b in the frames a, both (..., 4, 4)."""
    found = np.broadcast_to(np.eye(4), np.broadcast_shapes(a.shape, b.shape)).copy()
    back = np.swapaxes(a[..., :3, :3], -1, -2)
    found[..., :3, :3] = back @ b[..., :3, :3]
    found[..., :3, 3] = (back @ (b[..., :3, 3] - a[..., :3, 3])[..., None])[..., 0]
    found[np.isnan(found[..., :3, :]).any(axis=(-1, -2))] = np.nan
    return found


def with_odometry_beside(log: Log, path: Path) -> Log:
    """Return a log with the odometry beside it; RelmapError if it is damaged, or there is more."""
    names = [name for name in (*TABLES, TRAJECTORY) if os.path.isfile(file_beside(path, name))]
    if not names:
        return log
    if len(names) > 1:
        raise invalid(path, f"{' and '.join(names)} exist beside it, expected one")
    file = file_beside(path, names[0])
    found = _read_trajectory(file, log) if names[0] == TRAJECTORY else _read_motions(file, log)
    if log.dimension == 2:
        yaw = np.arctan2(found[:, 1, 0], found[:, 0, 0])
        found = planar_poses(found[:, 0, 3], found[:, 1, 3], yaw)
        found[np.isnan(yaw)] = np.nan
    return replace(log, odometry=found)


def _read_motions(file: Path, log: ObservationLog | ScanLog) -> Floats:
    table = read_table(file, _COLUMNS)
    iteration, poses = table.integers("iteration"), _poses(table)
    order = np.argsort(iteration, kind="stable")
    again = np.flatnonzero(np.diff(iteration[order]) == 0)
    if len(again):
        row = int(order[again[0] + 1])
        table.fail(row, "iteration", f"{iteration[row]} occurs twice, expected each once")
    numbers = np.arange(len(log)) + log.first_iteration if log.numbers is None else log.numbers
    _require_common(file, "iterations", iteration, np.array([numbers.min(), numbers.max()]))
    at = order[np.minimum(np.searchsorted(iteration[order], numbers), len(order) - 1)]
    found = np.where((iteration[at] == numbers)[:, None, None], poses[at], np.nan)
    moved = np.append(False, np.diff(numbers) != 1)
    lost = moved & np.isfinite(found[:, 0, 0])
    found[moved] = np.nan
    if lost.any():
        warn(file, f"{lost.sum()} motions are not used: sorted by time, their scans follow others")
    return found


def _poses(table: Table) -> Floats:
    names = [name for name in table.columns if name != "iteration"]
    if sorted(names) == sorted(_PLANAR):
        return planar_poses(*(table.columns[name] for name in _PLANAR))
    if sorted(names) != sorted(_SPATIAL):
        expected = f"iteration and {', '.join(_PLANAR)}, or iteration and {', '.join(_SPATIAL)}"
        raise invalid(table.path, f"columns {', '.join(names)}, expected {expected}")
    numbers = np.column_stack([table.columns[name] for name in _SPATIAL])
    return _with_quaternions(table.path, numbers, table.lines)


def _with_quaternions(file: Path, numbers: Floats, lines: Ints) -> Floats:
    """Return poses (n, 4, 4) of x, y, z and quaternion, (n, 7)."""
    length = np.linalg.norm(numbers[:, 3:], axis=1)
    wrong = np.abs(length - 1) > _UNIT
    if wrong.any():
        row = np.argmax(wrong)
        problem = f"the quaternion has the length {length[row]:.4g}, expected 1"
        raise invalid(file, f"line {lines[row]}: {problem}")
    return poses_of(Rotation.from_quat(numbers[:, 3:]), numbers[:, :3])


def read_tum(file: Path) -> tuple[Floats, Floats, Ints]:
    """Return times (k,), poses (k, 4, 4) and lines (k,) of a TUM file; see `read_rows`."""
    rows = read_rows(file, _TUM_LIMITS, "pose", "8 numbers: t x y z qx qy qz qw")
    poses = _with_quaternions(file, rows.values[:, 1:], rows.lines)
    return rows.values[:, 0], poses, rows.lines


def _read_trajectory(file: Path, log: ObservationLog | ScanLog) -> Floats:
    stamps_s, poses, lines = read_tum(file)
    late = np.flatnonzero(np.diff(stamps_s) <= 0)
    if len(late):
        row = late[0] + 1
        problem = f"line {lines[row]}: the time {stamps_s[row]:.10g} does not increase"
        raise invalid(file, f"{problem}, expected poses sorted by time")
    at_s = log.stamps_s
    if at_s is None:
        at_s = log.first_iteration + np.arange(len(log), dtype=np.float64)
    _require_common(file, "times", stamps_s, at_s)
    return motions_at(file, stamps_s, poses, at_s)


def _require_common(file: Path, what: str, own: Ints | Floats, of_log: Ints | Floats) -> None:
    """Check that iterations or times of odometry reach into those of its log."""
    if len(own) and (own.max() < of_log.min() or own.min() > of_log.max()):
        found, there = (f"{of.min():.10g} to {of.max():.10g}" for of in (own, of_log))
        raise invalid(file, f"{what} {found}, expected some within those of the log, {there}")


def motions_at(file: Path, stamps_s: Floats, poses: Floats, at_s: Floats) -> Floats:
    """Return the motions (k, 4, 4) between times, by poses interpolated as in `poses_at`.

    `file`: named in the warning of poses that are rarer than the times.
    """
    there = poses_at(stamps_s, poses, at_s)
    n_poses = int(np.sum((stamps_s >= at_s.min()) & (stamps_s <= at_s.max())))
    n_scans = int(np.isfinite(there[:, 0, 0]).sum())
    if n_poses < RARE * n_scans:
        few = f"{n_poses} poses for {n_scans} scans"
        warn(file, f"{few}: the motions between are interpolated, and less accurate")
    return motions(there)


def poses_at(stamps_s: Floats, poses: Floats, at_s: Floats) -> Floats:
    """Return poses (k, 4, 4) interpolated at other times; NaN beyond the ends and in gaps."""
    if len(poses) < 2:
        return np.full((len(at_s), 4, 4), np.nan)
    after = np.clip(np.searchsorted(stamps_s, at_s), 1, len(stamps_s) - 1)
    step = stamps_s[after] - stamps_s[after - 1]
    exact = (at_s == stamps_s[after]) | (at_s == stamps_s[after - 1])
    known = (step <= GAP * np.median(np.diff(stamps_s))) | exact
    known &= (at_s >= stamps_s[0]) & (at_s <= stamps_s[-1])
    found = np.full((len(at_s), 4, 4), np.nan)
    at_s = at_s[known]
    rotation = Slerp(stamps_s, Rotation.from_matrix(poses[:, :3, :3]))(at_s)
    t = np.column_stack([np.interp(at_s, stamps_s, poses[:, axis, 3]) for axis in range(3)])
    found[known] = poses_of(rotation, t)
    return found


def write_odometry_csv(path: Path, odometry: Floats, first_iteration: int = 0) -> None:
    """Write motions (k, 4, 4) so that they can be read back, up to rounding.

    Planar ones, without height, roll and pitch, are written as x, y and yaw. Raises `RelmapError`
    if the file cannot be written.
    """
    known = np.flatnonzero(np.isfinite(odometry).all(axis=(1, 2)))
    there = odometry[known]
    flat = not np.abs(there[:, 2, [0, 1, 3]]).any() and not np.abs(there[:, :2, 2]).any()
    columns = [there[:, 0, 3], there[:, 1, 3]]
    if flat:
        columns.append(np.arctan2(there[:, 1, 0], there[:, 0, 0]))
    elif len(there):
        quaternions = Rotation.from_matrix(there[:, :3, :3]).as_quat(canonical=True)
        columns += [there[:, 2, 3], *quaternions.T]
    lines = [",".join(["iteration", *(_PLANAR if flat else _SPATIAL)])]
    texts = [map(repr, column.tolist()) for column in (first_iteration + known, *columns)]
    lines += map(",".join, zip(*texts, strict=True))
    with replacing(path) as file:
        file.write(("\n".join(lines) + "\n").encode("ascii"))
