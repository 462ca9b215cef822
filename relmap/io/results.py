"""The result folder of a run, written and read."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.landmarks import LandmarkTable, Submap
from relmap.core.shown import Brief
from relmap.datasets.textfile import invalid
from relmap.io.files import atomic_write, read_text, read_tum, write_tum
from relmap.io.tables import Kind, columns_text, compressed, csv_text, read_columns

T = TypeVar("T", bound=Any)

LANDMARKS = "landmarks.csv"
TRACKS = "tracks.csv.gz"
TRAJECTORY = "trajectory.tum"
SUBMAPS = "submaps.csv"
MAP_PLY = "map.ply"
MAP_PNG = "map.png"
SUMMARY = "summary.json"
MAPPER = "mapper.npz"
EVALUATION = "evaluation.json"
NAMES = "names.csv"
PLANES = "planes.csv"
REPORT = "report.html"
BENCH_PNG = "bench.png"
BENCH_GIF = "bench.gif"
SECOND = "trajectory-2.tum"
OF_SUBMAPS = "submap-*.tum", "submap-*.csv"

OPTIONAL = ("submap", "moving_bin")
"""Columns that may be missing in results of other programs and earlier versions."""
LANDMARK_COLUMNS: dict[str, Kind] = {
    "landmark": "int",
    **dict.fromkeys(("x", "y", "z", "sd"), "float or empty"),
    **dict.fromkeys(("observations", "first_iteration", "last_iteration", "level"), "int"),
    "status": "text",
    **dict.fromkeys(OPTIONAL, "int"),
}
SUBMAP_COLUMNS = ("submap", "landmark", "x", "y", "z")
LEAST_SCANS = 10
"""Minimum scans of a submap with a separate file; smaller ones are only listed."""
REJECTED = "rejected_id"
NONE: Ints = np.empty(0, dtype=np.int64)
TRACK_COLUMNS: dict[str, Kind] = dict.fromkeys(("iteration", "row", "landmark", REJECTED), "int")


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Brief):
    """The landmark of each labelled observation of the log.

    Attributes
    ----------
    iteration : (n,) int64
        Iteration numbers of the log.
    row : (n,) int64
        0-based rows of the log.
    landmark : (n,) int64
    rejected_id : (n,) int64, optional
        The given id that was overruled, or -1; only present if there is any.
    """

    iteration: Ints
    row: Ints
    landmark: Ints
    rejected_id: Ints | None = None


class SubmapPath(NamedTuple):
    """The path in a submap.

    `iterations` (k,): iteration numbers of the log; `stamps_s` (k,): times, or iteration numbers if
    the log has no clock; `poses` (k, 4, 4): ``T_submap_robot``.
    """

    iterations: Ints
    stamps_s: Floats
    poses: Floats

    @property
    def length_m(self) -> float:
        """Length of the steps between consecutive iterations, metres."""
        steps_m = np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1)
        return float(steps_m[np.diff(self.iterations) == 1].sum())


@dataclass(frozen=True, eq=False, repr=False)
class Result(Brief):
    """A finished run, as stored in the result folder.

    Attributes
    ----------
    landmarks : LandmarkTable
        Every landmark ever seen, with the iteration numbers of the log.
    tracks : Tracks
    stamps_s : (p,) float64
        Seconds, or iteration numbers if the log has no clock.
    poses : (p, 4, 4) float64
        T_map_robot of the iterations with a pose.
    summary : dict
        Configuration, versions, counts and timing, JSON serialisable.
    submaps : tuple of Submap
        The submaps, the map itself first; empty for a result read from files.
    iterations : (p,) int64 or None
        Iteration number of each pose; None for a result read from files.
    paths : tuple of SubmapPath
        Of each submap of points or of planes in space; empty for a result read from files.
    """

    landmarks: LandmarkTable
    tracks: Tracks
    stamps_s: Floats
    poses: Floats
    summary: dict[str, Any]
    submaps: tuple[Submap, ...] = ()
    iterations: Ints | None = None
    paths: tuple[SubmapPath, ...] = ()

    @property
    def planar(self) -> bool:
        """Whether the world is planar (3-DoF)."""
        return self.summary.get("dimensions") == 2

    @property
    def mapped(self) -> Bools:
        """Which landmarks are mapped, (n,)."""
        return np.asarray(np.isfinite(self.landmarks.position).all(axis=1))


def write_names(folder: Path, names: Mapping[int, str]) -> None:
    """Write the name in the log of each landmark as ``landmark,name``."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["landmark", "name"])
    rows.writerows(names.items())
    atomic_write(folder / NAMES, text.getvalue())


