"""Odometry as logs bring it, and the files beside a log that bring it."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from benchmarks.shared.log_faults import composed
from relmap.core.arrays import Floats
from relmap.core.odometry import checked_odometry, motion_from_velocity
from relmap.datasets import open_log, open_scans
from relmap.datasets.odometry import driven, motions, write_odometry_csv
from relmap.datasets.scans import poses_of
from tests.hostile import CIRCLES, MRPT, OBSERVED, mat, scans
from tests.logs import PLAIN, TREES, failure, put
from tests.scanlogs import LASER_COMMENT, LASER_HEADER, planar

Poses = Floats
FLAT = "iteration,x,y\n3,1,2\n5,1,2\n6,1,2\n"
MOTIONS = "iteration,x,y,yaw\n6,1,0.5,0.25\n4,2,0,0\n9,1,1,1\n2,5,5,5\n5,0,0,-1\n"


def walk(k: int = 30) -> Poses:
    """Return poses (k, 4, 4) of a way in space."""
    rng = np.random.default_rng(3)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.1, (k, 3)), axis=0))
    return poses_of(turns, np.cumsum(rng.normal(0.5, 0.2, (k, 3)), axis=0))


def tum(stamps: Floats, poses: Poses) -> str:
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = np.column_stack([stamps, poses[:, :3, 3], quaternions])
    return "# t x y z qx qy qz qw\n" + "".join(
        " ".join(map(repr, row)) + "\n" for row in rows.tolist()
    )


@pytest.mark.parametrize("name", ["odometry.csv", "odometry.csv.gz"])
def test_motions_beside_a_log(tmp_path: Path, name: str) -> None:
    path = put(tmp_path, FLAT)
    put(tmp_path, gzip.compress(MOTIONS.encode()) if name.endswith("gz") else MOTIONS, name)
    for place in (path, tmp_path):
        odometry = open_log(place).odometry
        assert planar(odometry[1:]) == [[2, 0, 0], [0, 0, -1], [1, 0.5, 0.25]]
        assert np.isnan(odometry[0]).all()
    later = open_log(path).between(5, 7)
    assert_array_equal([scan.odometry for scan in later.scans()], odometry[2:])


def test_without_a_file_there_is_no_odometry(tmp_path: Path) -> None:
    log = open_log(put(tmp_path, FLAT))
    assert log.odometry is None
    assert log.between(4, 6).odometry is None
    assert [scan.odometry for scan in log.scans()] == [None] * 4


def test_motions_beside_scans_in_space(tmp_path: Path) -> None:
    poses = walk(2)
    put(tmp_path, scans(), "scans.npz")
    write_odometry_csv(tmp_path / "odometry.csv", motions(poses))
    log = open_scans(tmp_path)
    assert_allclose(log.odometry[1], np.linalg.inv(poses[0]) @ poses[1], atol=1e-14)
    _, second = log.scans()
    assert_array_equal(second.odometry, log.odometry[1])
    (alone,) = log.between(1, 2).scans()
    assert_array_equal(alone.odometry, log.odometry[1])


@pytest.mark.parametrize("flat", [True, False])
def test_written_odometry_is_read_back(tmp_path: Path, flat: bool) -> None:
    log = put(
        tmp_path,
        "iteration,x,y"
        + ",z" * (not flat)
        + "\n4,1,1"
        + ",0" * (not flat)
        + "\n"
        + "9,1,1"
        + ",0" * (not flat)
        + "\n",
    )
    odometry = motions(walk(6))
    if flat:
        odometry = np.array([checked_odometry([k, -0.1 * k, 0.3 * k]) for k in range(6)])
    odometry[3] = np.nan
    write_odometry_csv(tmp_path / "odometry.csv", odometry, 4)
    header = (tmp_path / "odometry.csv").read_text().partition("\n")[0]
    assert header == "iteration,x,y" + (",yaw" if flat else ",z,qx,qy,qz,qw")
    assert_allclose(open_log(log).odometry, odometry, atol=1e-15)


def test_a_trajectory_beside_a_log_is_taken_at_its_iterations(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = "".join(f"{k},1,2,3\n" for k in range(30))
    put(tmp_path, "iteration,x,y,z\n" + rows)
    poses = walk()
    put(tmp_path, tum(np.arange(30.0), poses), "odometry.tum")
    assert_allclose(open_log(tmp_path).odometry[1:], motions(poses)[1:], atol=1e-12)
    assert not caplog.messages
    # Every other pose: in between the robot moved evenly, so that two motions are one.
    put(tmp_path, tum(np.arange(0.0, 30, 2), poses[::2]), "odometry.tum")
    found = open_log(tmp_path).odometry
    assert_allclose(found[1:28:2] @ found[2:29:2], motions(poses[::2])[1:], atol=1e-12)
    assert np.isnan(found[29]).all()
    assert "15 poses for 29 scans: the motions between are interpolated" in caplog.text


def test_motion_over_a_gap_is_unknown(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    put(tmp_path, "iteration,x,y\n0,1,1\n30,1,1\n")
    stamps = np.array([*range(6), *range(18, 31)], dtype=float)
    put(tmp_path, tum(stamps, walk(31)[stamps.astype(int)]), "odometry.tum")
    known = np.isfinite(open_log(tmp_path).odometry).all(axis=(1, 2))
    assert np.flatnonzero(known).tolist() == [*range(1, 6), *range(19, 31)]
    assert not caplog.messages


def test_a_trajectory_in_space_beside_a_planar_log_is_in_the_plane(tmp_path: Path) -> None:
    put(tmp_path, FLAT)
    put(tmp_path, "3 0 0 0 0 0 0 1\n4 1 0 9 0 0 0.5 0.8660254037844386\n", "odometry.tum")
    assert planar(open_log(tmp_path).odometry)[1] == pytest.approx([1, 0, np.pi / 3])


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("odometry.csv", "iteration,x,y\n3,1,2\n", "columns x, y, expected iteration and x, y"),
        ("odometry.csv", "iteration,x,y,z,yaw\n3,1,2,0,1\n", "columns x, y, z, yaw, expected"),
        ("odometry.csv", "iteration,x,y,yaw,id\n3,1,2,0,1\n", "unknown column 'id'"),
        ("odometry.csv", MOTIONS + "5,1,1,1\n", "line 7, field iteration: 5 occurs twice"),
        ("odometry.csv", MOTIONS + "7,nan,1,1\n", "line 7, field x: 'nan' is not finite"),
        ("odometry.csv", "iteration,x,y,yaw\n70,1,1,1\n80,1,1,1\n", "70 to 80, .* log, 3 to 6"),
        (
            "odometry.tum",
            "1 0 0 0 0 0 0 1\n2.5 0 0 0 0 0 0 1\n",
            "times 1 to 2.5, expected some within those of the log, 3 to 6",
        ),
        ("odometry.csv", MOTIONS + "7,1,1,\n", "line 7, field yaw: '' is empty"),
        (
            "odometry.csv",
            "iteration,x,y,z,qx,qy,qz,qw\n3,1,2,0,0,0,0,.5\n",
            "line 2: .* length 0.5",
        ),
        ("odometry.tum", "3 0 0 0 0 0 0 0\n", "line 1: .* length 0, expected 1"),
        (
            "odometry.tum",
            "3 0 0 0 0 0 0 1\n3 0 0 0 0 0 0 1\n",
            "line 2: the time 3 does not increase",
        ),
        ("odometry.tum", "3 0 0 0\n", "line 1: '3 0 0 0', expected 8 numbers"),
        ("odometry.tum", "# nothing\n", "holds no pose"),
    ],
)
def test_damaged_files_beside_a_log(tmp_path: Path, name: str, content: str, problem: str) -> None:
    path = put(tmp_path, FLAT)
    put(tmp_path, content, name)
    message = failure(path)
    assert name in message
    assert re.search(problem, message), message


def test_two_files_beside_a_log_are_one_too_many(tmp_path: Path) -> None:
    path = put(tmp_path, FLAT)
    put(tmp_path, MOTIONS, "odometry.csv")
    put(tmp_path, "3 0 0 0 0 0 0 1\n", "odometry.tum")
    assert "odometry.csv and odometry.tum exist beside it, expected one" in failure(path)


def test_motions_between_iterations_that_are_kept_are_composed() -> None:
    poses = walk(12)
    kept = np.array([1, 2, 5, 11])
    assert_allclose(composed(motions(poses), kept)[1:], motions(poses[kept])[1:], atol=1e-13)
    unknown = motions(poses)
    unknown[4] = np.nan
    assert np.isnan(composed(unknown, kept)).all(axis=(1, 2)).tolist() == [True, False, True, False]


def test_speeds_add_up_to_arcs() -> None:
    stamps, speed, turn = np.array([1.0, 2.0, 4.0]), np.array([1.0, 2, -1]), np.array([0, 0.5, 1])
    found = driven(Path("a"), stamps, speed, turn, np.array([0.5, 1.0, 1.5, 3.0, 4.5]))
    turned = checked_odometry(motion_from_velocity(2, 0.5, 1.0))
    half = checked_odometry([0.5, 0, 0])
    assert np.isnan(found[:2]).all()
    last = turned @ checked_odometry(motion_from_velocity(-1, 1.0, 0.5))
    assert_allclose(found[2:], [half, half @ turned, last], atol=1e-14)


def test_across_a_gap_between_speeds_the_motion_is_unknown(
    caplog: pytest.LogCaptureFixture,
) -> None:
    stamps = np.delete(np.arange(0.0, 20, 0.25), np.arange(21, 60))  # none from 5 to 15 s
    at = np.array([4.0, 5.0, 10.0, 15.0, 16.0])
    found = driven(Path("a"), stamps, np.ones(len(stamps)), np.zeros(len(stamps)), at)
    assert np.isnan(found[:, 0, 3]).tolist() == [True, False, True, True, False]
    assert_allclose(found[[1, 4], 0, 3], 1.0, atol=1e-12)
    across = driven(Path("a"), stamps, np.ones(len(stamps)), np.zeros(len(stamps)), at[[0, 1, 4]])
    assert np.isnan(across[:, 0, 3]).tolist() == [True, False, True]
    assert set(caplog.messages) == {"a: 1 gaps: the motion across them is unknown"}


def test_a_speed_holds_until_the_next_but_not_long_after_the_last() -> None:
    stamps = np.array([0.0, 0.1, 0.2, 1.9, 2.0])  # none between 0.2 and 1.9 s: it did not change
    at = np.array([0.1, 1.5, 2.0, 2.9, 3.2])
    found = driven(Path("a"), stamps, np.ones(5), np.zeros(5), at)
    assert np.isnan(found[:, 0, 3]).tolist() == [True, False, False, False, True]
    assert_allclose(found[1:4, 0, 3], [1.4, 0.5, 0.9], atol=1e-12)


def test_dlr_steps_are_turned_into_our_axes(tmp_path: Path) -> None:
    odometry = open_log(
        put(tmp_path, CIRCLES.replace("b.jpg 1 0", "b.jpg 1 -3"), "a.circles")
    ).odometry
    assert np.isnan(odometry[0]).all()
    assert planar(odometry[1:]) == [[3, -1, -0.1]]


def put_wheels(folder: Path, **changes: list[float]) -> Path:
    """Put Victoria Park's trees with speed and steering into a folder."""
    put(folder, TREES, "trees.csv")
    time = np.arange(250.0, 760, 25)
    fields = {"time": time, "speed": np.full(21, 4.0), "steering": np.full(21, 0.2)} | changes
    savemat(folder / "aa3_dr.mat", fields)
    return folder


