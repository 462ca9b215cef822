"""Recovery of truncated or damaged bags, record by record from the beginning.

The format of ROS 1 is "Bag format 2.0" (wiki.ros.org/Bags/Format/2.0); MCAP is read by `mcap`. Of
SQLite see "Database File Format" (sqlite.org/fileformat2.html), 1.3.
"""

from __future__ import annotations

import bz2
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

MAX_BYTES = 1 << 30
"""Size of messages kept in memory."""

_MAGIC = b"#ROSBAG V2.0\n"
_CHUNK, _CONNECTION, _MESSAGE = 5, 7, 2
VISION_MSGS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\n"
        "BoundingBox3D bbox\nstring id\n"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections\n",
}
"""Detection messages unknown to rosbags."""

_TOPICS = "SELECT id, name, type FROM topics"
_SIZE = struct.Struct("<I")


@dataclass(frozen=True)
class Found:
    """A message: topic and type, its time in nanoseconds, and its bytes."""

    topic: str
    type: str
    t: int
    raw: bytes


def salvaged(files: Sequence[Path]) -> tuple[list[Found], Typestore]:
    """Return all messages before the damage, and their types; see `bags` for the files."""
    from rosbags.typesys import Stores, get_typestore

    found: list[Found] = []
    definitions: dict[str, str] = {}
    size = 0
    for file in files:
        records = {".bag": _of_ros1, ".mcap": _of_mcap}.get(file.suffix, _of_sqlite)
        with suppress(Exception):  # messages before the damage are kept
            for message in records(file, definitions):
                found.append(message)
                size += len(message.raw)
                if size > MAX_BYTES:
                    break
    store = known_types()
    if definitions:
        store = get_typestore(Stores.EMPTY)
        store.register(_types(definitions))
    return [each for each in found if each.type in store.types], store


@cache
def known_types() -> Typestore:
    """Return the types of bags without definitions: those of ROS 2 Humble, with vision_msgs 4.

    They are made once, which takes as long as opening a small bag.
    """
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(_types(VISION_MSGS))
    return store


def _types(definitions: dict[str, str]) -> dict[str, Any]:
    from rosbags.typesys import get_types_from_msg

    types: dict[str, Any] = {}
    for name, definition in definitions.items():
        with suppress(Exception):  # an unreadable type is treated as missing
            types.update(get_types_from_msg(definition, name))
    return types


def _of_ros1(file: Path, definitions: dict[str, str]) -> Iterator[Found]:
    connections: dict[int, tuple[str, str]] = {}
    for header, data in _ros1_records(file.read_bytes().removeprefix(_MAGIC)):
        op = header["op"][0]
        if op == _CONNECTION:
            fields = dict(_fields(data))
            package, _, name = fields["type"].decode().partition("/")
            type_ = f"{package}/msg/{name}"
            definitions[type_] = fields["message_definition"].decode()
            connections[_SIZE.unpack(header["conn"])[0]] = header["topic"].decode(), type_
        elif op == _MESSAGE:
            seconds, nanoseconds = struct.unpack("<II", header["time"])
            topic, type_ = connections[_SIZE.unpack(header["conn"])[0]]
            yield Found(topic, type_, seconds * 10**9 + nanoseconds, data)


def _ros1_records(data: bytes) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """Yield header and data of each record, also of those in chunks."""
    for header, content in _records(data):
        if header["op"][0] == _CHUNK:
            yield from _records(_unpacked(header["compression"].decode(), content))
        else:
            yield header, content


def _records(data: bytes) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """Yield header and data of each record; the data of a last chunk may be truncated."""
    at = 0
    while at + 8 <= len(data):
        size = _SIZE.unpack_from(data, at)[0]
        header = dict(_fields(data[at + 4 : at + 4 + size]))
        at += 4 + size
        length = _SIZE.unpack_from(data, at)[0]
        whole = at + 4 + length <= len(data)
        if not whole and header["op"][0] != _CHUNK:
            return
        yield header, data[at + 4 : at + 4 + length]
        at += 4 + length


def _fields(data: bytes) -> Iterator[tuple[str, bytes]]:
    at = 0
    while at + 4 <= len(data):
        size = _SIZE.unpack_from(data, at)[0]
        name, _, value = data[at + 4 : at + 4 + size].partition(b"=")
        yield name.decode(), value
        at += 4 + size


def _unpacked(compression: str, data: bytes) -> bytes:
    """Return the available part of a chunk."""
    if compression == "none":
        return data
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(data, MAX_BYTES)
    from lz4.frame import LZ4FrameDecompressor

    return bytes(LZ4FrameDecompressor().decompress(data, MAX_BYTES))


def _of_mcap(file: Path, definitions: dict[str, str]) -> Iterator[Found]:
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    with file.open("rb") as stream:
        for record in StreamReader(stream, record_size_limit=MAX_BYTES).records:
            if isinstance(record, Schema):
                schemas[record.id] = record.name
                if record.encoding == "ros2msg":
                    definitions[record.name] = record.data.decode()
            elif isinstance(record, Channel):
                channels[record.id] = record.topic, schemas.get(record.schema_id, "")
            elif isinstance(record, Message):
                topic, type_ = channels[record.channel_id]
                yield Found(topic, type_, record.log_time, record.data)


def _of_sqlite(file: Path, definitions: dict[str, str]) -> Iterator[Found]:
    data = bytearray(file.read_bytes())
    page = struct.unpack(">H", data[16:18])[0]
    page = 1 << 16 if page == 1 else page
    n_pages = len(data) // page
    # SQLite reads nothing if a database has fewer pages than its header states.
    data[28:32] = struct.pack(">I", n_pages)
    with closing(sqlite3.connect(":memory:")) as base:
        base.deserialize(bytes(data[: n_pages * page]))
        with suppress(sqlite3.Error):  # bags before Iron have no such table
            query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
            definitions.update(base.execute(query))
        topics = {key: (name, kind) for key, name, kind in base.execute(_TOPICS)}
        rows = "SELECT topic_id, timestamp, data FROM messages NOT INDEXED"
        for key, t, raw in base.execute(rows):
            yield Found(*topics[key], t, raw)
