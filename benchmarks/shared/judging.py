"""How right the submaps of a log of laser scans are, against the poses of the log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from relmap import PlaneMapper
from relmap.core.arrays import Floats, Ints
from relmap.datasets.scans import ScanLog
from relmap.evaluation.metrics import ate

FEWEST = 10
"""Minimum number of scans of a submap that is evaluated by itself."""
ON_M = 0.15
"""Largest distance between points of two scans that count as the same place."""
DISPUTED = 0.1
"""Fraction of the points of a scan by which the poses of the map must explain more."""


def step_errors(poses: Floats, true_poses: Floats) -> tuple[Floats, Floats]:
    """Return the errors (k - 1,) of the steps between poses (k, 4, 4), metres and radians."""
    step, true_step = (np.linalg.inv(T[:-1]) @ T[1:] for T in (poses, true_poses))
    off = np.linalg.inv(true_step) @ step
    turn_rad = np.asarray(Rotation.from_matrix(off[:, :3, :3]).magnitude())
    return np.linalg.norm(off[:, :3, 3], axis=1), turn_rad


def wrong_steps(
    poses: Floats, true_poses: Floats, most_m: float = 0.3, most_rad: float = np.deg2rad(10.0)
) -> NDArray[np.intp]:
    """Return the scans (n,) of a submap with a wrong pose relative to the previous one.

    `poses`, `true_poses` (k, 4, 4): T_map_robot of consecutive scans. `most_m`, `most_rad`: largest
    error of a correct step.
    """
    shift_m, turn_rad = step_errors(poses, true_poses)
    return 1 + np.flatnonzero((shift_m > most_m) | (turn_rad > most_rad))


def overlap(points: Floats, others: Floats, T: Floats) -> float:
    """Return the fraction of points (n, 2) of a scan within `ON_M` of others (m, 2) of another.

    Both are in the frame of their robot, metres; `T` (4, 4) transforms the first to the second.
    """
    if not (len(points) and len(others)):
        return 0.0
    moved = points @ T[:2, :2].T + T[:2, 3]
    away = np.asarray(cKDTree(others).query(moved)[0])
    return float((away <= ON_M).mean())


def share_right(scans: Floats, ates_m: Floats, n_scans: int, most_m: float = 0.3) -> float:
    """Return the fraction of the `n_scans` of a log that lie in a correct submap.

    `scans` (s,): those with a pose in each submap, of which fewer than `FEWEST` do not count;
    `ates_m` (s,): ATE of each submap, aligned separately; at most `most_m` if it is correct.
    """
    return float(scans[(scans >= FEWEST) & (ates_m <= most_m)].sum() / n_scans)


def judged(mapper: PlaneMapper, log: ScanLog) -> Floats:
    """Return figures of each submap, the largest first.

    Scans, ATE [m], wrong steps and disputed ones; the other wrong ones that are not listed as weak,
    and right ones that are.
    """
    assert log.poses is not None
    rows, weak = [], mapper.weak_links
    for submap in mapper.submaps:
        truth = log.poses[slice(*submap.span)]
        known = np.isfinite(submap.poses).all(axis=(1, 2)) & np.isfinite(truth).all(axis=(1, 2))
        poses, truth, scan = (
            submap.poses[known],
            truth[known],
            submap.span[0] + np.flatnonzero(known),
        )
        ate_m = ate(poses, truth, planar=True)
        steps = wrong_steps(poses, truth)
        disputed = np.array(
            [_disputed(log, scan[k - 1 : k + 1], poses[k - 1 : k + 1]) for k in steps.tolist()],
            dtype=np.bool_,
        )
        listed = np.isin(scan, weak)
        counts = len(steps), disputed.sum(), (~listed[steps[~disputed]]).sum()
        right = listed.sum() - listed[steps].sum()
        rows.append((len(poses), np.inf if ate_m is None else ate_m, *counts, right))
    table = np.array(rows).reshape(-1, 6)
    return np.asarray(table[np.argsort(-table[:, 0], kind="stable")])


def _disputed(log: ScanLog, scans: Ints, poses: Floats) -> bool:
    """Return whether two scans fit better by the poses (2, 4, 4) given than by those of the log."""
    assert log.poses is not None
    before, after = (log.points_of(int(scan)) for scan in scans)
    own, reference = (
        overlap(after, before, np.linalg.inv(T[0]) @ T[1]) for T in (poses, log.poses[scans])
    )
    return own > reference + DISPUTED


def judged_cells(submaps: Floats, n_scans: int) -> list[str]:
    """Return the cells of the errors of submaps."""
    if not len(submaps):
        return ["0 | 0 | 0.0% | - | - | 0 | 0 | 0 | 0"]
    scans, ates_m, *steps = submaps.T
    worst_m = ates_m[scans >= FEWEST].max(initial=0.0)
    return [
        f"{len(scans)} | {scans[0]:.0f}",
        f"{share_right(scans, ates_m, n_scans):.1%}",
        f"{ates_m[0]:.3f} | {worst_m:.3f}",
        *(f"{each.sum():.0f}" for each in steps),
    ]
