"""Compare mapped walls with the true ones."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.datasets import Relations
from relmap.datasets.textfile import require_path, shown
from relmap.evaluation import metrics
from relmap.evaluation.plane_relations import relation_errors
from relmap.io.files import read_text, read_tum
from relmap.io.results import Result
from relmap.io.tables import Kind, read_table
from relmap.planes.table import PlaneTable

TURN = np.cos(np.deg2rad(20.0))
"""A wall is another one where it is turned by more (cosine)."""
APART_M = 0.5
"""A mapped corner farther than this from every true one like it is none of them."""
ROUNDS = 4
CORNER_FIGURES = ("corner_rmse_m", "coverage", "landmarks_per_true")
OFTEN = 10
"""Scans that must have seen a corner before it counts as missing."""


@dataclass(frozen=True, eq=False)
class WallTruth:
    """True walls and, where it is known, the true path.

    Attributes
    ----------
    ends : (w, 2, 2) float64, map frame of the truth, metres
        Right to left as seen from the front; of walls that stand still.
    corner_scans : (w, 2) int64
        In how many scans each true end was seen.
    stamps_s : (k,) float64, poses : (k, 4, 4) float64
        Empty where no path is known.
    relations : tuple of Relations
        Checked relations between poses, by several clocks; see `relation_errors`.
    """

    ends: NDArray[np.float64]
    corner_scans: NDArray[np.int64]
    stamps_s: NDArray[np.float64]
    poses: NDArray[np.float64]
    relations: tuple[Relations, ...] = ()


@dataclass(frozen=True)
class PlaneEvaluation:
    """The figures of one result; None where one cannot be had.

    Attributes
    ----------
    corner_rmse_m : float or None
        Of the mapped corners against the true ones, after rigid alignment.
    coverage : float or None
        Share of the true corners seen in at least ten scans that stand in the map.
    landmarks_per_true : float or None
        Mapped corners for each true one that they stand for; 1 is right.
    purity : None
        Not defined for walls.
    ate_m : float or None
        Absolute trajectory error: RMSE of the positions after rigid alignment.
    rpe_m : float or None
        Relative pose error from one scan to the next: RMSE of its shift.
    relation_m, relation_rad : float or None
        Mean error against checked relations between poses.
    counts : dict
        What the figures rest on: `false_corners` are mapped where no true corner is.
    notes : tuple of str
        Why figures are missing that this truth could give.
    """

    corner_rmse_m: float | None
    coverage: float | None
    landmarks_per_true: float | None
    purity: None
    ate_m: float | None
    rpe_m: float | None
    relation_m: float | None
    relation_rad: float | None
    counts: dict[str, int]
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class MatchedCorners:
    """Mapped corners and the true ones that they stand for.

    Attributes
    ----------
    position, truth : (p, 2) float64, metres
    wall, end : (p,) int64
        Which true corner each is.
    n_false : int
        Mapped corners that are none.
    R, t : (2, 2), (2,) float64
        ``truth ~ position @ R.T + t``.
    """

    position: NDArray[np.float64]
    truth: NDArray[np.float64]
    wall: NDArray[np.int64]
    end: NDArray[np.int64]
    n_false: int
    R: NDArray[np.float64]
    t: NDArray[np.float64]


def read_wall_truth(path: Path) -> WallTruth:
    """Read a folder with ``truth/planes.csv`` or ``planes.csv``, and the path beside it.

    Raises
    ------
    RelmapError
        Where it is none or is damaged.
    """
    require_path(path)
    folder = path / "truth" if (path / "truth").is_dir() else path
    if not (folder / "planes.csv").is_file():
        raise RelmapError(f"{shown(path)}: holds no truth/planes.csv, the walls to compare with")
    names = ("x0", "y0", "x1", "y1")
    columns: dict[str, Kind] = dict.fromkeys(names, "float")
    columns |= {"corner0": "int", "corner1": "int"}
    if "status" in read_text(folder / "planes.csv").partition("\n")[0].split(","):
        columns["status"] = "text"
    table = read_table(folder / "planes.csv", columns)
    ends = np.column_stack([table[name] for name in names]).reshape(-1, 2, 2)
    stamps_s, poses = np.empty(0), np.empty((0, 4, 4))
    if (folder / "trajectory.tum").exists():
        stamps_s, poses = read_tum(folder / "trajectory.tum")
    scans = np.column_stack([table["corner0"], table["corner1"]])
    still = table.get("status", np.full(len(ends), "static")) != "dynamic"
    return WallTruth(ends[still], scans[still], stamps_s, poses)


def evaluate_planes(result: Result, planes: PlaneTable, truth: WallTruth) -> PlaneEvaluation:
    """Compare walls with the truth."""
    mine, other = metrics.match_stamps(result.stamps_s, truth.stamps_s)
    poses, true_poses = result.poses[mine], truth.poses[other]
    counts = {
        "planes": len(planes.plane),
        "mapped_planes": int((planes.status == "static").sum()),
        "true_planes": len(truth.ends),
        "matched_poses": len(mine),
    }
    notes = []
    corners: dict[str, float | None] = dict.fromkeys(CORNER_FIGURES)
    if len(truth.ends):
        matched = match_corners(planes, truth, poses, true_poses)
        corners, corner_counts = _corner_figures(planes, truth, matched, len(mine) > 0)
        counts |= corner_counts
        if matched is None:
            notes.append(f"no corner RMSE: {_why_unmatched(planes, true_poses)}")
    if len(truth.stamps_s) and not len(mine):
        notes.append(metrics.NO_COMMON_TIMES)
    relation = relation_errors(result.stamps_s, result.poses, truth.relations)
    if truth.relations and relation is None:
        notes.append("no checked relation lies within the times of the result")
    return PlaneEvaluation(
        **corners,
        purity=None,
        ate_m=metrics.ate(poses, true_poses, planar=True),
        rpe_m=metrics.rpe(poses, true_poses, other),
        relation_m=None if relation is None else relation[0],
        relation_rad=None if relation is None else relation[1],
        counts=counts,
        notes=tuple(notes),
    )


def _corner_figures(
    planes: PlaneTable, truth: WallTruth, matched: MatchedCorners | None, comparable: bool
) -> tuple[dict[str, float | None], dict[str, int]]:
    """Return `CORNER_FIGURES` and what they rest on, also where no corner could be matched."""
    due = np.flatnonzero(truth.corner_scans.ravel() >= OFTEN)
    counts = {"matched_corners": 0, "false_corners": len(_corners(planes)[0])}
    rmse = per_true = None
    coverage = 0.0 if len(due) and comparable else None
    if matched is not None:
        rmse = metrics.rms(matched.position @ matched.R.T + matched.t - matched.truth)
        corner = 2 * matched.wall + matched.end
        coverage = float(np.isin(due, corner).mean()) if len(due) else None
        per_true = len(corner) / len(np.unique(corner))
        counts = {"matched_corners": len(corner), "false_corners": matched.n_false}
    figures = dict(zip(CORNER_FIGURES, (rmse, coverage, per_true), strict=True))
    return figures, counts | {"due_corners": len(due)}


def _corners(planes: PlaneTable) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and end of each mapped corner."""
    row, end = np.nonzero((planes.corner >= 0) & (planes.status == "static")[:, None])
    return row, end


