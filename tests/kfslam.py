"""MRPT's ``kf-slam`` (Debian's mrpt-apps), an independent filter, run on our logs."""

from __future__ import annotations

import gzip
import re
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.datasets.base import ObservationLog

PROGRAM = shutil.which("kf-slam")
_END = b"\x88"
_CONFIG = """
[MappingApplication]
rawlog_file={folder}/log.rawlog
ground_truth_file={truth}
logOutput_dir={folder}/log
SAVE_LOG_FREQUENCY={every}
SAVE_MAP_REPRESENTATIONS=false
SAVE_3D_SCENES=false
SHOW_3D_LIVE=false
[RangeBearingKFSLAM_KalmanFilter]
method={method}
verbose=1
[RangeBearingKFSLAM]
force_ignore_odometry=true
std_odo_z_additional=0
std_sensor_range={range_sd_m}
std_sensor_yaw_deg={bearing_sd_deg}
std_sensor_pitch_deg={bearing_sd_deg}
"""


def write_rawlog(path: Path, log: ObservationLog, range_m: float, T_robot_sensor: Floats) -> None:
    """Write observations (n, 3), sensor frame, as MRPT's range, yaw (left), pitch (down).

    The format is read off the files of MRPT's own demonstration: little-endian objects of a name,
    a version, fields and the byte 0x88.  `kf-slam` leaves the first scan out: it comes twice.
    """
    assert log.ids is not None
    scans = [
        _scan(number, scan.points_robot, scan.ids, range_m, T_robot_sensor)
        for number, scan in enumerate(log.scans())
        if scan.ids is not None
    ]
    path.write_bytes(gzip.compress(b"".join([scans[0], *(_action() + scan for scan in scans)])))


def _head(name: str, version: int) -> bytes:
    return bytes([0x80 | len(name)]) + name.encode() + bytes([version])


def _pose(T: Floats) -> bytes:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    return _head("CPose3D", 2) + struct.pack("<7d", *T[:3, 3], w, x, y, z)


def _scan(number: int, points: Floats, ids: Ints, range_m: float, T_robot_sensor: Floats) -> bytes:
    level = np.hypot(points[:, 0], points[:, 1])
    seen = np.zeros(len(ids), [("r", "<f4"), ("yaw", "<f4"), ("pitch", "<f4"), ("id", "<i4")])
    seen["r"] = np.linalg.norm(points, axis=1)
    seen["yaw"] = np.arctan2(points[:, 1], points[:, 0])
    seen["pitch"] = -np.arctan2(points[:, 2], level)
    seen["id"] = ids
    return b"".join(
        [
            _head("CSensoryFrame", 2) + struct.pack("<I", 1),
            _head("CObservationBearingRange", 3),
            struct.pack("<ffff", 0.0, range_m, np.pi, np.pi) + _pose(T_robot_sensor) + _END,
            struct.pack("<q", 129_000_000_000_000_000 + 1_000_000 * number),
            b"\x00" + struct.pack("<fffI", 0.01, 0.01, 0.01, len(ids)),
            seen.tobytes() + struct.pack("<I", 0) + _END + _END,
        ]
    )


def _action() -> bytes:
    return _head("CActionCollection", 0) + struct.pack("<I", 0) + _END


def run_kfslam(
    folder: Path,
    log: ObservationLog,
    range_sd_m: float,
    bearing_sd_rad: float,
    method: int = 0,
    truth: str = "",
    every: int = 1,
    T_robot_sensor: Floats | None = None,
) -> tuple[Floats, str]:
    """Run it; return the poses (k, 4, 4) of the iterations it completed, and its output."""
    on_robot = np.eye(4) if T_robot_sensor is None else T_robot_sensor
    write_rawlog(folder / "log.rawlog", log, 100.0, on_robot)
    settings = {"range_sd_m": range_sd_m, "bearing_sd_deg": np.rad2deg(bearing_sd_rad)}
    text = _CONFIG.format(folder=folder, truth=truth, method=method, every=every, **settings)
    (folder / "config.ini").write_text(text)
    done = subprocess.run(
        [str(PROGRAM), str(folder / "config.ini")],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    found = re.findall(r"Mean pose: .*?=\(([^)]*)\)", done.stdout)
    rows = np.array([row.split(",") for row in found], dtype=np.float64).reshape(-1, 7)
    files = sorted((folder / "log").glob("robot_pose_*.txt"))
    if every == 1 and files:
        rows = np.array([np.loadtxt(file).ravel() for file in files])
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(rows[:, [4, 5, 6, 3]]).as_matrix()
    poses[:, :3, 3] = rows[:, :3]
    return poses, done.stdout


if __name__ == "__main__":
    # python -m tests.kfslam: processor time of iterations 800 to 900 of a figure eight, density 25.
    import resource
    import tempfile

    from relmap.simulation import simulate_figure_eight

    eight = simulate_figure_eight().log
    for number, update in ((0, "full update"), (1, "one scalar at a time, as its config has it")):
        took_s = []
        for iterations in (800, 900):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            with tempfile.TemporaryDirectory() as name:
                run_kfslam(
                    Path(name), eight.between(0, iterations), 0.05, 0.05 / 40, number, every=10**6
                )
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            took_s.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        print(f"kf-slam, {update}: {10 * (took_s[1] - took_s[0]):.1f} ms an iteration")
