"""The truth that a result is compared with, from any of the forms it comes in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.textfile import quoted, require_path, shown
from relmap.io.files import atomic_write, read_tum, write_tum
from relmap.io.results import SUMMARY
from relmap.io.tables import Kind, csv_text, read_table

LANDMARKS = "landmarks.csv"
TRAJECTORY = "trajectory.tum"
_EXPECTED = (
    f"truth/{LANDMARKS} or {LANDMARKS} in it, MRPT's ..._ground_truth.txt, "
    "or the folder of a known data set"
)
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
        NaN where only the identity of a landmark is known, not its place.
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
    """Read the truth, or what comes nearest to it.

    Parameters
    ----------
    path : Path
        One of

        * a folder with ``truth/landmarks.csv`` or ``landmarks.csv``, and ``trajectory.tum`` beside
          it where the path is known;
        * MRPT's ``..._ground_truth.txt`` or its folder;
        * the folder of I-SLSJF's simulation;
        * the folder of Victoria Park, where nobody surveyed the trees: the published estimates of
          another program are a reference to compare with, not a truth;
        * the folder of DLR's circles, which knows who is who, but no place.

    Raises
    ------
    RelmapError
        Where it is none of these or is damaged.
    """
    require_path(path)
    folder = _landmark_folder(path)
    truth = _read_data_set(path) if folder is None else _read_folder(folder)
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


def _read_folder(folder: Path) -> Truth:
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
    """Return the folder that holds the landmarks; None where it may hold a data set's truth."""
    if (path / "truth" / LANDMARKS).is_file():
        return path / "truth"
    refuse_result(path)
    return path if (path / LANDMARKS).is_file() else None


def refuse_result(path: Path) -> None:
    """Make sure that a folder is not what `relmap map` wrote.

    Raises
    ------
    RelmapError
        Where it is.
    """
    if (path / SUMMARY).exists():
        raise RelmapError(f"{shown(path)}: is a result folder without a truth, expected a truth")


def _read_data_set(path: Path) -> Truth:
    """Read what a data set tells about its landmarks."""
    from relmap.datasets import dlr_circles, mrpt_landmarks, slsjf, victoria_park

    if mrpt_landmarks.is_ground_truth(path):
        return _static(*mrpt_landmarks.read_ground_truth(path))
    if slsjf.is_ground_truth(path):
        return _static(*slsjf.read_ground_truth(path))
    if victoria_park.is_reference(path):
        return _static(*victoria_park.read_reference_map(path), np.empty((0, 4, 4)))
    if dlr_circles.DlrCircles().recognises(path):
        ids = dlr_circles.read_ids(path)
        return _static(ids, np.full((len(ids), 3), np.nan), np.empty((0, 4, 4)))
    what = "holds no truth" if path.is_dir() else "is no truth"
    raise RelmapError(f"{shown(path)}: {what}, expected {_EXPECTED}")


def _static(
    ids: NDArray[np.int64], position: NDArray[np.float64], poses: NDArray[np.float64]
) -> Truth:
    """Return a truth without dynamic landmarks, stamped with the numbers of the iterations."""
    return Truth(ids, position, np.full(len(ids), "static"), np.arange(float(len(poses))), poses)
