"""Bags of ROS 1, ROS 2 and MCAP: scans, clouds, detections, odometry, transforms."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from relmap.cli import main
from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.odometry import checked_odometry
from relmap.datasets import open_log, open_scans
from relmap.datasets.odometry import motions
from tests.bagfiles import (
    FIRST,
    KINDS,
    RANGES,
    STEP,
    Messages,
    Types,
    beams,
    file_of,
    scanned,
    write_bag,
)
from tests.scanlogs import failure as scan_failure

pytestmark = pytest.mark.usefixtures("unrendered")

Poses = Floats
LASER = checked_odometry([0.3, -0.1, 0.5])
WAY = np.array([checked_odometry([0.2 * k, 0.01 * k, 0.05 * k]) for k in range(12)])
PLACES = {"oak": (3.0, 1, 0.5), "elm": (4.0, -2, 1), "ash": (5.0, 2, 0)}


def on_robot(points: Poses, T: Poses = LASER) -> Poses:
    d = points.shape[1]
    return np.asarray(points @ T[:d, :d].T + T[:d, 3])


def transforms(types: Types, T: Poses = LASER) -> Messages:
    yield "/tf_static", 0.5, types.transform(0.5, "base_link", "laser", T)
    yield "/tf_static", 0.5, types.transform(0.5, "odom", "base_link", np.eye(4))


def driven(types: Types, frame: str = "odom") -> Messages:
    for k, T in enumerate(WAY):
        yield "/odom", 1 + k, types.odometry(1 + k, T, frame)


@pytest.mark.parametrize("kind", KINDS)
def test_laser_scans_are_on_the_robot(kind: str, tmp_path: Path) -> None:
    types = Types(kind)
    messages = [*transforms(types), *driven(types), *scanned(types)]
    log = open_scans(write_bag(tmp_path, kind, types, messages))
    assert (log.dimension, len(log)) == (2, 11)
    assert_allclose(log.stamps_s, 2.0 + np.arange(11))
    for scan in log.scans():
        assert_allclose(scan.points_robot, on_robot(beams(RANGES, FIRST, STEP)), atol=1e-6)
    assert (log.sensor.x_m, log.sensor.y_m, log.sensor.range_m) == pytest.approx((0.3, -0.1, 10))
    assert_allclose(log.odometry[1:], motions(WAY)[2:], atol=1e-9)


def test_a_message_without_beams_is_an_empty_scan(tmp_path: Path) -> None:
    types = Types("mcap")
    scans = [("/scan", 1.0 + k, types.scan(1.0 + k, RANGES[: 7 * k], FIRST, STEP)) for k in (0, 1)]
    log = open_scans(write_bag(tmp_path, "mcap", types, scans))
    assert [len(scan.points_robot) for scan in log.scans()] == [0, 3]
    assert log.sensor.view_rad == pytest.approx(2 * 0.3)


def test_lasers_the_other_way_round(tmp_path: Path) -> None:
    types = Types("mcap")
    level = open_scans(write_bag(tmp_path, "mcap", types, scanned(types, step=-STEP)))
    first = next(iter(level.scans()))
    assert_allclose(first.points_robot, beams(RANGES, FIRST, STEP), atol=1e-6)
    shutil.rmtree(tmp_path / "bag")
    over = np.eye(4)
    over[:3, :3] = Rotation.from_euler("x", np.pi).as_matrix()
    hung = [*transforms(types, over), *scanned(types)]
    log = open_scans(write_bag(tmp_path, "mcap", types, hung))
    expected = beams(RANGES, FIRST, STEP)[::-1] * [1, -1]
    assert_allclose(next(iter(log.scans())).points_robot, expected, atol=1e-6)
    shutil.rmtree(tmp_path / "bag")
    over[:3, :3] = Rotation.from_euler("x", 0.3).as_matrix()
    tilted = write_bag(tmp_path, "mcap", types, [*transforms(types, over), *scanned(types)])
    assert "the laser is not level" in scan_failure(tilted)


@pytest.mark.parametrize("kind", KINDS)
def test_clouds_are_on_the_robot(kind: str, tmp_path: Path) -> None:
    types = Types(kind)
    clouds = [np.array([[1.0, 2, 3], [np.nan, 1, 1], [4, 5, k]]) for k in range(3)]
    messages = [*transforms(types)]
    messages += [("/points", 2.0, types.cloud(2.0 + k, cloud)) for k, cloud in enumerate(clouds)]
    log = open_scans(write_bag(tmp_path, kind, types, messages))
    assert log.dimension == 3
    assert log.odometry is None
    assert log.stamps_s.tolist() == [2, 3, 4]
    for scan, cloud in zip(log.scans(), clouds, strict=True):
        assert_allclose(scan.points_robot, on_robot(cloud[[0, 2]]), atol=1e-6)


def test_rows_of_a_cloud_may_have_bytes_at_their_ends(tmp_path: Path) -> None:
    types = Types("mcap")
    points = np.arange(1.0, 19).reshape(6, 3)
    cloud = types.cloud(1.0, points)
    rows = np.pad(cloud.data.reshape(2, -1), ((0, 0), (0, 10)), constant_values=1)
    cloud.height, cloud.width, cloud.row_step, cloud.data = 2, 3, rows.shape[1], rows.ravel()
    log = open_scans(write_bag(tmp_path, "mcap", types, [("/points", 1.0, cloud)]))
    assert_allclose(log.points_of(0), points)


@pytest.mark.parametrize("kind", KINDS)
def test_detections_are_a_landmark_log(kind: str, tmp_path: Path) -> None:
    types = Types(kind)
    messages = [*transforms(types), *driven(types)]
    messages += [("/seen", 2.0 + k, types.boxes(2.0 + k, PLACES.items())) for k in range(3)]
    messages += [("/seen", 5.0, types.boxes(5.0, []))]
    messages += [("/seen", 6.0, types.boxes(6.0, [("elm", (1, 1, 1)), ("", (2, 2, 2))]))]
    log = open_log(write_bag(tmp_path, kind, types, messages))
    assert log.names == ("ash", "elm", "oak")
    assert log.ids.tolist() == [2, 1, 0] * 3 + [1, -1]
    assert log.iteration.tolist() == [0] * 3 + [1] * 3 + [2] * 3 + [4] * 2
    assert log.stamps_s.tolist() == [2, 3, 4, 5, 6]
    places = on_robot(np.array([*PLACES.values()]))
    assert_allclose(log.points_robot[:3], places, atol=1e-6)
    assert_allclose(log.odometry[1:], motions(WAY)[2:6], atol=1e-9)


def test_a_bag_without_types_is_of_humble(tmp_path: Path) -> None:
    types = Types("sqlite")
    path = write_bag(tmp_path, "sqlite", types, [("/seen", 2.0, types.boxes(2.0, PLACES.items()))])
    with closing(sqlite3.connect(file_of(path))) as base, base:
        base.execute("DELETE FROM message_definitions")
    log = open_log(file_of(path))
    assert_allclose(log.points_robot, [*PLACES.values()])


def test_classes_are_not_ids(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    types = Types("mcap")
    seen = types.boxes(1.0, [("tree", (1, 1, 1)), ("tree", (2, 2, 2))])
    log = open_log(write_bag(tmp_path, "mcap", types, [("/seen", 1.0, seen)]))
    assert log.ids is None
    assert any("they are classes, not used" in message for message in caplog.messages)


@pytest.mark.parametrize("name", ["markers", "poses"])
def test_markers_and_poses_are_landmarks(name: str, tmp_path: Path) -> None:
    types = Types("mcap")
    T = np.eye(4)
    T[:3, 3] = [1, 2, 3]
    if name == "poses":
        array = types.make(
            "geometry_msgs/PoseArray", header=types.header(3, "a"), poses=[types.pose(T)]
        )
    else:
        array = types.make("visualization_msgs/MarkerArray", markers=markers(types, T))
    log = open_log(write_bag(tmp_path, "mcap", types, [("/seen", 9.0, array)]))
    assert log.points_robot.tolist() == [[1, 2, 3]]
    assert log.stamps_s.tolist() == [3]
    assert log.names == (None if name == "poses" else ("tags/7",))


def markers(types: Types, T: Poses) -> list[object]:
    """Return a marker that is added, and one that is deleted."""
    colour = types.make("std_msgs/ColorRGBA", r=0.0, g=0.0, b=0.0, a=0.0)
    nothing = np.empty(0, np.uint8)
    texture = types.make(
        "sensor_msgs/CompressedImage", header=types.header(3, "a"), format="", data=nothing
    )
    return [
        types.make(
            "visualization_msgs/Marker",
            header=types.header(3, "a"),
            ns="tags",
            id=7 + action,
            type=1,
            action=action,
            pose=types.pose(T),
            scale=types.point("Vector3", [1, 1, 1]),
            color=colour,
            lifetime=types.make("builtin_interfaces/Duration", sec=0, nanosec=0),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=texture,
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=types.make("visualization_msgs/MeshFile", filename="", data=nothing),
            mesh_use_embedded_materials=False,
        )
        for action in (0, 2)
    ]


def test_topics_are_named_where_there_are_several(tmp_path: Path) -> None:
    types = Types("mcap")
    messages = [*scanned(types, "/front"), *scanned(types, "/rear"), *driven(types)]
    path = write_bag(tmp_path, "mcap", types, messages)
    message = scan_failure(path)
    assert "several topics with LaserScan or PointCloud2: name one with --topic" in message
    assert "the bag holds /front (sensor_msgs/msg/LaserScan), /odom (nav_msgs" in message
    log = open_scans(path, topics=["/front"])
    assert log.odometry is not None
    with pytest.raises(RelmapError, match="no topic '/back'; the bag holds /front"):
        open_scans(path, topics=["/back"])
    with pytest.raises(RelmapError, match=r"is a log of point scans \(bag-scans\)"):
        open_log(path)
    with pytest.raises(RelmapError, match="no topic with detections; the bag holds /front"):
        open_log(path, "bag-detections")


def test_odometry_of_a_map_is_none(tmp_path: Path) -> None:
    types = Types("mcap")
    path = write_bag(tmp_path, "mcap", types, [*driven(types, "map"), *scanned(types)])
    log = open_scans(path)
    assert log.odometry is None
    assert "in a map frame" in log.no_odometry


@pytest.mark.parametrize("what", ["scan", "cloud", "boxes"])
def test_odometry_is_taken_at_the_times_also_where_they_repeat(tmp_path: Path, what: str) -> None:
    types, times = Types("mcap"), [2.0, 2.0, 4.0]
    given = {"scan": (RANGES, FIRST, STEP), "cloud": (np.eye(3),), "boxes": (PLACES.items(),)}[what]
    seen = [("/seen", t, getattr(types, what)(t, *given)) for t in times]
    path = write_bag(tmp_path, "mcap", types, [*transforms(types), *driven(types), *seen])
    log = (open_log if what == "boxes" else open_scans)(path)
    assert log.stamps_s.tolist() == [0, 1, 2]
    assert_allclose(log.odometry[1:], motions(WAY[[1, 1, 3]])[1:], atol=1e-9)


def test_several_odometries_are_none_until_one_is_named(tmp_path: Path) -> None:
    types = Types("ros1")
    second = [("/ekf", t, message) for _, t, message in driven(types)]
    path = write_bag(tmp_path, "ros1", types, [*driven(types), *second, *scanned(types)])
    log = open_scans(path)
    assert log.odometry is None
    assert "several topics have odometry (/ekf, /odom)" in log.no_odometry
    assert open_scans(path, topics=["/ekf"]).odometry is not None


def test_bags_are_mapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    types = Types("mcap")
    seen = [
        types.boxes(1.0 + k, [(name, (x - 0.2 * k, y, z)) for name, (x, y, z) in PLACES.items()])
        for k in range(12)
    ]
    write_bag(tmp_path, "mcap", types, [("/seen", 1.0 + k, each) for k, each in enumerate(seen)])
    command = ["map", "bag", "-o", "out", "--association", "known", "--topic", "/seen"]
    assert main([*command, "--journal", "run", "--scans", "0:7"]) == 0
    assert main(["resume", "run", "-o", "again"]) == 0
    assert (tmp_path / "out" / "names.csv").read_text() == "landmark,name\n0,ash\n1,elm\n2,oak\n"
    same = [(tmp_path / name / "landmarks.csv").read_bytes() for name in ("out", "again")]
    assert same[0] == same[1]
    assert main(["map", "out/landmarks.csv", "-o", "a", "--topic", "/seen"]) == 2
