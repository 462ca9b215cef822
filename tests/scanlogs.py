"""Small logs of point scans and how they are read or refused, for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

from relmap.core.arrays import Floats
from relmap.core.odometry import checked_odometry
from relmap.datasets import ScanLog, open_scans
from tests.logs import one_line_error

ZEROS = "0 0 0 0 0"
GRAPH = (
    "VERTEX2 0 7 8 0.5\n"
    f"ROBOTLASER1 0 -1.5 3 0.5 50 0.1 0 3 1 2 60 0 0.2 0 0 0 0 0 {ZEROS} 10.5 host 0.1\n"
    "VERTEX2 1 8 8 0.5\nEDGE2 0 1 1 0 0 1 0 1 1 0 0\n"
    "ROBOTLASER1 0 -1.5 3 0.5 50 0.1 0 3 1 0 49 2 .5 .5 2 1 1.5 2 1 1.5707963267948966 "
    f"{ZEROS} 11.5 host 0.2\n"
)
CORRECTED = (
    "# message formats defined: PARAM FLASER\nPARAM robot_use_laser on nohost 0\n"
    "ODOM 0 0 0 0 0 0 1 host 1\n"
    "FLASER 2 3.5 81.91 1 2 0.5 1 2 0.5 4.5 host 9\n"
    "NEFF 12\n"
    "FLASER 3 1 2 81.8 1 2 0.5 1 2 0.5 5.5 host 9\n"
)
LASER_COMMENT = "# sensor on robot x=0.2 y=0 z=0.1 yaw=0 ; 3 beams, max range 80 m\n"
LASER_HEADER = "t_s,gt_x,gt_y,gt_theta,odo_dx,odo_dy,odo_dtheta,r0,r1,r2\n"
LASER = f"{LASER_COMMENT}{LASER_HEADER}10,1,2,0.5,0,0,0,1,2,3\n11,2,2,0.5,0,0,0,1,80,3\n"
CLOUD = np.array([[1.0, 2, 3], [4, 5, 6], [np.nan, 0, 0], [7, 8, 9]])


def failure(path: Path, format: str | None = None) -> str:
    """Return the one-line error of a log, raised at the latest when its scans are read."""
    message = one_line_error(lambda: list(open_scans(path, format).scans()))
    assert len(message) < 640, len(message)
    return message


def planar(odometry: Floats) -> list[list[float]]:
    """Return x, y, yaw of motions in the plane."""
    yaw = np.arctan2(odometry[:, 1, 0], odometry[:, 0, 0])
    known = ~np.isnan(yaw)
    flat = np.array([checked_odometry([0, 0, angle]) for angle in yaw[known]])
    flat[:, :2, 3] = odometry[known, :2, 3]
    assert_allclose(odometry[known], flat, atol=1e-12)
    found: list[list[float]] = np.column_stack([odometry[:, :2, 3], yaw]).round(12).tolist()
    return found


def points_of(log: ScanLog) -> list[list[list[float]]]:
    return [scan.points_robot.round(12).tolist() for scan in log.scans()]


def lzf(content: bytes) -> bytes:
    """Return bytes packed as LZF: earlier content of three bytes or more is repeated."""
    packed, literal, at = b"", b"", 0
    while at < len(content):
        length, back = _repetition(content, at)
        literal += b"" if length else content[at : at + 1]
        at += length or 1
        if literal and (length or len(literal) == 32 or at == len(content)):
            packed, literal = packed + bytes([len(literal) - 1]) + literal, b""
        if length:
            more = [length - 9] if length > 8 else []
            packed += bytes([min(length - 2, 7) << 5 | back - 1 >> 8, *more, back - 1 & 255])
    return packed


def _repetition(content: bytes, at: int) -> tuple[int, int]:
    """Return the length of the longest repetition of earlier content, and its distance."""
    start = content.rfind(content[at : at + 3], max(at - (1 << 13), 0), at + 2)
    if start < 0 or at + 3 > len(content):
        return 0, 0
    length = 3
    while (
        length < 264
        and content[start + length : start + length + 1]
        == content[at + length : at + length + 1]
        != b""
    ):
        length += 1
    return length, at - start


def packed_pcd(points: Floats) -> bytes:
    """Return a PCD file of the form binary_compressed."""
    header = pcd(points).partition(b"DATA")[0]
    content = points.T.astype("<f4").tobytes()
    packed = lzf(content)
    sizes = np.array([len(packed), len(content)], dtype="<u4").tobytes()
    return header + b"DATA binary_compressed\n" + sizes + packed


def pcd(points: Floats, declared: int | None = None) -> bytes:
    n = len(points) if declared is None else declared
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\n"
        f"TYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {n}\nDATA binary\n"
    )
    return header.encode() + points.astype("<f4").tobytes()


def ply(points: Floats, declared: int | None = None) -> bytes:
    n = len(points) if declared is None else declared
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    return f"ply\nformat ascii 1.0\nelement vertex {n}\n{axes}end_header\n{rows}".encode()


def npz(path: Path, **changes: object) -> Path:
    """Write a log of two scans with some arrays changed, or left out where None."""
    arrays: dict[str, object] = {
        "points": np.arange(9.0).reshape(3, 3),
        "iteration": np.array([0, 0, 1]),
        "stamps_s": np.array([0.5, 1.5]),
    }
    kept = {name: value for name, value in (arrays | changes).items() if value is not None}
    np.savez(path, **kept)  # type: ignore[arg-type]
    return path