def test_victoria_park_moves_as_the_model_of_the_car_says(tmp_path: Path) -> None:
    odometry = open_log(put_wheels(tmp_path)).odometry
    curvature = np.tan(0.2) / 2.83
    way = 4 / (1 - curvature * 0.76) * 0.2
    laser = checked_odometry([3.78, 0.5, 0])
    axle = checked_odometry(motion_from_velocity(way, way * curvature, 1.0))
    assert len(odometry) == 3
    assert_allclose(odometry[1], np.linalg.inv(laser) @ axle @ laser, atol=1e-12)
    assert_allclose(odometry[2], odometry[1], atol=1e-12)


@pytest.mark.parametrize(
    "changes", [{"speed": [4.0]}, {"steering": [1.5] * 21}, {"time": [5.0] * 21}]
)
def test_victoria_park_refuses_wheels(tmp_path: Path, changes: dict[str, list[float]]) -> None:
    message = failure(put_wheels(tmp_path, **changes))
    assert "aa3_dr.mat: fields time, speed, steering differ in length" in message


def test_slsjf_differences_of_its_odometry(tmp_path: Path) -> None:
    (tmp_path / "sensor_data.mat").write_bytes(mat(sensor_data=OBSERVED))
    path = np.array([[0.0, 1, 3], [0, 0, 2], [0.5, 0.5 + 2 * np.pi, 1]])
    (tmp_path / "store_robotOdo.mat").write_bytes(mat(store_robotOdo=path))
    odometry = open_log(tmp_path).odometry
    assert len(odometry) == 2
    c, s = np.cos(0.5), np.sin(0.5)
    assert planar(odometry[1:]) == [pytest.approx([c, -s, 0], abs=1e-9)]
    (tmp_path / "sensor_data.mat").write_bytes(mat(sensor_data=OBSERVED + np.eye(7)[0]))
    later = open_log(tmp_path)
    assert later.first_iteration == 1
    assert later.odometry[1, :2, 3] == pytest.approx(np.array([[c, s], [-s, c]]) @ [2, 2])


