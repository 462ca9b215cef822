"""Distinguishes odometry from corrected poses in CARMEN logs.

Programs that correct a log often write the corrected pose into every field, including odometry;
a map that used it would use the solution. So a pose counts as odometry only with evidence:

* another pose of the scan deviates from it during the log (``FLASER`` has two, ``VERTEX2`` is one):
  then that one is corrected and this one is not; or
* the log also has the speeds of the wheels (``ODOM``, ``ROBOTLASER1``), no line ``NEFF``, which
  particle filters write, and the laser is where ``robot_frontlaser_offset`` has it. Programs that
  rewrite poses write zero speeds.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats
from relmap.datasets.laser import FIXED
from relmap.datasets.number_rows import finite_numbers
from relmap.datasets.odometry import motions, moved_frame, relative
from relmap.datasets.scans import planar_poses

OFFSET = "robot_frontlaser_offset"
SAME, MOST = 10 * FIXED, 0.9
"""Fraction of poses that must agree this well for two paths to be equal; some are rounded."""


@dataclass
class Hints:
    """Hints from the lines between the scans.

    `filtered`: whether a particle filter wrote the log; `moved`: whether wheel speeds are not zero;
    `offset_m`: distance of the laser ahead of the robot's centre.
    """

    filtered: bool = False
    moved: bool = False
    offset_m: float | None = None

    def see(self, cells: list[str]) -> None:
        """Take in another line of any kind."""
        self.filtered |= cells[0] == "NEFF"
        if cells[0] == "ODOM":
            self.see_speeds(finite_numbers(cells[4:6]))
        offset = finite_numbers(cells[2:3]) if cells[:2] == ["PARAM", OFFSET] else []
        if offset and abs(offset[0]) < 100:
            self.offset_m = offset[0]

    def see_speeds(self, speeds: Iterable[float]) -> None:
        """Take in speeds, forward and angular."""
        self.moved |= any(abs(speed) > FIXED for speed in speeds)


def odometry_of(
    poses: Floats, counted: Floats, hints: Hints, of_laser: bool
) -> tuple[Floats | None, str]:
    """Return the motions (k, 4, 4) of the scans' frame, or None and the reason.

    `poses` (k, 4, 4): poses of the scans' frame, possibly corrected; `counted` (k, 4, 4): poses of
    the robot in the odometry fields; `of_laser`: whether the scans' frame is the laser's, not the
    robot's.
    """
    T_robot_frame = planar_poses(*np.array([[hints.offset_m or 0.0], [0.0], [0.0]]))[0]
    if not of_laser:
        T_robot_frame = np.eye(4)
    if not _same_path(poses, counted):
        return moved_frame(motions(counted), T_robot_frame), ""
    mounted = np.linalg.norm((counted[0] @ T_robot_frame - poses[0])[:2, 3]) <= SAME
    if hints.moved and not hints.filtered and (mounted or hints.offset_m is None):
        return motions(poses), ""
    return None, _why_not(counted, hints)


def _why_not(counted: Floats, hints: Hints) -> str:
    """Return the reason why poses (k, 4, 4) are not used as odometry."""
    if hints.filtered:
        return "its odometry field contains a corrected path: a particle filter wrote it"
    if hints.moved:
        return f"its odometry field contains a corrected path: the laser is not at {OFFSET}"
    if np.abs(counted - counted[0]).max() <= SAME:
        return "its odometry field holds no motion"
    return "its odometry field may contain a corrected path: it has no wheel speeds"


def _same_path(a: Floats, b: Floats) -> bool:
    """Return whether two paths (k, 4, 4) differ only by a fixed frame or by another map."""
    if _constant(relative(a, b)):
        return True
    anchors = np.unique(np.array([1, 2, 3]) * (len(a) - 1) // 4)
    return any(_constant(relative(relative(a[k], a), relative(b[k], b)), True) for k in anchors)


def _constant(relation: Floats, none: bool = False) -> bool:
    """Return whether most planar poses are equal, or equal up to a motion."""
    apart = np.column_stack([relation[:, :2, 3], relation[:, :2, 0]])
    usual = np.array([0.0, 0.0, 1.0, 0.0]) if none else np.median(apart, axis=0)
    return bool((np.abs(apart - usual).max(axis=1) <= SAME).mean() >= MOST)
