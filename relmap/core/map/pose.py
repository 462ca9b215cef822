"""The robot's pose, computed from the map: for display, and to repair where it is torn."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import sums_each
from relmap.core.geometry.motions import transforms
from relmap.core.geometry.robust import OUTLIER, fit_robust_each
from relmap.core.refinement.condensing import NOWHERE, SegmentRows
from relmap.core.refinement.rows import numbered
from relmap.core.state.kept import KeptObservations

ABSURD = 0.01
"""Weight of an observation ten times as far off as the least outlier: it has no part in a pose."""
LOOSE_RAD = 0.1
"""Largest standard deviation of the turn of a pose that is known; in space, of that about a line,
as of a row of lamps."""


def trajectory(rows: SegmentRows, positions_map: Floats, of: Ints, noise_m: float = 0.0) -> Floats:
    """Return the pose in every iteration (sections I and III).

    Each is the least-squares fit of the observed landmarks to the map. The observations are
    condensed: the points of the segment seen in an iteration are fitted in their place, since the
    residuals within a segment are not explained by a small motion. The fit is robust to a few wrong
    matches.

    `rows`, `positions_map`, `of`, `noise_m`: as for `known_poses`. Returns (n_iterations, 4, 4):
    ``T_map_robot``; NaN if unknown.
    """
    poses = np.full((len(rows.iteration_segment), 4, 4), np.nan)
    at, known = known_poses(rows, positions_map, of, noise_m)
    poses[at] = known
    return poses


def known_poses(
    rows: SegmentRows, positions_map: Floats, of: Ints, noise_m: float = 0.0
) -> tuple[Ints, Floats]:
    """Return the iterations (p,), ascending, with a pose, and the poses (p, 4, 4).

    `rows`: rows of all iterations; `positions_map` (m, d), map frame, metres: NaN for unmapped
    landmarks; `of` (m,): the landmark that each number stands for, after merging; `noise_m`:
    standard deviation of an observed coordinate. There is no pose if the mapped landmarks in view
    do not determine it, as two side by side or those nearly on a line in space, or contradict each
    other.
    """
    d = rows.points.shape[1]
    there = positions_map[of[rows.landmark]]
    mapped = np.flatnonzero(np.isfinite(there).all(axis=1))
    row, scan = rows.only(mapped).sightings
    row, (scans, at) = mapped[row], numbered(scan)
    n, ones = len(scans), np.ones(len(row))
    if not n:
        return scans, np.empty((0, 4, 4))
    R, t, fixed, weight = fit_robust_each(rows.points[row], there[row], ones, at, n)
    used = weight > ABSURD
    fixed &= np.bincount(at[used], minlength=n) >= d
    across = squares_across(there[row[used]], at[used], n)
    fixed &= noise_m / np.sqrt(np.maximum(across, 1e-300)) <= LOOSE_RAD
    fixed &= rows.iteration_segment[scans] != NOWHERE
    known, R, t = scans[fixed], R[fixed], t[fixed]
    there = np.einsum("nij,nj->ni", R, rows.t[known]) + t
    return known, transforms(R @ rows.R[known], there)


def weigh_poses(
    known: Ints, poses: Floats, kept: KeptObservations, positions_map: Floats, of: Ints
) -> None:
    """Fit poses (p, 4, 4) of iterations (p,) to observations by their covariances, in place.

    Where one direction is measured many times better than another, or near landmarks than distant
    ones, the fit of `known_poses` is several times as far off. `kept`: all observations, with
    covariances; `positions_map`, `of`: as for `known_poses`. Where fewer observations agree with
    the fit of all than with a robust one, only the latter are fitted. A pose stays as it is if too
    few agree on another.
    """
    from relmap.core.geometry.weighted_kernels import weighted_fit_rows

    there = positions_map[of[kept.landmark]]
    rows = np.flatnonzero(np.isfinite(there).all(axis=1) & np.isin(kept.iteration, known))
    there, seen, at = there[rows], kept.location[rows], np.searchsorted(known, kept.iteration[rows])
    d, root = there.shape[1], np.linalg.inv(np.linalg.cholesky(kept.covariance[rows]))
    R, t, _, _ = fit_robust_each(there, seen, np.ones(len(rows)), at, len(known))
    off = np.einsum("nij,nj->ni", R[at], there) + t[at] - seen
    agrees = np.linalg.norm(np.einsum("nij,nj->ni", root, off), axis=1) <= OUTLIER
    for k, pose in enumerate(poses):
        i, j = np.searchsorted(at, [k, k + 1]).tolist()
        if j - i < d:
            continue
        few = i + np.flatnonzero(agrees[i:j])
        for own in slice(i, j), few:
            R_k, t_k, n_agreeing = weighted_fit_rows(there[own], seen[own], OUTLIER, root[own])
            # Distant wrong ids may mislead the fit of all.
            if n_agreeing >= len(few) or len(few) < d:
                break
        if n_agreeing >= d:
            pose[:d, :d], pose[:d, 3] = R_k.T, -R_k.T @ t_k


def squares_across(points: Floats, at: Ints, n: int) -> Floats:
    """Return the sum of squared distances (n,), square metres, of points (k, d) from their centre.

    In space from the line nearest to them: the worst turn is about that. `at` (k,): set of each.
    """
    centre = sums_each(points, at, n) / np.maximum(np.bincount(at, minlength=n), 1)[:, None]
    away = points - centre[at]
    scatter = sums_each(away[:, :, None] * away[:, None], at, n)
    across = np.trace(scatter, axis1=1, axis2=2)
    if points.shape[1] == 3:
        across = across - np.linalg.eigvalsh(scatter)[:, -1]
    return np.asarray(across)
