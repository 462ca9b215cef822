"""Point scans in bags: ``sensor_msgs/LaserScan`` and ``sensor_msgs/PointCloud2``.

The points are in the robot's frame (`relmap.datasets.bag_frames`); for a level laser, upside down
or not, they are planar. Stamps are those of the headers.
"""

from __future__ import annotations

import weakref
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.bag_detections import DETECTIONS
from relmap.datasets.bag_frames import Driven, Mounting, stamp_s
from relmap.datasets.bags import Bag, bag_errors, is_bag, topics_in
from relmap.datasets.laser import Beams, laser_scans, require_memory
from relmap.datasets.scans import ScanLog, in_time_order, numbers_of, sorted_by_time
from relmap.datasets.textfile import invalid, shown

LASER, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
LEVEL = np.cos(np.deg2rad(5.0))
"""Cosine of the largest tilt of a laser whose scans count as planar."""
MAX_POINTS = 1 << 22
"""Maximum number of points in a cloud."""

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@dataclass(frozen=True)
class BagScans:
    """Reads the scans of one topic, of `topics` if there are several of a kind."""

    topics: tuple[str, ...] = ()
    name = "bag-scans"
    description = "a bag of ROS 1 or 2, or an MCAP file, with LaserScan or PointCloud2"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a bag with scans, one without detections, or an unreadable one."""
        return is_bag(path) and (
            not topics_in(path, DETECTIONS) or bool(topics_in(path, (LASER, CLOUD)))
        )

    def load(self, path: Path) -> ScanLog:
        """Read the log; clouds are read lazily."""
        with bag_errors(path), closing(Bag(path)) as bag:
            topic = bag.chosen((LASER, CLOUD), self.topics, "LaserScan or PointCloud2")
            driven = Driven(bag, self.topics)
            mounting = Mounting(bag, driven.base)
            read = _lasers if bag.types[topic] == LASER else _clouds
            log, frame, times_s = read(bag, topic, mounting)
        odometry = driven.at(times_s, frame, path)
        return replace(log, odometry=odometry, no_odometry=driven.reason)


def _lasers(bag: Bag, topic: str, mounting: Mounting) -> tuple[ScanLog, str, Floats]:
    """Return the log of a topic, the name of its frame, and the time of each scan, seconds."""
    stamps: list[float] = []
    scans, frames, limit_m, n_beams = [], set(), np.inf, 0
    for t, message in bag.messages(topic):
        frame, T_robot_laser = mounting.of(message.header.frame_id)
        scans.append(_beams(bag, message, T_robot_laser))
        n_beams += len(scans[-1].ranges_m)
        require_memory(shown(bag.path), len(stamps), n_beams)
        stamps.append(stamp_s(t, message))
        frames.add(frame)
        if message.range_max > 0:
            limit_m = min(limit_m, float(message.range_max))
    if not n_beams:
        raise invalid(bag.path, f"topic {topic} holds no scan, expected some")
    order, stamps_s = in_time_order(bag.path, np.array(stamps))
    log = laser_scans(bag.path, [scans[k] for k in order], limit_m, stamps_s, None)
    return replace(log, numbers=numbers_of(order)), min(frames), np.sort(stamps)


def _beams(bag: Bag, message: Any, T_robot_laser: Floats) -> Beams:
    r = np.asarray(message.ranges, dtype=np.float64)
    first, step = float(message.angle_min), float(message.angle_increment)
    bearing = first + step * np.arange(len(r), dtype=np.float64)
    up = T_robot_laser[2, 2]
    if abs(up) < LEVEL or not np.isfinite([first, step]).all() or abs(first) > 7 or abs(step) > 7:
        problem = "the laser is not level on the robot, or its angles are invalid"
        raise invalid(bag.path, f"{problem}; expected a laser that scans the plane")
    nothing = ~np.isfinite(r) | (r < message.range_min) | (np.abs(r) > MAX_COORDINATE_M)
    r = np.where(nothing, 0.0, r)
    bearing = bearing if up > 0 else -bearing
    if len(bearing) > 1 and bearing[1] < bearing[0]:
        r, bearing = r[::-1], bearing[::-1]
    yaw = np.arctan2(T_robot_laser[1, 0], T_robot_laser[0, 0])
    return Beams(r, bearing, [*T_robot_laser[:2, 3].tolist(), float(yaw)])


def _clouds(bag: Bag, topic: str, mounting: Mounting) -> tuple[ScanLog, str, Floats]:
    """Return the same as `_lasers`."""
    stamps, places, frame = [], [], ""
    written: Counter[int] = Counter()
    for t, message in bag.messages(topic):
        frame, T = mounting.of(message.header.frame_id)
        places.append((t, written[t], T))
        written[t] += 1
        stamps.append(stamp_s(t, message))
    if not stamps:
        raise invalid(bag.path, f"topic {topic} holds no cloud, expected some")
    stamps_s = np.array(stamps)
    reopened: list[Bag] = []

    def points_of(index: int) -> Floats:
        if not reopened:
            reopened.append(Bag(bag.path))
            weakref.finalize(points_of, reopened[0].close)
        t, nth, T = places[index]
        with bag_errors(bag.path):
            points = cloud_points(reopened[0].message_at(topic, t, nth), shown(bag.path))
        return np.asarray(points @ T[:3, :3].T + T[:3, 3])

    log = sorted_by_time(bag.path, ScanLog(3, stamps_s, points_of), stamps_s)
    return log, frame, np.sort(stamps_s)


def cloud_points(message: Any, where: str) -> Floats:
    """Return the finite points (n, 3) of a ``PointCloud2``; RelmapError, at `where`, if damaged."""
    n, step, row = int(message.width), int(message.point_step), int(message.row_step)
    order = ">" if message.is_bigendian else "<"
    data = np.asarray(message.data, dtype=np.uint8)
    if row > n * step and row * int(message.height) == len(data):  # rows with bytes at their ends
        data = data.reshape(-1, row)[:, : n * step].ravel()
    n *= int(message.height)
    fields = {field.name: field for field in message.fields}
    there = all(axis in fields and fields[axis].datatype in _TYPES for axis in "xyz")
    if not there or n > MAX_POINTS or n * step > len(data):
        raise RelmapError(f"{where}: a cloud of {n} points has no x, y, z or is cut short")
    columns = []
    for axis in "xyz":
        kind = np.dtype(order + _TYPES[fields[axis].datatype])
        begin = int(fields[axis].offset)
        if begin + kind.itemsize > step:
            raise RelmapError(f"{where}: field {axis} of a cloud lies beyond its point")
        cells = data[: n * step].reshape(n, step)[:, begin : begin + kind.itemsize]
        columns.append(np.ascontiguousarray(cells).view(kind)[:, 0].astype(np.float64))
    points = np.column_stack(columns)
    return points[(np.abs(points) <= MAX_COORDINATE_M).all(axis=1)]