def read_names(folder: Path) -> dict[int, str] | None:
    """Return what `write_names` wrote, None without a file; RelmapError if it is damaged."""
    path = folder / NAMES
    if not os.path.isfile(path):
        return None
    table = read_columns(path, {"landmark": "int", "name": "name"})
    names = dict(zip(table["landmark"].tolist(), table["name"].tolist(), strict=True))
    if len(names) < len(table["landmark"]):
        raise invalid(path, "a landmark occurs twice")
    return names


def write_result(folder: Path, result: Result) -> None:
    """Write the files of a result, except the picture, into an existing folder.

    See `relmap.io.files.staged_folder` for all or nothing.
    """
    table, tracks = result.landmarks, vars(result.tracks)
    atomic_write(folder / LANDMARKS, columns_text(table.columns()))
    labels = {name: tracks[name] for name in TRACK_COLUMNS if tracks[name] is not None}
    atomic_write(folder / TRACKS, compressed(columns_text(labels)))
    # Landmarks not connected to the map, each in the frame of its submap.
    rows = [
        (number, label, *position.tolist())
        for number, submap in enumerate(result.submaps[1:], start=1)
        for label, position in zip(submap.landmark_ids, submap.positions, strict=True)
    ]
    atomic_write(folder / SUBMAPS, csv_text(SUBMAP_COLUMNS, rows))
    write_tum(folder / TRAJECTORY, result.stamps_s, result.poses)
    for number, path in enumerate(result.paths[1:], start=1):
        if len(path.poses) >= LEAST_SCANS:
            write_tum(folder / f"submap-{number}.tum", path.stamps_s, path.poses)
    atomic_write(folder / MAP_PLY, ply_text(table.position[result.mapped]))
    atomic_write(folder / SUMMARY, json_text(result.summary))


def stale_files(folder: Path) -> list[str]:
    """Return the files of an earlier result of any kind that a new one may not replace."""
    own = [EVALUATION, NAMES, PLANES, REPORT, BENCH_PNG, BENCH_GIF, SECOND]
    try:
        return own + sorted(path.name for kind in OF_SUBMAPS for path in folder.glob(kind))
    except OSError:  # a folder cannot have this name: the error is reported on writing
        return own


def ply_text(
    vertices: Floats, edges: Ints = NONE, faces: Ints = NONE, comment: str = "map frame, metres"
) -> str:
    """Return an ASCII PLY file in full precision.

    `vertices` (n, 3), metres; `edges` (e, 2) and `faces` (f, 4): vertices of each.
    """
    header = ["ply", "format ascii 1.0", f"comment {comment}"]
    header += [f"element vertex {len(vertices)}", *(f"property double {axis}" for axis in "xyz")]
    if len(edges):
        header += [f"element edge {len(edges)}", "property int vertex1", "property int vertex2"]
    if len(faces):
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    counted = [[4, *face] for face in faces.tolist()]
    rows = (map(repr, row) for part in (vertices.tolist(), edges.tolist(), counted) for row in part)
    return "\n".join([*header, "end_header", *map(" ".join, rows)]) + "\n"


def json_text(content: dict[str, Any]) -> str:
    """Return the content as indented JSON, with NaN as null."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def read_result(folder: Path) -> Result:
    """Read a result folder.

    The result is without submaps, and without the iterations of its poses. Raises `RelmapError` if
    a file is missing or was not written by `write_result`.
    """
    if not os.path.isfile(folder / SUMMARY):
        raise RelmapError(f"{folder} is not a result folder: no {SUMMARY} in it")
    table = read_columns(folder / LANDMARKS, LANDMARK_COLUMNS, OPTIONAL)
    table.setdefault("submap", np.where(np.isfinite(table["x"]), 0, -1))
    table.setdefault("moving_bin", np.full(len(table["x"]), -1))
    position = np.column_stack([table.pop("x"), table.pop("y"), table.pop("z")])
    tracks = Tracks(**read_columns(folder / TRACKS, TRACK_COLUMNS, (REJECTED,)))
    stamps_s, poses = read_tum(folder / TRAJECTORY)
    landmarks = LandmarkTable(position=position, **table)
    return Result(landmarks, tracks, stamps_s, poses, _read_summary(folder / SUMMARY))


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise RelmapError(f"{path}: not JSON: {error}") from error
    if not isinstance(summary, dict):
        raise RelmapError(f"{path}: not a JSON object")
    return summary


def shifted(table: T, iterations: int) -> T:
    """Return a table of landmarks or walls with `iterations` added to its iteration numbers."""
    numbers = ("first_iteration", "last_iteration")
    return replace(table, **{name: getattr(table, name) + iterations for name in numbers})
