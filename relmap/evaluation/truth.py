"""The truth that a result is compared with, from any of the forms it comes in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.textfile import quoted, require_path, shown
from relmap.files import atomic_write, read_tum, write_tum
from relmap.results import SUMMARY
from relmap.tables import Kind, csv_text, read_table

LANDMARKS = "landmarks.csv"
TRAJECTORY = "trajectory.tum"
_MRPT = ("_ground_truth.txt", "_ground_truth_robot_path.txt")
_EXPECTED = f"truth/{LANDMARKS} or {LANDMARKS} in it, or MRPT's ...{_MRPT[0]}"
_COLUMNS: dict[str, Kind] = {
    "landmark": "int",
    "x": "float",
    "y": "float",
    "z": "float",
    "status": "text",
}


@dataclass(frozen=True, eq=False)
class Truth:
    """True landmarks and, where it is known, the true path.

    Attributes
    ----------
    landmark_ids : (m,) int64
    landmarks_map : (m, 3) float64, map frame of the truth, metres
    status : (m,) str
        "static" or "dynamic".
    stamps_s : (k,) float64
        Seconds, or iteration numbers where there is no clock; empty where no path is known.
    poses : (k, 4, 4) float64
        T_map_robot.
    """

    landmark_ids: NDArray[np.int64]
    landmarks_map: NDArray[np.float64]
    status: NDArray[np.str_]
    stamps_s: NDArray[np.float64]
    poses: NDArray[np.float64]


def read_truth(path: Path) -> Truth:
    """Read the truth.

    Parameters
    ----------
    path : Path
        A folder that holds ``truth/landmarks.csv`` or ``landmarks.csv`` (with ``trajectory.tum``
        beside it where the path is known), or MRPT's ``..._ground_truth.txt`` or its folder.

    Raises
    ------
    RelmapError
        Where it is none of these or is damaged.
    """
    require_path(path)
    truth = _read_folder(path) if path.is_dir() else _read_mrpt(path)
    ids, counts = np.unique(truth.landmark_ids, return_counts=True)
    if (counts > 1).any():
        raise RelmapError(f"{shown(path)}: landmark {ids[counts > 1][0]} stands there twice")
    return truth


def write_truth(folder: Path, truth: Truth) -> None:
    """Write ``landmarks.csv`` and ``trajectory.tum`` into an existing folder.

    Raises
    ------
    RelmapError
        Where a file cannot be written.
    """
    x, y, z = truth.landmarks_map.T.tolist()
    rows = zip(truth.landmark_ids.tolist(), x, y, z, truth.status.tolist(), strict=True)
    atomic_write(folder / LANDMARKS, csv_text(list(_COLUMNS), rows))
    write_tum(folder / TRAJECTORY, truth.stamps_s, truth.poses)


def _read_folder(path: Path) -> Truth:
    folder = _landmark_folder(path)
    if folder is None:
        return _read_mrpt(path)
    table = read_table(folder / LANDMARKS, _COLUMNS)
    for landmark, status in zip(table["landmark"], table["status"].tolist(), strict=True):
        if status not in ("static", "dynamic"):
            raise RelmapError(
                f"{shown(folder / LANDMARKS)}: status of landmark {landmark} is {quoted(status)}, "
                "neither static nor dynamic"
            )
    stamps_s, poses = np.empty(0), np.empty((0, 4, 4))
    if (folder / TRAJECTORY).exists():
        stamps_s, poses = read_tum(folder / TRAJECTORY)
    position = np.column_stack([table["x"], table["y"], table["z"]])
    return Truth(table["landmark"], position, table["status"], stamps_s, poses)


def _landmark_folder(path: Path) -> Path | None:
    """Return the folder that holds the landmarks; None where it holds MRPT's truth instead."""
    if (path / "truth" / LANDMARKS).is_file():
        return path / "truth"
    if (path / SUMMARY).exists():
        raise RelmapError(f"{shown(path)}: is a result folder without a truth, expected a truth")
    if (path / LANDMARKS).is_file():
        return path
    if any(path.glob(f"*{_MRPT[0]}")):
        return None
    raise RelmapError(f"{shown(path)}: holds no truth, expected {_EXPECTED}")


def _read_mrpt(path: Path) -> Truth:
    from relmap.datasets.mrpt_landmarks import read_ground_truth

    if not (path.is_dir() or path.name.endswith(_MRPT)):
        raise RelmapError(f"{shown(path)}: is no truth, expected a folder with {_EXPECTED}")
    ids, position, poses = read_ground_truth(path)
    status = np.full(len(ids), "static")
    stamps_s = np.arange(len(poses), dtype=np.float64)
    return Truth(ids, position, status, stamps_s, poses)
