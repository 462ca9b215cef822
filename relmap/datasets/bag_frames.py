"""The pose of a sensor on its robot, and the odometry, in a bag.

The robot frame is the child frame of the odometry if static transforms connect it to the sensor,
otherwise the last frame they lead to; without transforms it is the sensor frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.bags import Bag
from relmap.datasets.odometry import motions_at
from relmap.datasets.scans import poses_of
from relmap.datasets.textfile import quoted, shown, warn

ODOMETRY = ("nav_msgs/msg/Odometry",)
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FIXED_FRAMES = ("map", "odom", "world", "earth")
"""World frames (REP 105), which are not part of the robot."""
CORRECTED_FRAMES = ("map", "world", "earth")
"""Frames whose poses are corrected and are thus not odometry (REP 105)."""
NO_ODOMETRY = "its odometry is in a map frame, whose poses are corrected"
STILL = 1e-6
"""Largest variation of a static transform."""


def stamp_s(t: int, message: Any) -> float:
    """Return the time of a message, seconds, from its header or else its recording time."""
    markers = getattr(message, "markers", None)
    header = markers[0].header if markers else getattr(message, "header", None)
    if header is None:
        return t / 1e9
    stamp = header.stamp
    seconds = float(stamp.sec) + float(stamp.nanosec) / 1e9
    return seconds if seconds > 0 else t / 1e9


def pose_of(position: Any, orientation: Any, where: str) -> Floats:
    """Return a pose (4, 4); RelmapError, starting with the given place, if it is invalid."""
    quaternion = [orientation.x, orientation.y, orientation.z, orientation.w]
    at = [position.x, position.y, position.z]
    if not np.isfinite([*quaternion, *at]).all() or not 0.5 < np.linalg.norm(quaternion) < 2:
        found = f"position {at}, orientation {quaternion}"
        raise RelmapError(f"{where}: {found}, expected finite numbers and a unit quaternion")
    return np.asarray(poses_of(Rotation.from_quat([quaternion]), np.array([at]))[0])


class Mounting:
    """The poses of sensors on the robot of a bag."""

    def __init__(self, bag: Bag, base: str | None) -> None:
        self._base = base
        self._parents: dict[str, tuple[str, Floats]] = {}
        moving: set[str] = set()
        where = shown(bag.path)
        for topic in bag.topics_of(TRANSFORMS):
            for _, message in bag.messages(topic):
                for transform in message.transforms:
                    self._take_in(transform, moving, where)
        for child in moving:
            self._parents.pop(child, None)

    def _take_in(self, transform: Any, moving: set[str], where: str) -> None:
        child, parent = _name(transform.child_frame_id), _name(transform.header.frame_id)
        T = pose_of(transform.transform.translation, transform.transform.rotation, where)
        before = self._parents.setdefault(child, (parent, T))
        if before[0] != parent or np.abs(before[1] - T).max() > STILL:
            moving.add(child)

    def of(self, sensor: str) -> tuple[str, Floats]:
        """Return the name of the robot frame, and T_robot_sensor (4, 4)."""
        frame, T = _name(sensor), np.eye(4)
        seen = {frame}
        while frame != self._base and frame in self._parents:
            parent, T_parent_frame = self._parents[frame]
            if parent in seen or parent in FIXED_FRAMES:
                break
            frame, T = parent, T_parent_frame @ T
            seen.add(frame)
        return frame, T


def _name(frame: str) -> str:
    return frame.lstrip("/")


class Driven:
    """The odometry of a bag; none if there is none, or several topics have it.

    `base`: the frame of its poses; `reason`: why the poses there are not used as odometry, if so.
    """

    def __init__(self, bag: Bag, topics: tuple[str, ...]) -> None:
        self.base: str | None = None
        self.reason = ""
        self._stamps_s, self._poses = np.empty(0), np.empty((0, 4, 4))
        known = bag.topics_of(ODOMETRY)
        known = [topic for topic in known if topic in topics] or known
        if len(known) > 1:
            self.reason = f"several topics have odometry ({', '.join(known)}): name one of them"
        if len(known) != 1:
            return
        rows: dict[float, Floats] = {}
        for t, message in bag.messages(known[0]):
            if _name(message.header.frame_id) in CORRECTED_FRAMES:
                self.reason = NO_ODOMETRY
                return
            self.base = _name(message.child_frame_id) or None
            pose, where = message.pose.pose, f"{shown(bag.path)}: topic {known[0]}"
            rows[stamp_s(t, message)] = pose_of(pose.position, pose.orientation, where)
        self._stamps_s = np.array(sorted(rows))
        self._poses = np.array([rows[stamp] for stamp in sorted(rows)]).reshape(-1, 4, 4)

    def at(self, stamps_s: Floats, frame: str, where: Path) -> Floats | None:
        """Return the motions (k, 4, 4) of the robot between times; None if there is none."""
        if not len(self._poses):
            return None
        if self.base is not None and frame != self.base:
            both = f"from {quoted(frame)} to {quoted(self.base)}"
            warn(where, f"no static transform {both}: they are treated as one frame")
        return motions_at(where, self._stamps_s, self._poses, stamps_s)
