"""The robot's pose, computed from the map for display only: no step of the mapping reads it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid_each
from relmap.core.landmarks import MappedGroup
from relmap.core.store import ObservationStore


def trajectory(
    store: ObservationStore,
    groups: Sequence[MappedGroup],
    positions_map: NDArray[np.float64],
    of: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the pose in every iteration (sections I and III).

    Each is the least-squares fit of what was seen to where it is mapped.  Of iterations whose
    observations are forgotten, the groups know where they lie in their relative maps, and those
    are fitted to the map.

    Parameters
    ----------
    store : ObservationStore
    groups : sequence of MappedGroup
    positions_map : (m, d) float64, map frame, metres
        NaN where a landmark is not mapped.
    of : (m,) int64
        The landmark that each number stands for, after merging.

    Returns
    -------
    (n_iterations, 4, 4) float64
        ``T_map_robot``; NaN where the mapped landmarks in view fix no pose.
    """
    poses = np.full((store.n_iterations, 4, 4), np.nan)
    if not np.isfinite(positions_map).any():
        return poses
    R, t, at = _from_groups(groups, positions_map, of)
    _enter(poses, at, R, t)
    first, end = store.first_iteration, store.n_iterations
    landmarks, iterations = store.seen(first, end)
    here, there = store.points(first, end), positions_map[landmarks]
    mapped = np.isfinite(there).all(axis=1)
    at = iterations[mapped] - first
    ones = np.ones(len(at))
    R, t, fixed = fit_rigid_each(here[mapped], there[mapped], ones, at, end - first)
    _enter(poses, first + np.flatnonzero(fixed), R[fixed], t[fixed])
    return poses


def _from_groups(
    groups: Sequence[MappedGroup], positions_map: NDArray[np.float64], of: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return R (k, d, d) and t (k, d) of robot to map frame, and their iterations (k,)."""
    group = np.repeat(np.arange(len(groups)), [len(g.landmarks) for g in groups])
    there = positions_map[of[np.concatenate([g.landmarks for g in groups])]]
    weights = np.concatenate([g.n_observations for g in groups]).astype(np.float64)
    known = np.isfinite(there).all(axis=1) & (weights > 0)
    points = np.concatenate([g.relative_map for g in groups])[known]
    R, t, fixed = fit_rigid_each(points, there[known], weights[known], group[known], len(groups))
    owner = np.repeat(np.arange(len(groups)), [len(g.fitted) for g in groups])
    rows = fixed[owner]
    owner = owner[rows]
    inner_R = np.concatenate([g.R for g in groups])[rows]
    inner_t = np.concatenate([g.t for g in groups])[rows]
    at = np.concatenate([g.fitted for g in groups])[rows]
    return R[owner] @ inner_R, np.einsum("kij,kj->ki", R[owner], inner_t) + t[owner], at


def _enter(
    poses: NDArray[np.float64],
    at: NDArray[np.int64],
    R: NDArray[np.float64],
    t: NDArray[np.float64],
) -> None:
    d = t.shape[1]
    poses[at] = np.eye(4)
    poses[at, :d, :d] = R
    poses[at, :d, 3] = t
