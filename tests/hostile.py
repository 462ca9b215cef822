"""Every reader, with valid files for it."""

from __future__ import annotations

import gzip
import io
import json
import lzma
import tempfile
from collections.abc import Callable
from contextlib import chdir
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.io import savemat

from relmap.cli.arguments import read_config
from relmap.cli.evaluate import evaluate_folder, find_log
from relmap.cli.mapping import map_input
from relmap.comparison.sweep_spec import cells_of
from relmap.core.arrays import Floats
from relmap.datasets import open_log, open_scans, read_relations
from relmap.evaluation import evaluate as evaluation
from relmap.evaluation.truth import read_truth
from relmap.io.files import read_toml
from relmap.io.results import json_text
from relmap.mapper import Mapper
from relmap.planes.walls.files import PlaneResult, read_any
from relmap.planes3d.files import read_result3d
from tests import bagfiles
from tests.logs import PLAIN, TREES
from tests.scanlogs import CLOUD, CORRECTED, GRAPH, LASER, packed_pcd, pcd, ply

Files = dict[str, bytes]


@dataclass(frozen=True)
class Reader:
    """A reader, valid files for it, and which of them is damaged.

    ``read`` takes the folder that holds the files; the points of a log of scans are not yet read.
    """

    files: Files
    damaged: str
    read: Callable[[Path], object]


def packed(content: bytes) -> bytes:
    return gzip.compress(content, 1, mtime=0)


