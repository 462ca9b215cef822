"""Error of a path against manually checked relations between poses.

R. Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots 27, 2009.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats
from relmap.datasets import Relations, read_relations
from relmap.datasets.scans import planar_poses
from relmap.datasets.textfile import open_text

RELATIONS = ".relations"
CLOCKS = ("ROBOTLASER1", -3, -1)
"""Lines of a CARMEN log with both clocks, the robot's and the logger's, and their positions."""
AT_SCANS_S = 0.03
"""Largest time from either end of a relation to a scan for which the path is not interpolated
much: a robot turns by a degree meanwhile."""


def relations_by_clocks(path: Path) -> tuple[Relations, ...]:
    """Read relations by the robot's clock and, if known, the logger's; see `read_relations`."""
    relations = read_relations(path)
    stem = path.name.removesuffix(RELATIONS)
    for name in (f"{stem}.log.gz", f"{stem}.log"):
        if (path.parent / name).is_file():
            kind, robot, logger = CLOCKS
            with open_text(path.parent / name) as stream:
                cells = [line.split() for line in stream if line.startswith(kind)]
            try:
                times = np.array([[float(row[robot]), float(row[logger])] for row in cells])
            except (ValueError, IndexError):
                continue
            if len(times):
                begin_s, end_s = (
                    np.interp(when, *times.T) for when in (relations.begin_s, relations.end_s)
                )
                return relations, Relations(begin_s, end_s, relations.T_begin_end)
    return (relations,)


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
