"""Hostile files for every reader: valid ones, damaged at random, and what was made to do harm.

    python -m tests.fuzz [--inputs N] [--seconds S] [--seed SEED] [READER ...]

Each reader is given N inputs, or as many as S seconds of one core allow.  Only a RelmapError of one
line may come back.  The program ends with 1 where anything else did, where an input took more than
its share of time, where memory ran out, or where something that a file holds was executed.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import logging
import lzma
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from types import FrameType

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from relmap.cli.evaluate import evaluate_folder
from relmap.cli.map import map_input, read_config
from relmap.core.errors import RelmapError
from relmap.datasets import open_log, open_scans, read_relations
from relmap.evaluation.plane_evaluate import evaluate_planes, read_wall_truth
from relmap.evaluation.truth import read_truth
from relmap.planefiles import read_planes
from relmap.results import read_result
from tests.logs import PLAIN, TREES
from tests.scanlogs import CLOUD, CORRECTED, GRAPH, LASER, pcd, ply

GIB = 1 << 30
MEMORY = 2 * GIB
SECONDS = 60.0
"""Processor time after which an input counts as one that hangs; the machine may be busy."""
MESSAGE = 2000
"""No message is longer."""

Files = dict[str, bytes]
Mutation = Callable[[bytes, np.random.Generator], bytes]


@dataclass(frozen=True)
class Reader:
    """A reader, valid files for it, and which of them is damaged.

    ``read`` takes the folder that holds the files.
    """

    files: Files
    damaged: str
    read: Callable[[Path], object]


class Canary:
    """Makes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


def packed(content: bytes) -> bytes:
    return gzip.compress(content, 1, mtime=0)


