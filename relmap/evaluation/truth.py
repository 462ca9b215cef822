"""The truth for an evaluation, from any of its formats."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.shown import Brief
from relmap.datasets import Relations, open_scans, read_relations
from relmap.datasets.textfile import invalid, open_text, quoted, require_path
from relmap.datasets.trajectories import is_trajectory, read_trajectory
from relmap.evaluation.metrics import match_stamps
from relmap.evaluation.space import Faces
from relmap.io.files import atomic_write, read_tum, write_tum
from relmap.io.results import SUMMARY, Result
from relmap.io.tables import Kind, columns_text, read_columns

Variant = Literal["points", "planes"]
Judged = Literal["points", "planes", "planes3d"]

TABLES: dict[Variant, str] = {"points": "landmarks.csv", "planes": "planes.csv"}
"""Files of the true landmarks."""
TRAJECTORY, FACES, RELATIONS = "trajectory.tum", "faces.csv", ".relations"
CLOCKS = ("ROBOTLASER1", -3, -1)
"""Lines of a CARMEN log with both clocks, the robot's and the logger's, and their positions."""
_EXPECTED = (
    f"truth/{TABLES['points']} or {TABLES['points']} in it, MRPT's ..._ground_truth.txt, "
    "or the folder of a known data set"
)
_COLUMNS: dict[str, Kind] = {"landmark": "int", **dict.fromkeys("xyz", "float"), "status": "text"}
_ENDS, _SEEN = ("x0", "y0", "x1", "y1"), ("seen0", "seen1")
_NOWHERE = np.empty((0, 2))


@dataclass(frozen=True, eq=False, repr=False)
class Truth(Brief):
    """The true landmarks or walls, and the true path; unknown parts are empty.

    Attributes
    ----------
    landmark_ids : (m,) int64
    landmarks_map : (m, 3) float64, map frame of the truth, metres
        NaN if only the identity of a landmark is known, not its position.
    status : (m,) str
        "static" or "dynamic".
    stamps_s : (k,) float64
        Seconds, or iteration numbers without a clock.
    poses : (k, 4, 4) float64
        T_map_robot.
    ends : (w, 2, 2) float64, map frame of the truth, metres
        Ends of static walls, right to left as seen from the front.
    corner_scans : (w, 2) int64
        Number of scans that saw each true end.
    seen_m : (w, 2) float64
        Observed extent of each wall, metres from its first end; NaN if it was not seen. (0, 2) if
        unknown.
    relations : tuple of Relations
        Checked relations between poses, by several clocks; see `relation_errors`.
    faces : Faces or None
        Of planes in space.
    """

    landmark_ids: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    landmarks_map: Floats = field(default_factory=lambda: np.empty((0, 3)))
    status: NDArray[np.str_] = field(default_factory=lambda: np.empty(0, np.str_))
    stamps_s: Floats = field(default_factory=lambda: np.empty(0))
    poses: Floats = field(default_factory=lambda: np.empty((0, 4, 4)))
    ends: Floats = field(default_factory=lambda: np.empty((0, 2, 2)))
    corner_scans: Ints = field(default_factory=lambda: np.empty((0, 2), np.int64))
    seen_m: Floats = field(default_factory=lambda: np.empty((0, 2)))
    relations: tuple[Relations, ...] = ()
    faces: Faces | None = None

    def poses_of(self, result: Result) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Return poses (k, 4, 4) of a result, the true ones of these instants, and their rows."""
        mine, other = match_stamps(result.stamps_s, self.stamps_s)
        return result.poses[mine], self.poses[other], other


