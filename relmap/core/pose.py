"""The robot's pose, computed from the map for display only: no step of the mapping reads it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import DEGENERATE, rotation_of_moment
from relmap.core.store import ObservationStore


def poses_from_map(
    store: ObservationStore, positions_map: NDArray[np.float64], begin: int, end: int
) -> NDArray[np.float64]:
    """Return the pose in each iteration from `begin` to `end` (sections I and III).

    Each is the least-squares fit of what was seen to where it is mapped.

    Parameters
    ----------
    store : ObservationStore
    positions_map : (m, d) float64, map frame, metres
        NaN where a landmark is not mapped.

    Returns
    -------
    (end - begin, 4, 4) float64
        ``T_map_robot``; NaN where the mapped landmarks in view fix no pose.
    """
    landmarks, iterations = store.seen(begin, end)
    first = store.offsets[begin]
    here = store.points_robot[first : first + len(landmarks)]
    there = positions_map[landmarks]
    mapped = np.isfinite(there).all(axis=1)
    if not mapped.any():
        return np.full((end - begin, 4, 4), np.nan)
    at = iterations[mapped] - begin
    here, there = here[mapped], there[mapped]
    n = end - begin
    counts = np.maximum(np.bincount(at, minlength=n), 1)[:, None]
    here_mean = _sums(here, at, n) / counts
    there_mean = _sums(there, at, n) / counts
    here = here - here_mean[at]
    moment = _sums(here[:, :, None] * (there - there_mean[at])[:, None, :], at, n)
    scatter = np.linalg.eigvalsh(_sums(here[:, :, None] * here[:, None, :], at, n))
    R = rotation_of_moment(moment)
    t = there_mean - np.einsum("nij,nj->ni", R, here_mean)
    d = store.dimension
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :d, :d] = R
    poses[:, :d, 3] = t
    fixed = scatter[:, 1] > DEGENERATE**2 * scatter[:, -1] if d == 3 else scatter[:, -1] > 0
    poses[~fixed] = np.nan
    return poses


def _sums(values: NDArray[np.float64], at: NDArray[np.int64], n: int) -> NDArray[np.float64]:
    """Sum values (m, ...) that belong to iterations at (m,); (n, ...)."""
    columns = values.reshape(len(values), -1).T
    sums = [np.bincount(at, weights=column, minlength=n).astype(np.float64) for column in columns]
    return np.stack(sums, axis=-1).reshape(n, *values.shape[1:])