def npz(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def mat(compress: bool = True, **arrays: NDArray[np.float64]) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        savemat(Path(name) / "a.mat", arrays, do_compression=compress)
        return (Path(name) / "a.mat").read_bytes()


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
RELATIONS = "# a\n1.5 2.5 1 2 0 0 0 0.5\n2.5 3.5 0.1 0 0 0 0 -1e-3\n"
POSES = "1,0,0,1\n0,1,0,2\n0,0,1,3\n0,0,0,4.5\n"
CONFIG = 'group_after = 12\nmax_missed = 4\nregistration = "nearest-previous"\ngate_m = 0.5\n'
WALLS = (
    "plane,x0,y0,x1,y1,z0,z1,nx,ny,nz,end0,end1,observations,first_iteration,last_iteration,"
    "status,corner0,corner1\n0,0,0,4,0,0,2,0,1,0,corner,open,12,0,11,static,0,-1\n"
    "1,4,0,4,3,0,2,-1,0,0,corner,corner,12,0,11,static,1,2\n"
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
    summary = json.loads(files["summary.json"]) | {"input": "gone", "refinement": None}
    truth = ["landmark,x,y,z,status"]
    truth += [f"{i},{x},{y},{z},static" for i, (x, y, z) in enumerate(world.tolist())]
    del files["map.png"]
    return files | {
        "summary.json": json.dumps(summary).encode(),
        "planes.csv": WALLS.encode(),
        "truth/landmarks.csv": "\n".join(truth).encode(),
        "truth/planes.csv": WALLS.encode(),
        "truth/trajectory.tum": TUM.encode(),
    }


def _evaluate(folder: Path) -> None:
    (folder / "summary.json").write_text(
        (folder / "summary.json").read_text("utf-8", "ignore").replace('"gone"', f'"{folder}"')
    )
    evaluate_folder(folder, folder / "truth")


def _evaluate_walls(folder: Path) -> None:
    evaluate_planes(read_result(folder), read_planes(folder), read_wall_truth(folder / "truth"))


def _log(name: str, form: str | None = None) -> Callable[[Path], object]:
    return lambda folder: open_log(folder / name, form)


def _scan_log(name: str, form: str | None = None) -> Callable[[Path], object]:
    def read(folder: Path) -> None:
        for _ in zip(range(20), open_scans(folder / name, form).scans(), strict=False):
            pass

    return read


def readers() -> dict[str, Reader]:
    """Return every reader by the name of what it reads."""
    mapped = _mapped()
    trees = np.column_stack([[300, 300, 700], [10, 5, 5], [np.pi / 2, 0, np.pi], *np.ones((3, 3))])
    park = {
        "trees.csv": TREES.encode(),
        "VictoriaParkSinSincronizar.mat": mat(TLsr=np.array([[0.1, 0.3, 0.5, 0.7]])),
        "data_sensor_clean_clean.mat": mat(data_sensor_clean_clean=trees),
    }
    beacons = {
        "sensor_data.mat": mat(sensor_data=OBSERVED),
        "store_beaconsTrue.mat": mat(store_beaconsTrue=np.array([[4, 1, 2], [7, 3, 4.0]])),
        "store_robotTrue.mat": mat(False, store_robotTrue=np.eye(3)),
    }
    clouds = {
        "0.pcd": pcd(CLOUD),
        "1.ply": ply(CLOUD[:2]),
        "2.pcd.xz": lzma.compress(pcd(CLOUD)),
        "alidarPose.csv": (POSES * 3).encode(),
    }
    found = {
        "observation-csv": Reader({"a": PLAIN.encode()}, "a", _log("a", "observation-csv")),
        "observation-csv-gz": Reader({"a": packed(PLAIN.encode())}, "a", _log("a")),
        "mrpt-landmarks": Reader({"a": MRPT.encode()}, "a", _log("a", "mrpt-landmarks")),
        "victoria-park": Reader(park, "trees.csv", _log("", "victoria-park")),
        "dlr-circles": Reader({"a": CIRCLES.encode()}, "a", _log("a", "dlr-circles")),
        "slsjf-sim": Reader(beacons, "sensor_data.mat", _log("", "slsjf-sim")),
        "scans-npz": Reader({"a": scans()}, "a", _scan_log("a", "scans-npz")),
        "mrpt-laser2d": Reader({"a": LASER.encode()}, "a", _scan_log("a", "mrpt-laser2d")),
        "relations": Reader({"a": RELATIONS.encode()}, "a", lambda f: read_relations(f / "a")),
        "config": Reader({"a": CONFIG.encode()}, "a", lambda f: read_config(f / "a")),
    }
    for name, content in {"corrected": CORRECTED, "graph": GRAPH}.items():
        read = _scan_log("a", "carmen-log")
        found[f"carmen-log-{name}"] = Reader({"a": content.encode()}, "a", read)
    for name in clouds:
        found[f"point-clouds-{name}"] = Reader(clouds, name, _scan_log("", "point-clouds"))
    for name in ("VictoriaParkSinSincronizar.mat", "data_sensor_clean_clean.mat"):
        found[f"victoria-park-{name}"] = Reader(park, name, _log("", "victoria-park"))
    for name in ("store_beaconsTrue.mat", "store_robotTrue.mat"):
        found[f"slsjf-sim-{name}"] = Reader(beacons, name, read_truth)
    for name in ("landmarks.csv", "tracks.csv.gz", "trajectory.tum", "summary.json"):
        found[f"result-{name}"] = Reader(mapped, name, _evaluate)
    for name in ("truth/landmarks.csv", "truth/trajectory.tum"):
        found[name] = Reader(mapped, name, _evaluate)
    for name in ("planes.csv", "truth/planes.csv"):
        found[f"walls-{name}"] = Reader(mapped, name, _evaluate_walls)
    return found


WORDS = [
    *(b"nan", b"inf", b"-inf", b"1e999", b"-1e308", b"1e9", b"0", b"-0.0", b"-1", b"", b" "),
    *(b"9223372036854775807", b"18446744073709551616", b"4294967295", b"3000000000", b"1e-320"),
    *(b"9" * 5000, b"0x10", b"1_000", b"1,5", b"None", b"true", b"\xff\xfe", b"\x00", b"\xc3\xa9"),
    *(b"[" * 100_000, b'{"a":' * 50_000, b"\n" * 1000, b"a" * 70_000, b"../../etc/passwd"),
    *("٣".encode(), "\uff11".encode(), b"static", b"corner", b"{}", b"[]", b"null", b"\r", b'"'),
]
HEADS = [
    *(
        b"PK\x03\x04",
        b"\x1f\x8b\x08",
        b"\xfd7zXZ\x00",
        b"\x93NUMPY\x01\x00",
        b"MATLAB 5.0 MAT-file",
    ),
    *(b"ply\nformat ascii 1.0\n", b"# .PCD v0.7\nVERSION 0.7\n", b"FLASER 2 1 ", b"STEP 1 2 "),
    *(b"iteration,x,y\n", b"\xef\xbb\xbf", b"\xff\xfe", b"%PDF-1.7\n", b"\x7fELF", b"{", b"scan,"),
]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for at in rng.integers(0, max(len(data), 1), rng.integers(1, 8)).tolist():
        if data:
            changed[at] = int(rng.integers(256))
    return bytes(changed)


def _without(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    return data[:begin] + data[end:]


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Double, swap, leave out or shuffle lines."""
    lines = data.split(b"\n")
    order = np.arange(len(lines))
    a, b = rng.integers(len(lines), size=2)
    kind = rng.integers(4)
    if kind == 0:
        order = np.insert(order, a, order[b])
    elif kind == 1:
        order[[a, b]] = order[[b, a]]
    elif kind == 2:
        order = np.delete(order, a)
    else:
        order = rng.permutation(order)
    return b"\n".join(lines[k] for k in order)


def _word(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace what stands between two separators, or one byte, by a word of harm."""
    word = WORDS[rng.integers(len(WORDS))]
    separators = [k for k, byte in enumerate(data) if byte in b" ,\n;=:[]"]
    if not separators:
        at = int(rng.integers(len(data) + 1))
        return data[:at] + word + data[at + 1 :]
    k = int(rng.integers(len(separators)))
    end = separators[k + 1] if k + 1 < len(separators) else len(data)
    return data[: separators[k] + 1] + word + data[end:]


def _headed(data: bytes, rng: np.random.Generator) -> bytes:
    return HEADS[rng.integers(len(HEADS))] + (data if rng.integers(2) else _cut(data, rng))


def _number(data: bytes, rng: np.random.Generator) -> bytes:
    """Put a number of 2, 4 or 8 bytes, small, large or negative, somewhere."""
    width = int(rng.choice([2, 4, 8]))
    value = int(rng.choice([0, 1, -1, 2**31 - 1, -(2**31), 2**15, 2**40, 2**63 - 1]))
    at = int(rng.integers(len(data) + 1))
    return data[:at] + (value % 2 ** (8 * width)).to_bytes(width, "little") + data[at + width :]


MUTATIONS: tuple[Mutation, ...] = (_cut, _flipped, _without, _lines, _word, _word, _headed, _number)


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return data damaged in one to three ways; half of what is gzipped is damaged inside."""
    if data[:2] == b"\x1f\x8b" and rng.integers(2):
        return packed(mutated(gzip.decompress(data), rng))
    if data[:4] == b"PK\x03\x04" and rng.integers(2):
        return _mutated_zip(data, rng)
    if data[:6] == b"\xfd7zXZ\x00" and rng.integers(2):
        return lzma.compress(mutated(lzma.decompress(data), rng), preset=0)
    for _ in range(rng.integers(1, 4)):
        data = MUTATIONS[rng.integers(len(MUTATIONS))](data, rng)
    return data


def _mutated_zip(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a zip file that is whole, with a member damaged, renamed or left out."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(stream, "w") as new:
        names = old.namelist()
        chosen = names[rng.integers(len(names))]
        for name in names:
            content = old.read(name)
            if name == chosen:
                content = mutated(content, rng)
                name = [name, f"../{name}", f"/{name}", "x"][rng.integers(4)]
            new.writestr(name, content)
    return stream.getvalue()


def npz_made_to_harm(canary: Path) -> Files:
    """Return scans.npz that hold code to execute, or less than they say."""
    large = io.BytesIO()
    with zipfile.ZipFile(large, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("points", "iteration", "stamps_s"):
            header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3000000000, 3), }"
            archive.writestr(
                f"{name}.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
            )
    return {
        "objects": scans(points=np.array([Canary(canary)], dtype=object)),
        "pickle": pickle.dumps(Canary(canary)),
        "billions": large.getvalue(),
    }


def made_to_harm(canary: Path) -> dict[str, Files]:
    """Return files that no chance finds, by reader and kind."""
    deep = b"a = " + b"[" * 100_000
    cloud = pcd(CLOUD, declared=3_000_000_000)
    return {
        "scans-npz": npz_made_to_harm(canary) | {"zeros": _deflated_scans(8 * GIB)},
        "point-clouds-0.pcd": {"billions": cloud, "text": cloud.replace(b"binary", b"ascii")},
        "point-clouds-1.ply": {"billions": ply(CLOUD, declared=3_000_000_000)},
        "point-clouds-2.pcd.xz": {"zeros": lzma.compress(pcd(CLOUD) + bytes(GIB // 2), preset=0)},
        "config": {"deep": deep, "long": b"group_after = " + b"9" * 5000},
        "result-summary.json": {
            "deep": b'{"scans": ' + b"[" * 100_000,
            "format": b'{"association": "known", "scans": [0, 14], "input": "gone", "format": [1]}',
        },
        "slsjf-sim": {"zeros": _zeros_mat("sensor_data", GIB // 2)},
        "observation-csv": {
            "zeros": packed_zeros(2 * GIB),
            "rows": packed_rows(b"iteration,x,y\n", b"0,0,0\n", GIB),
        },
        "dlr-circles": {"rows": packed_rows(CIRCLES.encode(), b"LANDMARK_C 1 2 0 1 0 1 5\n", GIB)},
        "relations": {"rows": packed_rows(b"", b"1 2 0 0 0 0 0 0\n", GIB)},
        "carmen-log-corrected": {
            "rows": packed_rows(b"", b"FLASER 9 1 1 1 1 1 1 1 1 1 0 0 0 0 0 0 1 h 1\n", GIB)
        },
        "mrpt-laser2d": {"rows": packed_rows(LASER.encode(), b"12,1,2,0,0,0,0,1,2,3\n", GIB)},
        "result-tracks.csv.gz": {"rows": packed_rows(b"iteration,row,landmark\n", b"0,0,0\n", GIB)},
        "result-trajectory.tum": {"rows": packed_rows(b"", b"0 0 0 0 0 0 0 1\n", GIB)},
        "truth/landmarks.csv": {
            "rows": packed_rows(b"landmark,x,y,z,status\n", b"0,0,0,0,\n", GIB)
        },
    }


def nearly_too_large() -> dict[str, Files]:
    """Return files just within the limits, which are read or refused for what they hold."""
    scan = b"FLASER 60 " + b"1 " * 60 + b"0 0 0 0 0 0 1 h 1\n"
    cloud = b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS 8000000\nDATA ascii\n"
    n = 12_000_000
    points = np.ones((n, 3)), np.zeros(n, dtype=np.int64), np.zeros(1)
    return {
        "observation-csv": {
            "most": packed_rows(b"iteration,x,y\n", b"0,0,0\n", 6 * 9_900_000),
            "numbers": packed_rows(b"iteration,x,y,z,id\n", b"0,0,0,0,-1\n", 11 * 6_600_000),
        },
        "dlr-circles": {
            "most": packed_rows(CIRCLES.encode(), b"LANDMARK_C 1 2 0 1 0 1 5\n", 25 * 4_100_000)
        },
        "relations": {"most": packed_rows(b"", b"1 2 0 0 0 0 0 0\n", 16 * 2_000_000)},
        "carmen-log-corrected": {"most": packed_rows(b"", scan, len(scan) * 262_000)},
        "mrpt-laser2d": {
            "most": packed_rows(LASER.encode(), b"12,1,2,0,0,0,0,1,2,3\n", 21 * 3_300_000)
        },
        "result-tracks.csv.gz": {
            "most": packed_rows(b"iteration,row,landmark\n", b"0,0,0\n", 6 * 9_900_000)
        },
        "result-trajectory.tum": {"most": packed_rows(b"", b"0 0 0 0 0 0 0 1\n", 16 * 2_000_000)},
        "result-summary.json": {"most": packed_rows(b"[1", b",[]", 60_000_000)},
        "truth/landmarks.csv": {
            "most": packed_rows(b"landmark,x,y,z,status\n", b"0,0,0,0,static\n", 15 * 9_900_000)
        },
        "point-clouds-0.pcd": {"most": cloud + b"1 2 3\n" * 8_000_000},
        "scans-npz": {"most": npz(points=points[0], iteration=points[1], stamps_s=points[2])},
        "slsjf-sim": {"most": _zeros_mat("sensor_data", 8 << 24)},
    }


def packed_zeros(size: int) -> bytes:
    return packed_rows(b"", bytes(1 << 16), size)


def packed_rows(head: bytes, row: bytes, size: int) -> bytes:
    """Return so many bytes of one row again and again, gzipped."""
    many = row * ((1 << 20) // len(row))
    stream = io.BytesIO()
    with gzip.GzipFile(fileobj=stream, mode="wb", compresslevel=1, mtime=0) as file:
        file.write(head)
        for _ in range(size // len(many)):
            file.write(many)
    return stream.getvalue()


def _deflated_scans(size: int) -> bytes:
    """Return scans whose points are zeros of so many bytes."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({size // 24}, 3), }}".encode()
    stream = io.BytesIO(scans())
    result = io.BytesIO()
    with (
        zipfile.ZipFile(stream) as old,
        zipfile.ZipFile(result, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as new,
    ):
        for name in old.namelist():
            if name != "points.npy":
                new.writestr(name, old.read(name))
        with new.open("points.npy", "w", force_zip64=True) as member:
            member.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
            for _ in range(size // GIB):
                for _ in range(64):
                    member.write(bytes(GIB // 64))
    return result.getvalue()


def _zeros_mat(name: str, size: int) -> bytes:
    zeros: dict[str, NDArray[np.float64]] = {name: np.zeros((size // 56, 7))}
    return mat(True, **zeros)


class Hang(BaseException):
    """An input took too long; no reader may catch it."""


def _hang(signal_number: int, frame: FrameType | None) -> None:
    raise Hang


def put(folder: Path, files: Files) -> None:
    """Write files into an empty folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)


def problem_with(reader: Reader, folder: Path) -> str | None:
    """Read what stands in the folder; say what went wrong, if anything."""
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        reader.read(folder)
    except RelmapError as error:
        text = str(error)
        if len(text.splitlines()) != 1 or len(text) > MESSAGE:
            return f"message of {len(text.splitlines())} lines and {len(text)} characters"
    except Hang:
        return f"more than {SECONDS:g} s"
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not get out
        return f"{type(error).__name__}: {error}"[:300]
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return None


def resident_at_most() -> int:
    """Return the most memory that this process has had since `forget_resident`, bytes."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.partition("VmHWM:")[2].split()[0])


def forget_resident() -> None:
    Path("/proc/self/clear_refs").write_text("5")


def fuzz(
    reader: Reader, folder: Path, inputs: int, seconds: float, seed: int
) -> tuple[int, dict[str, bytes]]:
    """Read damaged files; return how many, and of each different problem the first input."""
    put(folder, reader.files)
    rng = np.random.default_rng(seed)
    problems: dict[str, bytes] = {}
    end, n = process_time() + seconds, 0
    while n < inputs and process_time() < end:
        data = mutated(reader.files[reader.damaged], rng)
        (folder / reader.damaged).write_bytes(data)
        if reader.damaged != "summary.json" and reader.read is _evaluate:
            (folder / "summary.json").write_bytes(reader.files["summary.json"])
        found = problem_with(reader, folder)
        if found is not None:
            problems.setdefault(found, data)
        n += 1
    return n, problems


def main() -> int:
    parser = argparse.ArgumentParser(description="Give every reader hostile files.")
    parser.add_argument("--inputs", type=int, default=200_000)
    parser.add_argument("--seconds", type=float, default=3600.0, help="of one core, per reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for the inputs that made trouble")
    parser.add_argument("--harm", action="store_true", help="only what is made to do harm")
    parser.add_argument("--large", action="store_true", help="only what is nearly too large")
    parser.add_argument("readers", nargs="*", metavar="READER")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable()
    known = readers()
    signal.signal(signal.SIGVTALRM, _hang)
    with tempfile.TemporaryDirectory(prefix="relmap-fuzz-") as name:
        canary = Path(name) / "canary"
        harm = made_to_harm(canary) if arguments.harm else None
        harm = nearly_too_large() if arguments.large else harm
        _limit_memory()
        chosen = arguments.readers or list(harm or known)
        return int(sum(_tried(n, known[n], canary, harm, arguments) for n in chosen) > 0)


def _limit_memory() -> None:
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, now + MEMORY))


def _tried(
    name: str,
    reader: Reader,
    canary: Path,
    harm: dict[str, Files] | None,
    arguments: argparse.Namespace,
) -> int:
    """Try a reader, and tell what came out; return the number of problems."""
    folder = canary.parent / name.replace("/", "-")
    folder.mkdir()
    forget_resident()
    began = process_time()
    if harm is not None:
        n, problems = _harmed(reader, folder, harm[name])
    else:
        limits = arguments.inputs, arguments.seconds, arguments.seed
        n, problems = fuzz(reader, folder, *limits)
    if canary.exists():
        problems["something was executed"] = b""
    took, most = process_time() - began, resident_at_most() / 2**20
    print(f"{name}: {n} inputs, {took:.0f} s, at most {most:.0f} MiB, {len(problems)} problems")
    for k, (problem, data) in enumerate(problems.items()):
        print(f"  {problem}", flush=True)
        if arguments.keep:
            arguments.keep.mkdir(exist_ok=True)
            (arguments.keep / f"{folder.name}-{k}").write_bytes(data)
    sys.stdout.flush()
    shutil.rmtree(folder)
    return len(problems)


def _harmed(reader: Reader, folder: Path, inputs: Files) -> tuple[int, dict[str, bytes]]:
    put(folder, reader.files)
    problems = {}
    for kind, data in inputs.items():
        (folder / reader.damaged).write_bytes(data)
        began = process_time()
        forget_resident()
        found = problem_with(reader, folder)
        took, most = process_time() - began, resident_at_most() / 2**20
        print(f"  {kind}: {took:.1f} s, at most {most:.0f} MiB", flush=True)
        if found is not None:
            problems[f"{kind}: {found}"] = data
    return len(inputs), problems


if __name__ == "__main__":
    sys.exit(main())