def npz(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def mat(compress: bool = True, **arrays: Floats) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        savemat(Path(name) / "a.mat", arrays, do_compression=compress)
        return (Path(name) / "a.mat").read_bytes()


def parquet() -> bytes:
    stream = io.BytesIO()
    library = pytest.importorskip("pyarrow.parquet")
    cells = {"iteration": [0, 0, 2], "x": [1.0, 2, 3], "y": [4, 5, 6], "id": ["a", "b", None]}
    library.write_table(pytest.importorskip("pyarrow").table(cells), stream)
    return stream.getvalue()


def bag(kind: str, what: str) -> tuple[str, bytes]:
    """Return name and content of a bag with odometry, transforms, and scans or detections."""
    types, still = bagfiles.Types(kind), np.eye(4)
    messages = [("/tf_static", 0.5, types.transform(0.5, "base_link", "laser", still))]
    for t in (1.0, 2.0, 3.0):
        messages.append(("/odom", t, types.odometry(t, still)))
        if what == "scans":
            messages.append(("/scan", t, types.scan(t, [1.0, 2, 3], -1.0, 1.0)))
        else:
            messages.append(("/seen", t, types.boxes(t, [("a", (1, 2, 3)), ("b", (3, 2, 1))])))
    with tempfile.TemporaryDirectory() as folder:
        file = bagfiles.file_of(bagfiles.write_bag(Path(folder), kind, types, messages))
        return f"a{file.suffix}", file.read_bytes()


def scans(**changes: object) -> bytes:
    arrays: dict[str, object] = {
        "points": np.arange(9.0).reshape(3, 3),
        "iteration": np.array([0, 0, 1]),
        "stamps_s": np.array([0.5, 1.5]),
    }
    return npz(**(arrays | changes))


OBSERVED = np.column_stack([[1, 1, 2], [4, 7, 4], [3, 2, 5.0], [0.1, 1, -1], np.zeros((3, 3))])
MRPT = (
    "# sensor on robot: t = 0.5 0.2 0.1 ; R (row major) = 1 0 0 0 1 0 0 0 1\n"
    "# sigma: range 0.01 m, yaw 0.001745 rad, pitch 0 rad; x\n"
    "step,id,range_m,yaw_rad,pitch_rad\n0,3,5,0.5,0\n0,4,6,-0.5,0\n1,3,5.5,0.25,0\n"
)
CIRCLES = (
    "STEP a.jpg 0 0 0 1 0 1 0 0 1\nLANDMARK_C 1 2 0.9 1 0 1 5\nLANDMARK_C 2 2 0.9 1 0 1 -1\n"
    "STEP b.jpg 1 0 0.1 1 0 1 0 0 1\nLANDMARK_C 1 1 0.9 1 0 1 5 6\n"
)
MOTIONS = "step,dx_m,dy_m,dz_m,dyaw_rad,dpitch_rad,droll_rad\n0,1,2,3,0.1,0.2,0.3\n1,9,9,9,0,0,0\n"
BESIDE = {
    "odometry.csv": "iteration,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n2,0.5,-1,0,0,0,0.6,0.8\n",
    "odometry.tum": "# t x y z qx qy qz qw\n0.0 0 0 0 0 0 0 1\n1.5 1 0 0 0 0 0.6 0.8\n",
}
KITTI = "1 0 0 5 0 1 0 6 0 0 1 7\n0 -1 0 5 1 0 0 6 0 0 1 8\n"
RELATIONS = "# a\n1.5 2.5 1 2 0 0 0 0.5\n2.5 3.5 0.1 0 0 0 0 -1e-3\n"
POSES = "1,0,0,1\n0,1,0,2\n0,0,1,3\n0,0,0,4.5\n"
CONFIG = 'group_after = 12\nmax_missed = 4\nregistration = "nearest-previous"\ngate_m = 0.5\n'
WALLS = (
    "plane,x0,y0,x1,y1,z0,z1,nx,ny,nz,end0,end1,observations,first_iteration,last_iteration,"
    "status,corner0,corner1\n0,0,0,4,0,0,2,0,1,0,corner,open,12,0,11,static,0,-1\n"
    "1,4,0,4,3,0,2,-1,0,0,corner,corner,12,0,11,static,1,2\n"
)
SURFACES = (
    "plane,nx,ny,nz,offset,x,y,z,sd,sd_normal,sd_centre,area_m2,observations,first_iteration,"
    "last_iteration,status,submap,outline,meets\n"
    "0,0,0,1,0,1,1,0,0.01,,,4,9,0,8,static,0,0 0 0;2 0 0;2 2 0;0 2 0,-1;-1;-1;1\n"
    "1,1,0,0,0,0,1,1,0.01,0.001,0.002,4,9,0,8,static,0,0 0 0;0 2 0;0 2 2;0 0 2,0;-1;-1;-1\n"
)
FACES = (
    "face,plane,x0,y0,z0,x1,y1,z1,x2,y2,z2,x3,y3,z3,seen_m2\n"
    "0,0,0,0,0,2,0,0,2,2,0,0,2,0,4\n1,1,0,0,0,0,2,0,0,2,2,0,0,2,3\n"
)
SWEEP = (
    'world = ["figure-eight"]\nseed = "0:2"\niterations = [20, 30]\ndensity = 25.0\n'
    'sigma = [0.0, 0.05]\nmethod = ["relmap-points"]\nassociation = ["known"]\n'
)
TUM = "# t x y z qx qy qz qw\n0.0 0 0 0 0 0 0 1\n1.0 1 0 0 0 0 0.1 0.995\n"


def _mapped() -> Files:
    """Return the files of a mapped log beside its truth."""
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (8, 3))
    rows = ["iteration,x,y,z,id"]
    for k in range(14):
        points = world - [0.1 * k, 0, 0] + rng.normal(0, 0.01, world.shape)
        rows += [f"{k},{x},{y},{z},{i}" for i, (x, y, z) in enumerate(points.tolist())]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = folder / "observations.csv"
        log.write_text("\n".join(rows))
        map_input(log, folder, association="known")
        files = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    summary = json.loads(files["summary.json"]) | {"input": log.name, "refinement": None}
    truth = ["landmark,x,y,z,status"]
    truth += [f"{i},{x},{y},{z},static" for i, (x, y, z) in enumerate(world.tolist())]
    del files["map.png"]
    return files | {
        "summary.json": json.dumps(summary).encode(),
        "truth/landmarks.csv": "\n".join(truth).encode(),
        "truth/trajectory.tum": TUM.encode(),
    }


def _evaluate(folder: Path) -> evaluation.Evaluation:
    """Evaluate without drawing, which takes most of the time of the verb."""
    truth = folder / "truth"
    result = read_any(folder)
    walls = isinstance(result, PlaneResult)
    known = read_truth(truth, "planes" if walls else "points")
    with chdir(folder):
        log = None if walls else find_log(result, truth, None)
    found = evaluation.evaluate(result, known, log)
    json_text(found.as_dict())
    return found


def _evaluate_space(folder: Path) -> evaluation.Evaluation:
    return evaluation.evaluate(read_result3d(folder), read_truth(folder / "truth", "planes3d"))


def _log(name: str, form: str | None = None) -> Callable[[Path], object]:
    return lambda folder: open_log(folder / name, form)


def _scan_log(name: str, form: str | None = None) -> Callable[[Path], object]:
    return lambda folder: open_scans(folder / name, form)