def read_truth(path: Path, judged: Judged = "points") -> Truth:
    """Read the truth, or a reference instead, for what is judged.

    `path`: a folder written by `relmap simulate`, with ``truth/landmarks.csv`` or ``landmarks.csv``
    (for walls ``planes.csv``), or that file, and ``trajectory.tum`` beside it if the path is known.
    Or a trajectory in TUM or KITTI format (`relmap.datasets.trajectories`). For points also

    * MRPT's ``..._ground_truth.txt`` or its folder;
    * the folder of I-SLSJF's simulation, or of MRCLAM;
    * the folder of Victoria Park, whose trees were not surveyed: the published estimates of another
      program are a reference to compare with, not a truth;
    * the folder of DLR's circles, which has ids but no positions.

    For walls also

    * a log of point scans, for the poses that it gives: a reference, or exact if simulated;
    * a ``.relations`` file, of pairs of poses that were checked by hand. Its times are the robot's;
      a CARMEN log of the same name beside it adds the logger's times.

    For planes in space: a folder of ``relmap simulate storey``, with ``truth/faces.csv``, a
    trajectory, or a log of scans with poses.

    Raises `RelmapError` if it is none of these or is damaged.
    """
    require_path(path)
    if judged == "planes3d":
        return _read_space(path)
    name = TABLES[judged]
    path = path.parent if path.name == name and path.is_file() else path
    folder = path / "truth"
    if not (folder / name).is_file():
        if judged == "planes" and folder.is_dir():
            raise invalid(path, f"contains no truth/{name} with the walls to compare with")
        if (path / SUMMARY).exists():
            raise invalid(path, "is a result folder without truth, expected a truth")
        folder = path
    if (folder / name).is_file():
        truth = (_read_walls if judged == "planes" else _read_landmarks)(folder / name)
        if (folder / TRAJECTORY).exists():
            truth = _with_path(truth, *read_tum(folder / TRAJECTORY))
    elif not path.name.endswith(RELATIONS) and is_trajectory(path):
        truth = _with_path(Truth(), *read_trajectory(path))
    else:
        truth = (_read_path if judged == "planes" else _read_data_set)(path)
    ids, counts = np.unique(truth.landmark_ids, return_counts=True)
    if (counts > 1).any():
        raise invalid(path, f"landmark {ids[counts > 1][0]} occurs twice")
    return truth


def write_truth(folder: Path, truth: Truth) -> None:
    """Write true landmarks and the path into a folder; RelmapError if it cannot be written."""
    columns = (truth.landmark_ids, *truth.landmarks_map.T, truth.status)
    table = dict(zip(_COLUMNS, columns, strict=True))
    atomic_write(folder / TABLES["points"], columns_text(table))
    write_tum(folder / TRAJECTORY, truth.stamps_s, truth.poses)


def _read_space(path: Path) -> Truth:
    """Read the true path, and the true faces if known, of planes in space."""
    for folder in (path / "truth", path):
        if (folder / TRAJECTORY).is_file() and not (folder / SUMMARY).exists():
            faces = _read_faces(folder / FACES) if (folder / FACES).is_file() else None
            return _with_path(Truth(faces=faces), *read_tum(folder / TRAJECTORY))
    return _with_path(Truth(), *read_trajectory(path)) if is_trajectory(path) else _read_path(path)


def _with_path(truth: Truth, stamps_s: Floats, poses: Floats) -> Truth:
    return replace(truth, stamps_s=stamps_s, poses=poses)


def _read_landmarks(path: Path) -> Truth:
    table = read_columns(path, _COLUMNS)
    wrong = ~np.isin(table["status"], ("static", "dynamic"))
    if wrong.any():
        landmark, status = (table[name][wrong][0] for name in ("landmark", "status"))
        problem = f"status of landmark {landmark} is {quoted(status)}"
        raise invalid(path, f"{problem}, neither static nor dynamic")
    position = np.column_stack([table["x"], table["y"], table["z"]])
    return Truth(table["landmark"], position, table["status"])


