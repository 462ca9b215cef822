"""Which poses of CARMEN logs are used as odometry, and which as the corrected path."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relmap.datasets import open_scans
from relmap.datasets.scans import ScanLog
from tests.logs import put
from tests.scanlogs import CORRECTED, GRAPH, failure, planar


def flaser(laser: str, robot: str, t: float) -> str:
    return f"FLASER 2 3.5 80 {laser} {robot} {t} host {t}\n"


def carmen(*lines: str) -> str:
    return "PARAM robot_frontlaser_offset 0.2 nohost 0\n" + "".join(lines)


WHEELS = "ODOM 0 0 0 0.5 0.1 0 1 host 1\n"
RAW = [
    flaser("0.2 0 0", "0 0 0", 1),
    flaser("1.2 0 0", "1 0 0", 2),
    flaser("1 1.2 1.5707963267948966", "1 1 1.5707963267948966", 3),
]
BESIDE = [
    flaser("0.2 0 0", "0 0 0", 1),
    flaser("1.2 0.5 0.5", "1 0 0", 2),
    flaser("1 2.2 1.8", "1 1 1.5707963267948966", 3),
]
LASER_MOVED = [[1, 0, 0], [-0.2, 1.2, 1.570796326795]]


@pytest.mark.parametrize("lines", [[WHEELS, *RAW], BESIDE])
def test_carmen_odometry_is_taken_where_there_is_evidence(tmp_path: Path, lines: list[str]) -> None:
    log = open_scans(put(tmp_path, carmen(*lines), "a.log"))
    assert not log.no_odometry
    assert planar(log.odometry[1:]) == LASER_MOVED


@pytest.mark.parametrize(
    "lines",
    [
        RAW,
        [WHEELS.replace("0.5 0.1", "0 0"), *RAW],
        [WHEELS, "NEFF 10\n", *RAW],
        [WHEELS, *(line.replace("FLASER 2 3.5 80 0.2", "FLASER 2 3.5 80 0") for line in RAW[:1])],
    ],
)
def test_carmen_corrected_paths_are_not_odometry(tmp_path: Path, lines: list[str]) -> None:
    log = open_scans(put(tmp_path, carmen(*lines), "a.log"))
    assert log.odometry is None
    assert "corrected path" in log.no_odometry
    assert log.between(0, 1).no_odometry == log.no_odometry


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        (RAW, "its odometry field may contain a corrected path: it has no wheel speeds"),
        (RAW[:1], "its odometry field holds no motion"),
        (["NEFF 10\n", *RAW], "its odometry field contains a corrected path: a particle filter"),
    ],
)
def test_only_what_was_found_out_is_said_of_the_odometry_field(
    tmp_path: Path, lines: list[str], reason: str
) -> None:
    log = open_scans(put(tmp_path, carmen(*lines), "a.log"))
    assert log.no_odometry.startswith(reason)


def graph(vertices: list[str], speeds: str) -> str:
    """Return a graph log of a robot that goes ahead by 1 m from scan to scan."""
    lines = []
    for k, vertex in enumerate(vertices):
        pose = f"{k} 0 0"
        scan = (
            f"ROBOTLASER1 0 -1.5 3 0.5 50 0.1 0 3 1 2 60 0 {pose} {pose} {speeds} 0 0 0 {k} h {k}"
        )
        lines += [f"VERTEX2 {k} {vertex}\n"] * bool(vertex) + [scan + "\n"]
    return "".join(lines)


@pytest.mark.parametrize(
    ("content", "there"),
    [
        (graph(["0 0 0", "1.1 0.1 0.1", "2.2 0.3 0.2"], "0 0"), True),
        (graph(["0 0 0", "1 0 0", "2 0 0"], "0 0"), False),
        (
            graph(["5 5 1.5707963267948966", "5 6 1.5707963267948966", "5 7 1.57079633"], "0 0"),
            False,
        ),
        (graph(["", "", ""], "1 0"), True),
        (graph(["", "", ""], "0 0"), False),
        (GRAPH, True),
        (CORRECTED, False),
    ],
)
def test_graph_logs_have_odometry_beside_another_path(
    tmp_path: Path, content: str, there: bool
) -> None:
    log = open_scans(put(tmp_path, content, "a.log"))
    assert (log.odometry is not None) == there
    assert bool(log.no_odometry) != there


def test_a_file_beside_a_corrected_log_is_used(tmp_path: Path) -> None:
    path = put(tmp_path, CORRECTED, "a.log")
    put(tmp_path, "iteration,x,y,yaw\n1,1,2,0.5\n", "odometry.csv")
    odometry = open_scans(path).odometry
    assert planar(odometry[1:]) == [[1, 2, 0.5]]
    put(tmp_path, "iteration,x,y,yaw\n1,1,2\n", "odometry.csv")
    assert "odometry.csv: line 2: 3 fields" in failure(path)


@pytest.mark.parametrize(
    "name",
    [
        "belgioioso-corrected",
        "csail-corrected",
        "edmonton-corrected",
        "fhw-corrected",
        "fr079",
        "freiburg-079-corrected",
        "freiburg-101-corrected",
        "mit-cscail",
        "orebro-corrected",
    ],
)
def test_no_corrected_path_is_taken_for_odometry(
    real_scans: Callable[[str], ScanLog], name: str
) -> None:
    log = real_scans(f"carmen-laser2d/{name}.log.gz")
    assert log.odometry is None
    assert "corrected path" in log.no_odometry


def test_odometry_of_mrpts_laser_is_that_of_its_path(shared_data: Path) -> None:
    log = open_scans(shared_data / "mrpt-sim-laser2d")
    true = np.linalg.inv(log.poses[:-1]) @ log.poses[1:]
    off = np.linalg.norm((log.odometry[1:] - true)[:, :2, 3], axis=1)
    way = np.linalg.norm(true[:, :2, 3], axis=1)
    assert np.median(off) < 0.2 * np.median(way)
    assert log.odometry[1:, 0, 3].sum() == pytest.approx(true[:, 0, 3].sum(), rel=0.02)
