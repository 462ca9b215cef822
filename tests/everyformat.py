"""One small world of points and one of walls, written in every format that relmap reads."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.datasets import ObservationLog, write_observation_csv, write_scans_npz
from relmap.datasets.scans import SensorView, planar_poses
from relmap.evaluation.truth import Truth, write_truth
from relmap.io.files import atomic_write, write_tum
from relmap.io.tables import csv_text
from relmap.simulation import simulate_building
from tests import bagfiles
from tests.scanlogs import ply

Mapped = Callable[[str], Path]

NASTY = "a <script>alert(1)<script> & $x$ \"q\" 'p'.csv"
"""The name of a log that would be markup."""
"""Takes the name of a log and gives the result folder of its map."""
POINTS = [
    ("observation-csv", "csv/observations.csv"),
    ("observation-csv", "gz"),
    ("observation-csv", "flat"),
    ("mrpt-landmarks", "mrpt/a.observations.csv.gz"),
    ("victoria-park", "park"),
    ("dlr-circles", "circles"),
    ("slsjf-sim", "beacons"),
    ("mrclam", "robots"),
    ("own-table", "table/seen.parquet"),
    ("bag-detections", "detections/a.bag"),
]
WALLS = [
    ("scans-npz", "npz"),
    ("carmen-log", "carmen/a.log.gz"),
    ("carmen-log", "graph/a.log"),
    ("mrpt-laser2d", "laser/a.scans.csv.gz"),
    ("point-clouds", "clouds"),
    ("kitti-bin", "kitti"),
    ("bag-scans", "scans/a.bag"),
]
K, N, BEAMS = 30, 12, 181
LASER_AHEAD_M = 0.4
"""Where MRPT's laser is on the robot."""