def _read_walls(path: Path) -> Truth:
    columns: dict[str, Kind] = {**dict.fromkeys(_ENDS, "float"), "corner0": "int", "corner1": "int"}
    columns |= {"status": "text", **dict.fromkeys(_SEEN, "float or empty")}
    table = read_columns(path, columns, optional=("status", *_SEEN))
    ends = np.column_stack([table[name] for name in _ENDS]).reshape(-1, 2, 2)
    scans = np.column_stack([table["corner0"], table["corner1"]])
    still = table.get("status", np.full(len(ends), "static")) != "dynamic"
    extents = [table[name] for name in _SEEN if name in table]
    seen_m = np.column_stack(extents)[still] if len(extents) == 2 else _NOWHERE
    return Truth(ends=ends[still], corner_scans=scans[still], seen_m=seen_m)


def _read_faces(path: Path) -> Faces:
    places = [f"{axis}{corner}" for corner in range(4) for axis in "xyz"]
    columns: dict[str, Kind] = {"plane": "int", **dict.fromkeys((*places, "seen_m2"), "float")}
    table = read_columns(path, columns)
    if len(table["plane"]) and table["plane"].min() < 0:
        raise invalid(path, "a plane has a number below 0")
    corners = np.column_stack([table[name] for name in places]).reshape(-1, 4, 3)
    plane = np.unique(table["plane"], return_inverse=True)[1]  # they may be of any size
    return Faces(plane, corners, table["seen_m2"])


def _read_path(path: Path) -> Truth:
    """Read the reference path for a map of walls."""
    if path.name.endswith(RELATIONS):
        return Truth(relations=relations_by_clocks(path))
    try:
        log = open_scans(path)
    except RelmapError as error:
        expected = f"truth/{TABLES['planes']}, a log of point scans or a {RELATIONS} file"
        raise RelmapError(f"{error}; to compare walls with, expected {expected}") from error
    if log.poses is None:
        raise invalid(path, "the log gives no poses, expected one that does")
    known = np.isfinite(log.poses[:, 0, 0])
    return Truth(stamps_s=log.stamps_s[known], poses=log.poses[known])


def relations_by_clocks(path: Path) -> tuple[Relations, ...]:
    """Read relations by the robot's clock and, if known, the logger's; see `read_relations`."""
    relations = read_relations(path)
    stem = path.name.removesuffix(RELATIONS)
    for name in (f"{stem}.log.gz", f"{stem}.log"):
        if (path.parent / name).is_file():
            kind, robot, logger = CLOCKS
            with open_text(path.parent / name) as stream:
                cells = [line.split() for line in stream if line.startswith(kind)]
            try:
                times = np.array([[float(row[robot]), float(row[logger])] for row in cells])
            except (ValueError, IndexError):
                continue
            if len(times):
                begin_s, end_s = (
                    np.interp(when, *times.T) for when in (relations.begin_s, relations.end_s)
                )
                return relations, Relations(begin_s, end_s, relations.T_begin_end)
    return (relations,)


def _read_data_set(path: Path) -> Truth:
    """Read the true landmarks of a data set."""
    from relmap.datasets import dlr_circles, mrclam, mrpt_landmarks, slsjf, victoria_park

    for kind in (mrpt_landmarks, slsjf):
        if kind.is_ground_truth(path):
            return _static(*kind.read_ground_truth(path))
    if mrclam.is_ground_truth(path):
        ids, positions, stamps_s, poses = mrclam.read_ground_truth(path)
        return replace(_static(ids, positions, poses), stamps_s=stamps_s)
    if victoria_park.is_reference(path):
        return _static(*victoria_park.read_reference_map(path))
    if dlr_circles.DlrCircles().recognises(path):
        ids = dlr_circles.read_ids(path)
        return _static(ids, np.full((len(ids), 3), np.nan))
    what = "holds no truth" if path.is_dir() else "is not a truth"
    raise invalid(path, f"{what}, expected {_EXPECTED}")


def _static(ids: Ints, position: Floats, poses: Floats | None = None) -> Truth:
    """Return a truth without dynamic landmarks, stamped with iteration numbers."""
    poses = np.empty((0, 4, 4)) if poses is None else poses
    return Truth(ids, position, np.full(len(ids), "static"), np.arange(float(len(poses))), poses)
