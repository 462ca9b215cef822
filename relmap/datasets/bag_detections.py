"""Landmark detections in bags.

* ``vision_msgs/Detection3DArray``: the centres of the boxes; the id is that of the detection, or
  the class of its first result if each class occurs once per message.
* ``visualization_msgs/MarkerArray``: the positions of markers that are added; namespace and id.
* ``apriltag_ros/AprilTagDetectionArray`` (ROS 1): the positions of tags; their numbers.
* ``geometry_msgs/PoseArray``: positions; no ids.

A message is an iteration. Points are in space, in the robot's frame (`relmap.datasets.bag_frames`).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.bag_frames import Driven, Mounting, stamp_s
from relmap.datasets.bags import Bag, bag_errors, is_bag, topics_in
from relmap.datasets.base import ObservationLog
from relmap.datasets.observation_csv import COLUMNS
from relmap.datasets.own_table import Ids, log_of
from relmap.datasets.scans import in_time_order, numbers_of
from relmap.datasets.textfile import shown, warn

BOXES = "vision_msgs/msg/Detection3DArray"
MARKERS = "visualization_msgs/msg/MarkerArray"
TAGS = "apriltag_ros/msg/AprilTagDetectionArray"
POSES = "geometry_msgs/msg/PoseArray"
DETECTIONS = (BOXES, MARKERS, TAGS, POSES)

_ADDED = 0
_USED = [column for column in COLUMNS if column.name in ("iteration", "x", "y", "z", "id")]


@dataclass(frozen=True)
class BagDetections:
    """Reads the detections of one topic, of `topics` if there are several of a kind."""

    topics: tuple[str, ...] = ()
    name = "bag-detections"
    description = "a bag with Detection3DArray, MarkerArray, AprilTagDetectionArray or PoseArray"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a bag with detections, or an unreadable one."""
        return is_bag(path) and topics_in(path, DETECTIONS) != []

    def load(self, path: Path) -> ObservationLog:
        """Read the log, with ids if the messages have them."""
        with bag_errors(path), closing(Bag(path)) as bag:
            topic = bag.chosen(DETECTIONS, self.topics, "detections")
            driven = Driven(bag, self.topics)
            log, frame, times_s = _read(bag, topic, Mounting(bag, driven.base))
        odometry = driven.at(times_s, frame, path)
        return replace(log, odometry=odometry, no_odometry=driven.reason)


def _read(bag: Bag, topic: str, mounting: Mounting) -> tuple[ObservationLog, str, Floats]:
    """Return the log of a topic, the name of its frame, and the time of each message, seconds."""
    rows: list[list[float]] = []
    stamps: list[float] = []
    frame, ids, classes = "", Ids(), False
    where = f"{shown(bag.path)}: topic {topic}"
    for t, message in bag.messages(topic):
        names: list[str] = []
        for at, name, frame_id in _seen(message, bag.types[topic]):
            frame, T = mounting.of(frame_id)
            x, y, z = T[:3, :3] @ [at.x, at.y, at.z] + T[:3, 3]
            rows.append([len(stamps), x, y, z, -1.0])
            ids.add(name, where)
            names += [name] * bool(name)
        classes |= len(set(names)) < len(names)
        stamps.append(stamp_s(t, message))
    if not rows:
        raise RelmapError(f"{where} holds no detection, expected some")
    if classes:
        warn(where, "ids come twice in a message: they are classes, not used")
    log = _log(bag.path, np.array(rows), stamps, None if classes else ids)
    return log, frame, np.sort(stamps)[log.first_iteration : log.end_iteration]


def _log(path: Path, values: Floats, stamps: list[float], ids: Ids | None) -> ObservationLog:
    """Return the log of detections (n, 5): message, x, y, z, and a placeholder for the id."""
    order, stamps_s = in_time_order(path, np.array(stamps))
    values[:, 0] = np.argsort(order)[values[:, 0].astype(np.int64)]
    log = log_of(path, _USED, values, np.arange(1, len(values) + 1), "detection", ids)
    known = log.ids is not None and bool((log.ids >= 0).any())
    own, numbers = slice(log.first_iteration, log.end_iteration), numbers_of(order)
    return replace(
        log,
        stamps_s=stamps_s[own],
        ids=log.ids if known else None,
        numbers=None if numbers is None else numbers[own],
    )


def _seen(message: Any, kind: str) -> Iterator[tuple[Any, str, str]]:
    """Yield position, id and frame of each landmark in a message."""
    if kind == POSES:
        for pose in message.poses:
            yield pose.position, "", message.header.frame_id
    elif kind == TAGS:
        for tag in message.detections:
            frame = tag.pose.header.frame_id or message.header.frame_id
            yield tag.pose.pose.pose.position, "+".join(map(str, tag.id)), frame
    elif kind == MARKERS:
        for marker in message.markers:
            if marker.action == _ADDED:
                name = f"{marker.ns}/{marker.id}" if marker.ns else str(marker.id)
                yield marker.pose.position, name, marker.header.frame_id
    else:
        for box in message.detections:
            frame = box.header.frame_id or message.header.frame_id
            yield box.bbox.center.position, _name_of(box), frame


def _name_of(box: Any) -> str:
    """Return the id of a detection, in any version of its message, or its class."""
    for name in (getattr(box, "id", ""), getattr(box, "tracking_id", "")):
        if name:
            return str(name)
    if not box.results:
        return ""
    best = getattr(box.results[0], "hypothesis", box.results[0])
    return str(getattr(best, "class_id", getattr(best, "id", "")))
