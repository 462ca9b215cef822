"""Small bags of every kind, written by rosbags, for tests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.datasets.bag_salvage import VISION_MSGS

KINDS = ("ros1", "sqlite", "mcap")
MORE = VISION_MSGS | {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n"}
"""Message definitions of ROS 1 or ROS 2 that rosbags lacks."""
RANGES = [2.0, np.inf, 3.0, 0.2, 10.0, 4.0, np.nan]
FIRST, STEP = -0.3, 0.1
"""Ranges of the beams of a scan, metres, its first bearing and the next, radians."""


class Types:
    """Makes messages of ROS 1 or ROS 2."""

    def __init__(self, kind: str) -> None:
        typesys = pytest.importorskip("rosbags.typesys")
        self.ros1 = kind == "ros1"
        stores = typesys.Stores
        self.store = typesys.get_typestore(stores.ROS1_NOETIC if self.ros1 else stores.ROS2_HUMBLE)
        types: dict[str, Any] = {}
        for name in MORE.keys() - self.store.types.keys():
            definition = MORE[name]
            types.update(typesys.get_types_from_msg(definition, name))
        self.store.register(types)

    def make(self, type_name: str, /, **fields: Any) -> Any:
        package, _, word = type_name.partition("/")
        return self.store.types[f"{package}/msg/{word}"](**fields)

    def header(self, t: float, frame: str) -> Any:
        seconds = int(t)
        stamp = self.make(
            "builtin_interfaces/Time", sec=seconds, nanosec=round((t - seconds) * 1e9)
        )
        seq = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/Header", stamp=stamp, frame_id=frame, **seq)

    def point(self, name: str, xyz: Iterable[float]) -> Any:
        x, y, z = map(float, xyz)
        return self.make(f"geometry_msgs/{name}", x=x, y=y, z=z)

    def quaternion(self, T: Floats) -> Any:
        x, y, z, w = map(float, Rotation.from_matrix(T[:3, :3]).as_quat())
        return self.make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, T: Floats) -> Any:
        position = self.point("Point", T[:3, 3])
        return self.make("geometry_msgs/Pose", position=position, orientation=self.quaternion(T))

    def transform(self, t: float, parent: str, child: str, T: Floats) -> Any:
        moved = self.make(
            "geometry_msgs/Transform",
            translation=self.point("Vector3", T[:3, 3]),
            rotation=self.quaternion(T),
        )
        stamped = self.make(
            "geometry_msgs/TransformStamped",
            header=self.header(t, parent),
            child_frame_id=child,
            transform=moved,
        )
        return self.make("tf2_msgs/TFMessage", transforms=[stamped])

    def odometry(self, t: float, T: Floats, frame: str = "odom") -> Any:
        twist = self.make(
            "geometry_msgs/Twist",
            linear=self.point("Vector3", [0, 0, 0]),
            angular=self.point("Vector3", [0, 0, 0]),
        )
        noise = np.zeros(36)
        return self.make(
            "nav_msgs/Odometry",
            header=self.header(t, frame),
            child_frame_id="base_link",
            pose=self.make("geometry_msgs/PoseWithCovariance", pose=self.pose(T), covariance=noise),
            twist=self.make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=noise),
        )

    def scan(self, t: float, ranges: Sequence[float], first: float, step: float) -> Any:
        return self.make(
            "sensor_msgs/LaserScan",
            header=self.header(t, "laser"),
            angle_min=first,
            angle_max=first + step * (len(ranges) - 1),
            angle_increment=step,
            time_increment=0.0,
            scan_time=0.1,
            range_min=0.5,
            range_max=10.0,
            ranges=np.array(ranges, dtype=np.float32),
            intensities=np.empty(0, dtype=np.float32),
        )

    def cloud(self, t: float, points: Floats) -> Any:
        rows = np.zeros(len(points), dtype=[("x", "<f4"), ("i", "<u2"), ("y", "<f8"), ("z", "<f4")])
        rows["x"], rows["y"], rows["z"] = points.T
        kinds = {"x": (0, 7), "y": (6, 8), "z": (14, 7)}
        fields = [
            self.make("sensor_msgs/PointField", name=name, offset=offset, datatype=kind, count=1)
            for name, (offset, kind) in kinds.items()
        ]
        return self.make(
            "sensor_msgs/PointCloud2",
            header=self.header(t, "laser"),
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=18,
            row_step=18 * len(points),
            data=np.frombuffer(rows.tobytes(), dtype=np.uint8),
            is_dense=True,
        )

    def boxes(self, t: float, boxes: Iterable[tuple[str, Sequence[float]]]) -> Any:
        detections = []
        for name, place in boxes:
            T = np.eye(4)
            T[:3, 3] = place
            size = self.point("Vector3", [1, 1, 1])
            box = self.make("vision_msgs/BoundingBox3D", center=self.pose(T), size=size)
            header = self.header(t, "laser")
            detections.append(
                self.make("vision_msgs/Detection3D", header=header, results=[], bbox=box, id=name)
            )
        header = self.header(t, "laser")
        return self.make("vision_msgs/Detection3DArray", header=header, detections=detections)


def compile_once() -> None:
    """Have rosbags parse and compile the same definitions once, not anew for each file.

    Only for runs over very many bags: the library is changed for the whole process.
    """
    typesys = pytest.importorskip("rosbags.typesys")
    parsed = lru_cache(500)(typesys.get_types_from_msg)

    @lru_cache(500)
    def executed(code: str) -> dict[str, Any]:
        names: dict[str, Any] = {}
        exec(code, names)
        return names

    def execute(code: str, names: dict[str, Any]) -> None:
        names.update(executed(code))

    for name in ("rosbags.typesys", "rosbags.highlevel.anyreader"):
        vars(pytest.importorskip(name))["get_types_from_msg"] = parsed
    for name in ("rosbags.typesys.store", "rosbags.serde.utils"):
        vars(pytest.importorskip(name))["exec"] = execute


Messages = Iterable[tuple[str, float, Any]]
"""Topic, time in seconds, message."""


def write_bag(folder: Path, kind: str, types: Types, messages: Messages, packing: str = "") -> Path:
    """Write a bag, of ROS 1 packed by BZ2 or LZ4, and return its path, a file or a folder."""
    if kind == "ros1":
        path = folder / "a.bag"
        rosbag1 = pytest.importorskip("rosbags.rosbag1")
        writer: Any = rosbag1.Writer(path)
        if packing:
            writer.set_compression(rosbag1.Writer.CompressionFormat[packing])
        serialize = types.store.serialize_ros1
    else:
        rosbag2 = pytest.importorskip("rosbags.rosbag2")
        path = folder / "bag"
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        serialize = types.store.serialize_cdr
    connections: dict[str, Any] = {}
    with writer:
        for topic, t, message in messages:
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=types.store)
            writer.write(connections[topic], round(t * 1e9), serialize(message, name))
    return path


def file_of(path: Path) -> Path:
    """Return the file that holds the messages of a bag."""
    return path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")


def beams(ranges: list[float], first: float, step: float) -> Floats:
    """Return the points (n, 2) of the beams that returned, in the laser's frame."""
    r, angle = np.array(ranges), first + step * np.arange(len(ranges))
    there = (r > 0.4) & (r < 9.9)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])[there]


def scanned(types: Types, topic: str = "/scan", step: float = STEP) -> Messages:
    for k in range(11):
        ranges, first = RANGES, FIRST
        if step < 0:
            ranges, first = RANGES[::-1], FIRST + STEP * (len(RANGES) - 1)
        yield topic, 2.0 + k, types.scan(2.0 + k, ranges, first, step)