@pytest.mark.parametrize("end", ["", ".gz"])
def test_mrpt_motions_follow_their_step(tmp_path: Path, end: str) -> None:
    path = put(tmp_path, MRPT, "a.observations.csv")
    header = "step,dx_m,dy_m,dz_m,dyaw_rad,dpitch_rad,droll_rad\n"
    content = header + "0,1,2,3,0.1,0.2,0.3\n1,9,9,9,0,0,0\n"
    put(tmp_path, gzip.compress(content.encode()) if end else content, f"a.odometry.csv{end}")
    odometry = open_log(path).odometry
    assert np.isnan(odometry[0]).all()
    assert odometry[1, :3, 3].tolist() == [1, 2, 3]
    turn = Rotation.from_euler("ZYX", [0.1, 0.2, 0.3]).as_matrix()
    assert_allclose(odometry[1, :3, :3], turn, atol=1e-15)
    assert len(odometry) == 2
    lines = MRPT.replace("\n0,", "\n5,").replace("\n1,", "\n6,")
    put(tmp_path, lines, "b.observations.csv")
    put(tmp_path, content.replace("\n0,", "\n5,").replace("\n1,", "\n6,"), "b.odometry.csv")
    later = open_log(tmp_path / "b.observations.csv")
    assert later.first_iteration == 5
    assert_array_equal(later.odometry, odometry)


def test_mrpt_laser_motions_follow_their_scan(tmp_path: Path) -> None:
    rows = ["10,0,0,0,1,0.5,0.25,1,2,3", "12,0,0,0,9,9,9,1,2,3", "11,0,0,0,2,0,0,1,2,3"]
    content = LASER_COMMENT + LASER_HEADER + "\n".join(rows[:1] + rows[2:] + rows[1:2])
    log = open_scans(put(tmp_path, content, "a.csv"))
    assert planar(log.odometry[1:]) == [[1, 0.5, 0.25], [2, 0, 0]]


def test_plain_logs_have_none(tmp_path: Path) -> None:
    assert open_log(put(tmp_path, PLAIN)).odometry is None
    assert open_log(put(tmp_path, MRPT, "a.csv")).odometry is None