def text(path: Path, lines: Iterable[str]) -> None:
    """Write a text file, packed where its name says so."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def write_points(folder: Path) -> None:
    """Write a drive past landmarks that are all seen in each of `K` iterations.

    `csv` and `gz` are in space, all others but `mrpt` in the plane.
    """
    rng = np.random.default_rng(5)
    places = rng.uniform([-3, -6, -2], [9, 6, 2], (N, 3))
    k = np.arange(K)
    poses = planar_poses(*(step * k.astype(np.float64) for step in (0.2, 0.02, 0.01)))
    seen = np.concatenate([(places - T[:3, 3]) @ T[:3, :3] for T in poses])
    seen += rng.normal(0, 0.01, seen.shape)
    ids, iteration = np.tile(np.arange(N), K), np.repeat(k, N)
    log = ObservationLog(seen, iteration, np.arange(N * K), 0, K, ids)
    truth = Truth(np.arange(N), places, np.full(N, "static"), k.astype(float), poses)
    flat = replace(truth, landmarks_map=places * [1, 1, 0])
    for name, file, one, of in (
        ("csv", "observations.csv", log, truth),
        ("gz", "observations.csv.gz", log, truth),
        ("flat", "observations.csv", replace(log, points_robot=seen[:, :2]), flat),
    ):
        (folder / name / "truth").mkdir(parents=True)
        write_observation_csv(folder / name / file, one)
        write_truth(folder / name / "truth", of)
    _write_mrpt(folder / "mrpt", log, truth)
    _write_park(folder / "park", log, places)
    _write_circles(folder / "circles", log, truth)
    _write_beacons(folder / "beacons", log, truth)
    _write_robots(folder / "robots", log, truth)
    _write_table(folder / "table", log)
    _write_detections(folder / "detections", log, truth)


def _write_mrpt(folder: Path, log: ObservationLog, truth: Truth) -> None:
    x, y, z = log.points_robot.T
    r = np.linalg.norm(log.points_robot, axis=1)
    rows = zip(log.iteration, _ids(log), r, np.arctan2(y, x), -np.arcsin(z / r), strict=True)
    text(
        folder / "a.observations.csv.gz",
        [
            "# sensor on robot: t = 0 0 0 ; R (row major) = 1 0 0 0 1 0 0 0 1",
            "# sigma: range 0.01 m, yaw 0.001 rad, pitch 0.001 rad; x",
            "step,id,range_m,yaw_rad,pitch_rad",
            *(",".join(map(str, row)) for row in rows),
        ],
    )
    landmarks = zip(*truth.landmarks_map.T, truth.landmark_ids, strict=True)
    lines = [f"{x} {y} {z} 5 0 0.0 {i}" for x, y, z, i in landmarks]
    text(folder / "a_ground_truth.txt", lines)
    angles = Rotation.from_matrix(truth.poses[:, :3, :3]).as_euler("ZYX")
    path = np.column_stack([truth.poses[:, :3, 3], angles])
    lines = [" ".join(map(repr, row)) for row in path.tolist()]
    text(folder / "a_ground_truth_robot_path.txt", lines)


def _write_park(folder: Path, log: ObservationLog, places: Floats) -> None:
    x, y, _ = log.points_robot.T
    t_ms, r, bearing = 200 * log.iteration, np.hypot(x, y), np.arctan2(x, -y)
    rows = zip(log.iteration, t_ms, r, bearing, strict=True)
    header = "scan,t_ms,range_m,bearing_rad,diameter_m"
    lines = [header, *(f"{k},{t},{r},{b},0.3" for k, t, r, b in rows)]
    text(folder / "trees_per_scan.csv.gz", lines)
    ids = _ids(log)
    told = np.column_stack([t_ms, r, bearing, places[ids, :2], ids])
    name = "data_sensor_clean_clean"
    savemat(folder / f"{name}.mat", {name: told})


def _write_circles(folder: Path, log: ObservationLog, truth: Truth) -> None:
    lines = []
    for scan in log.scans():
        x, y, yaw = _motion(truth.poses, scan.iteration)
        lines.append(f"STEP image {-y} {-x} {-yaw} 0 0 0 0 0 0")
        for (x, y, _), i in zip(scan.points_robot, scan.ids, strict=True):
            lines.append(f"LANDMARK_C {-y} {-x} 0.9 0.001 0 0.001 {i}")
    text(folder / "map.circles", lines)


def _write_beacons(folder: Path, log: ObservationLog, truth: Truth) -> None:
    folder.mkdir()
    x, y, _ = log.points_robot.T
    ids, nothing = _ids(log), np.zeros((len(x), 3))
    told = np.column_stack([log.iteration + 1, ids, np.hypot(x, y), np.arctan2(y, x), nothing])
    savemat(folder / "sensor_data.mat", {"sensor_data": told})
    beacons = np.column_stack([truth.landmark_ids, truth.landmarks_map[:, :2]])
    savemat(folder / "store_beaconsTrue.mat", {"store_beaconsTrue": beacons})
    path = np.vstack([truth.poses[:, :2, 3].T, _yaw(truth.poses)])
    savemat(folder / "store_robotTrue.mat", {"store_robotTrue": path})


def _write_robots(folder: Path, log: ObservationLog, truth: Truth) -> None:
    x, y, _ = log.points_robot.T
    codes = [f"{subject} {100 - subject}" for subject in range(1, N + 6)]
    text(folder / "Barcodes.dat", ["# Subject #    Barcode #", *codes])
    rows = zip(log.iteration, _ids(log), np.hypot(x, y), np.arctan2(y, x), strict=True)
    measured = [f"{0.2 * k} {100 - (i + 6)} {r} {b}" for k, i, r, b in rows]
    text(folder / "Robot2_Measurement.dat.gz", measured)
    path = np.column_stack([truth.poses[:, :2, 3], _yaw(truth.poses)]).tolist()
    vicon = [f"{0.2 * k} {x} {y} {yaw}" for k, (x, y, yaw) in enumerate(path)]
    text(folder / "Robot2_Groundtruth.dat", vicon)
    steps = enumerate(_motion(truth.poses, k + 1) for k in range(K))
    velocities = [f"{0.2 * k} {x / 0.2} {yaw / 0.2}" for k, (x, _, yaw) in steps]
    text(folder / "Robot2_Odometry.dat", velocities)
    places = enumerate(truth.landmarks_map.tolist(), 6)
    text(folder / "Landmark_Groundtruth.dat", [f"{i} {x} {y} 1e-4 1e-4" for i, (x, y, _) in places])


def _write_table(folder: Path, log: ObservationLog) -> None:
    folder.mkdir()
    cells = {"iteration": log.iteration, "id": _ids(log), "note": [""] * len(log.iteration)}
    cells |= dict(zip("xyz", log.points_robot.T, strict=True))
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pytest.importorskip("pyarrow").table(cells), folder / "seen.parquet")


def _write_detections(folder: Path, log: ObservationLog, truth: Truth) -> None:
    folder.mkdir()
    types, messages = bagfiles.Types("ros1"), []
    for scan, T in zip(log.scans(), truth.poses, strict=True):
        t = 1.0 + scan.iteration
        seen = zip(map(str, scan.ids.tolist()), scan.points_robot.tolist(), strict=True)
        messages += [("/odom", t, types.odometry(t, T)), ("/seen", t, types.boxes(t, seen))]
    bagfiles.write_bag(folder, "ros1", types, messages)


def _motion(poses: Floats, k: int) -> list[float]:
    """Return x, y, yaw of the motion to pose k from the one before; none beyond the ends."""
    if not 0 < k < len(poses):
        return [0.0, 0.0, 0.0]
    T = np.linalg.inv(poses[k - 1]) @ poses[k]
    return [*T[:2, 3].tolist(), float(np.arctan2(T[1, 0], T[0, 0]))]


def _ids(log: ObservationLog) -> Ints:
    return log.ids


def _yaw(poses: Floats) -> Floats:
    return np.arctan2(poses[:, 1, 0], poses[:, 0, 0])


def write_walls(folder: Path, scans: int = 16) -> None:
    """Write a drive of a laser through a part of a building; `clouds` are points in space."""
    world = simulate_building(BEAMS, 0.01, sampling="laser", iterations=scans)
    ranges = [np.asarray(scan.ranges_m) for scan in world.scans]
    stamps_s, poses = world.stamps_s, world.trajectory
    (folder / "npz" / "truth").mkdir(parents=True)
    view = SensorView(world.sensor.view_rad, world.sensor.range_m)
    points = [scan.points[:, :2] for scan in world.scans]
    write_scans_npz(folder / "npz" / "scans.npz", points, stamps_s, view)
    walls = np.column_stack([world.walls[:, :4], world.times_seen()[:, 1:]]).tolist()
    header = ("plane", "x0", "y0", "x1", "y1", "corner0", "corner1")
    rows = [[n, *row[:4], *map(int, row[4:])] for n, row in enumerate(walls)]
    atomic_write(folder / "npz" / "truth" / "planes.csv", csv_text(header, rows))
    write_tum(folder / "npz" / "truth" / "trajectory.tum", stamps_s, poses)
    pose = np.column_stack([poses[:, :2, 3], _yaw(poses)]).tolist()
    _write_carmen(folder, ranges, pose, stamps_s.tolist())
    _write_relations(folder / "graph" / "a.relations", poses, stamps_s)
    robot = poses.copy()
    robot[:, :3, 3] -= LASER_AHEAD_M * poses[:, :3, 0]
    _write_mrpt_laser(folder / "laser" / "a.scans.csv.gz", ranges, robot, stamps_s)
    _write_clouds(folder / "clouds", scans)
    (folder / "scans").mkdir()
    types, first, beam = bagfiles.Types("ros1"), -np.pi / 2, np.pi / (BEAMS - 1)
    messages = []
    for r, T, t in zip(ranges, poses, 1 + stamps_s, strict=True):
        messages.append(("/odom", t, types.odometry(t, T)))
        messages.append(("/scan", t, types.scan(t, r.tolist(), first, beam)))
    bagfiles.write_bag(folder / "scans", "ros1", types, messages)


def _cells(values: Iterable[float], nothing: float) -> str:
    return " ".join(repr(value if value < np.inf else nothing) for value in map(float, values))


def _write_carmen(
    folder: Path, ranges: list[Floats], pose: list[list[float]], stamps_s: list[float]
) -> None:
    """Write both kinds of log; the logger's clock is a thousand seconds ahead."""
    flaser, graph = [], []
    step, zeros = np.pi / (BEAMS - 1), "0 0 0 0 0"
    for k, (r, t) in enumerate(zip(ranges, stamps_s, strict=True)):
        p = " ".join(map(repr, pose[k]))
        flaser.append(f"FLASER {BEAMS} {_cells(r, 0.0)} {p} {p} {t} host {t + 1000}")
        graph.append(f"VERTEX2 {k} {p}")
        head = f"ROBOTLASER1 0 {-np.pi / 2} {np.pi} {step} 8.0 0.1 0 {BEAMS} {_cells(r, 8.0)}"
        graph.append(f"{head} 0 {p} {p} {zeros} {t} host {t + 1000}")
    text(folder / "carmen" / "a.log.gz", flaser)
    text(folder / "graph" / "a.log", graph)