def _why_unmatched(planes: PlaneTable, true_poses: NDArray[np.float64]) -> str:
    """Say why `match_corners` found nothing."""
    if not len(_corners(planes)[0]):
        return "no corner is mapped"
    if not fixes_rotation(true_poses[:, :2, 3]):
        return "corners are matched by the path, and no two poses of it can be compared"
    return "the map is too far off: where its corners lie there are no true ones"


def match_corners(
    planes: PlaneTable,
    truth: WallTruth,
    poses: NDArray[np.float64],
    true_poses: NDArray[np.float64],
) -> MatchedCorners | None:
    """Pair mapped corners with true ones and align the two, beginning with the paths.

    A corner is paired with the nearest true one at the same end of a wall that looks the same way.

    Returns
    -------
    MatchedCorners or None
        None where there is no path to begin with, or nothing can be paired.
    """
    row, end = _corners(planes)
    position, normal = planes.ends[row, end], planes.normal[row]
    if not fixes_rotation(true_poses[:, :2, 3]) or not len(row) or not len(truth.ends):
        return None
    along = truth.ends[:, 1] - truth.ends[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    front = np.column_stack([-along[:, 1], along[:, 0]])
    R, t = fit_rigid(poses[:, :2, 3], true_poses[:, :2, 3])
    for _ in range(ROUNDS):
        there = position @ R.T + t
        apart = np.linalg.norm(truth.ends[:, end].swapaxes(0, 1) - there[:, None], axis=2)
        apart[normal @ R.T @ front.T < TURN] = np.inf
        wall = apart.argmin(axis=1)
        near = apart.min(axis=1) < APART_M
        target = truth.ends[wall, end]
        if not fixes_rotation(target[near]):
            return None
        R, t = fit_rigid(position[near], target[near])
    n_false = int((~near).sum())
    return MatchedCorners(position[near], target[near], wall[near], end[near], n_false, R, t)
