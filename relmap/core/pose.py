"""The robot's pose, computed from the map for display only: no step of the mapping reads it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid_each
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
    n, d = end - begin, store.dimension
    at = iterations[mapped] - begin
    R, t, fixed = fit_rigid_each(here[mapped], there[mapped], np.ones(len(at)), at, n)
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :d, :d] = R
    poses[:, :d, 3] = t
    poses[~fixed] = np.nan
    return poses