def _write_relations(path: Path, poses: Floats, stamps_s: Floats) -> None:
    lines = []
    for begin in range(len(poses) - 5):
        T = np.linalg.inv(poses[begin]) @ poses[begin + 5]
        x, y = T[:2, 3].tolist()
        yaw = float(np.arctan2(T[1, 0], T[0, 0]))
        lines.append(f"{stamps_s[begin]} {stamps_s[begin + 5]} {x} {y} 0 0 0 {yaw}")
    text(path, lines)


def _write_mrpt_laser(path: Path, ranges: list[Floats], poses: Floats, stamps_s: Floats) -> None:
    beams = ",".join(f"r{k}" for k in range(BEAMS))
    lines = [
        f"# sensor on robot x={LASER_AHEAD_M} y=0 z=0.1 yaw=0 ; max range 8 m",
        f"t_s,gt_x,gt_y,gt_theta,odo_dx,odo_dy,odo_dtheta,{beams}",
    ]
    for k, (r, T, yaw, t) in enumerate(zip(ranges, poses, _yaw(poses), stamps_s, strict=True)):
        row = [t, *T[:2, 3], yaw, *_motion(poses, k + 1), *np.minimum(r, 8.0)]
        lines.append(",".join(repr(float(value)) for value in row))
    text(path, lines)


def _write_clouds(folder: Path, scans: int) -> None:
    world = simulate_building(800, 0.01, iterations=scans)
    kitti = folder.with_name("kitti")
    folder.mkdir()
    kitti.mkdir()
    rows = []
    for number, (scan, T, t) in enumerate(
        zip(world.scans, world.trajectory, world.stamps_s, strict=True)
    ):
        (folder / f"{number}.ply").write_bytes(ply(scan.points))
        reflectance = np.full(len(scan.points), 0.5)
        points = np.column_stack([scan.points, reflectance]).astype("<f4")
        (kitti / f"{number}.bin").write_bytes(points.tobytes())
        matrix = T.copy()
        matrix[3, 3] = t
        rows += [",".join(map(repr, row)) for row in matrix.tolist()]
    text(folder / "alidarPose.csv", rows)