def _of_other_programs() -> dict[str, Reader]:
    """Return the readers of bags and Parquet if their packages are installed."""
    found = {}
    if find_spec("pyarrow"):
        found["own-table-parquet"] = Reader({"a": parquet()}, "a", _log("a"))
    for kind in bagfiles.KINDS if find_spec("rosbags") else ():
        for what, read in (("scans", _scan_log), ("seen", _log)):
            file, content = bag(kind, what)
            found[f"bag-{kind}-{what}"] = Reader({file: content}, file, read(file))
    return found


def _in_space() -> dict[str, Reader]:
    """Return the readers of clouds and images of sensors that are carried."""
    image = io.BytesIO()
    Image.fromarray(np.full((8, 12), 2000, dtype=np.uint16)).save(image, "PNG")
    clouds = {"0.bin": np.pad(CLOUD, ((0, 0), (0, 1))).astype("<f4").tobytes()}
    clouds |= {"1.bin": clouds["0.bin"], "poses.txt": KITTI.encode(), "times.txt": b"0.5\n1.5\n"}
    images = {
        "camera-intrinsics.txt": b"10 0 4\n0 20 2\n0 0 1\n",
        "frame-000000.depth.png": image.getvalue(),
        "frame-000000.pose.txt": b"1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n",
    }
    found = {f"kitti-{name}": Reader(clouds, name, _scan_log("", "kitti-bin")) for name in clouds}
    for name in images:
        found[f"depth-{name}"] = Reader(images, name, _scan_log("", "depth-images"))
    listed = {
        "camera-intrinsics.txt": images["camera-intrinsics.txt"],
        "depth.txt": b"# time file\n1.5 depth/1.5.png\n",
        "depth/1.5.png": image.getvalue(),
        "groundtruth.txt": b"1 0 0 0 0 0 0 1\n2 1 0 0 0 0 .6 .8\n",
    }
    for name in listed:
        found[f"tum-{name}"] = Reader(listed, name, _scan_log("", "tum-rgbd"))
    return found


def _paths() -> dict[str, Reader]:
    """Return the readers of odometry beside a log, and of true paths."""
    found = {}
    wheels = {"a.observations.csv": MRPT.encode(), "a.odometry.csv": MOTIONS.encode()}
    read = _log("a.observations.csv")
    found["mrpt-landmarks-odometry"] = Reader(wheels, "a.odometry.csv", read)
    for name, content in BESIDE.items():
        beside = {"observations.csv": PLAIN.encode(), name: content.encode()}
        found[name] = Reader(beside, name, _log("observations.csv"))
    paths = {"tum": "1.5 0 0 0 0 0 0 1\n2 1 0 0 0 0 .6 .8\n", "kitti": KITTI}
    for name, content in paths.items():
        path = {"a": content.encode(), "times.txt": b"0.5\n1.5\n"}
        found[f"truth-{name}"] = Reader(path, "a", lambda f: read_truth(f / "a"))
    return found


def _results(mapped: Files) -> dict[str, Reader]:
    """Return the readers of results and truths."""
    found = {}
    for name in ("landmarks.csv", "tracks.csv.gz", "trajectory.tum", "summary.json"):
        found[f"result-{name}"] = Reader(mapped, name, _evaluate)
    for name in ("truth/landmarks.csv", "truth/trajectory.tum"):
        found[name] = Reader(mapped, name, _evaluate)
    walls = mapped | dict.fromkeys(("planes.csv", "truth/planes.csv"), WALLS.encode())
    for name in ("planes.csv", "truth/planes.csv", "trajectory.tum"):
        found[f"walls-{name}"] = Reader(walls, name, _evaluate)
    space = mapped | {"planes.csv": SURFACES.encode(), "truth/faces.csv": FACES.encode()}
    for name in ("planes.csv", "truth/faces.csv"):
        found[f"space-{name}"] = Reader(space, name, _evaluate_space)
    for name in ("planes.csv", "truth/planes.csv"):
        found[f"drawn-{name}"] = Reader(walls, name, lambda f: evaluate_folder(f, f / "truth"))
    return found


def readers() -> dict[str, Reader]:
    """Return every reader by the name of its format."""
    mapped = _mapped()
    trees = np.column_stack([[300, 300, 700], [10, 5, 5], [np.pi / 2, 0, np.pi], *np.ones((3, 3))])
    park = {
        "trees.csv": TREES.encode(),
        "VictoriaParkSinSincronizar.mat": mat(TLsr=np.array([[0.1, 0.3, 0.5, 0.7]])),
        "data_sensor_clean_clean.mat": mat(data_sensor_clean_clean=trees),
        "aa3_dr.mat": mat(time=np.arange(50.0, 800, 25), speed=np.ones(30), steering=np.ones(30)),
    }
    beacons = {
        "sensor_data.mat": mat(sensor_data=OBSERVED),
        "store_beaconsTrue.mat": mat(store_beaconsTrue=np.array([[4, 1, 2], [7, 3, 4.0]])),
        "store_robotTrue.mat": mat(False, store_robotTrue=np.eye(3)),
        "store_robotOdo.mat": mat(store_robotOdo=np.eye(3)),
    }
    robots = {
        "Barcodes.dat": b"# a\n1 5\n6 63\n7 81\n",
        "Landmark_Groundtruth.dat": b"6 1 2 0.001 0.001\n7 3 4 0.001 0.001\n",
        "Robot1_Measurement.dat": b"10.5 63 2 0.5\n10.5 81 3 -0.5\n10.7 5 1 0\n11 63 2 0.25\n",
        "Robot1_Odometry.dat": b"10 0.5 0.1\n10.5 0.5 -0.1\n11 0 0\n",
        "Robot1_Groundtruth.dat": b"10 0 0 0\n10.5 0.25 0 0.1\n11 0.5 0 0.05\n",
    }
    own = {"a": b'frame;t;px;py;"n";name\n3;0.5;1,5;-2;"re;d";cone\n5;0.9;1;-2;;\n'}
    columns = {"x": "px", "y": "py", "iteration": "frame", "stamp": "t", "id": "name"}
    polar = "iteration,range,bearing,elevation,id\n0,2,0.5,-0.25,7\n0,5,-1,0,8\n2,3,3,1.5,7\n"
    clouds = {
        "0.pcd": pcd(CLOUD),
        "1.ply": ply(CLOUD[:2]),
        "2.pcd.xz": lzma.compress(pcd(CLOUD)),
        "3.pcd": packed_pcd(np.tile(CLOUD, (30, 1))),
        "alidarPose.csv": (POSES * 4).encode(),
    }
    found = {
        "observation-csv": Reader({"a": PLAIN.encode()}, "a", _log("a", "observation-csv")),
        "observation-csv-polar": Reader({"a": polar.encode()}, "a", _log("a")),
        "observation-csv-gz": Reader({"a": packed(PLAIN.encode())}, "a", _log("a")),
        "mrpt-landmarks": Reader({"a": MRPT.encode()}, "a", _log("a", "mrpt-landmarks")),
        "victoria-park": Reader(park, "trees.csv", _log("", "victoria-park")),
        "dlr-circles": Reader({"a": CIRCLES.encode()}, "a", _log("a", "dlr-circles")),
        "slsjf-sim": Reader(beacons, "sensor_data.mat", _log("", "slsjf-sim")),
        "scans-npz": Reader({"a": scans()}, "a", _scan_log("a", "scans-npz")),
        "mrpt-laser2d": Reader({"a": LASER.encode()}, "a", _scan_log("a", "mrpt-laser2d")),
        "relations": Reader({"a": RELATIONS.encode()}, "a", lambda f: read_relations(f / "a")),
        "config": Reader({"a": CONFIG.encode()}, "a", lambda f: read_config(f / "a")),
        "sweep": Reader({"a": SWEEP.encode()}, "a", lambda f: read_toml(f / "a", cells_of)),
        "state": Reader(mapped, "mapper.npz", lambda f: Mapper.load(f / "mapper.npz")),
    }
    for name, content in {"corrected": CORRECTED, "graph": GRAPH}.items():
        read = _scan_log("a", "carmen-log")
        found[f"carmen-log-{name}"] = Reader({"a": content.encode()}, "a", read)
    for name in clouds:
        found[f"point-clouds-{name}"] = Reader(clouds, name, _scan_log("", "point-clouds"))
    found |= _paths() | _in_space()
    found["slsjf-sim-store_robotOdo.mat"] = Reader(beacons, "store_robotOdo.mat", _log(""))
    for name in ("VictoriaParkSinSincronizar.mat", "data_sensor_clean_clean.mat", "aa3_dr.mat"):
        found[f"victoria-park-{name}"] = Reader(park, name, _log("", "victoria-park"))
    found["own-table"] = Reader(own, "a", lambda f: open_log(f / "a", columns=columns))
    found |= _of_other_programs()
    for name in robots:
        read = read_truth if "Ground" in name else _log("", "mrclam")
        found[f"mrclam-{name}"] = Reader(robots, name, read)
    for name in ("store_beaconsTrue.mat", "store_robotTrue.mat"):
        found[f"slsjf-sim-{name}"] = Reader(beacons, name, read_truth)
    return found | _results(mapped)
