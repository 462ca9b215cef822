"""Joint least squares over the relative maps of all groups: the step that the paper lacks.

A chain of groups drifts, and where it closes a loop only the landmarks seen again move.  Here all
relative maps are laid on one another at once.  Where each one lies is a nuisance variable, no
motion is estimated: what counts is where the landmarks come to lie relative to one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from relmap.core.alignment import fit_rigid_each, sums_each
from relmap.core.landmarks import MappedGroup

ROUNDS = 10
SETTLED = 1e-6
"""Step, as a share of the size of the map, at which the solution has settled."""
LOOSE = 1e-9
"""What holds a group that hangs by too little, as a share of what holds the others."""


@dataclass(frozen=True, eq=False)
class RelativeObservations:
    """Positions of landmarks in the frames of groups, as a structure of arrays.

    Attributes
    ----------
    points : (n, d) float64, group frame, metres
    weights : (n,) float64
        Observations behind each.
    group : (n,) int64
        0 to n_groups - 1.
    landmark : (n,) int64
        0 to n_landmarks - 1.
    n_groups, n_landmarks : int
    """

    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    group: NDArray[np.int64]
    landmark: NDArray[np.int64]
    n_groups: int
    n_landmarks: int


def gathered(
    groups: Sequence[MappedGroup], mapped: NDArray[np.bool_], of: NDArray[np.int64]
) -> RelativeObservations:
    """Return what groups saw of mapped landmarks.

    Parameters
    ----------
    groups : sequence of MappedGroup
    mapped : (m,) bool
        Which landmarks count.
    of : (m,) int64
        The landmark that each number stands for, after merging.
    """
    sizes = [len(group.landmarks) for group in groups]
    landmark = of[np.concatenate([group.landmarks for group in groups])]
    weights = np.concatenate([group.n_observations for group in groups]).astype(np.float64)
    rows = mapped[landmark] & (weights > 0)
    return RelativeObservations(
        np.concatenate([group.relative_map for group in groups])[rows],
        weights[rows],
        np.repeat(np.arange(len(groups)), sizes)[rows],
        landmark[rows],
        len(groups),
        len(mapped),
    )


def refine(
    observations: RelativeObservations, positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return positions (m, d) that all relative maps agree on best.

    Gauss-Newton with the landmarks eliminated: they are the weighted means of where the groups put
    them, so that only the placements of the groups are solved for (Schur complement).

    Parameters
    ----------
    observations : RelativeObservations
        Of one piece of the map.
    positions : (m, d) float64, metres
        The chained map; its frame is kept at the first group.

    Returns
    -------
    (m, d) float64, metres
        As before where no group saw a landmark.
    """
    o = observations
    R, t, fixed = fit_rigid_each(o.points, positions[o.landmark], o.weights, o.group, o.n_groups)
    o = _only(o, fixed[o.group])
    free = np.flatnonzero(np.bincount(o.group, minlength=o.n_groups))[1:]
    for _ in range(ROUNDS):
        turned = np.einsum("nij,nj->ni", R[o.group], o.points)
        residual = turned + t[o.group]
        residual -= _means(o, residual)[o.landmark]
        turn, shift = _step(o, turned, residual, free)
        R, t = turn @ R, t + shift
        if np.abs(shift).max() <= SETTLED * np.abs(t).max():
            break
    placed = np.einsum("nij,nj->ni", R[o.group], o.points) + t[o.group]
    seen = np.bincount(o.landmark, minlength=o.n_landmarks) > 0
    return np.where(seen[:, None], _means(o, placed), positions)


def _only(o: RelativeObservations, rows: NDArray[np.bool_]) -> RelativeObservations:
    return RelativeObservations(
        o.points[rows], o.weights[rows], o.group[rows], o.landmark[rows], o.n_groups, o.n_landmarks
    )


def _means(o: RelativeObservations, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weighted mean (m, d) of values (n, d) for each landmark."""
    total = np.bincount(o.landmark, weights=o.weights, minlength=o.n_landmarks)
    sums = sums_each(values * o.weights[:, None], o.landmark, o.n_landmarks)
    return np.asarray(sums / np.where(total > 0, total, 1)[:, None])


def _step(
    o: RelativeObservations,
    turned: NDArray[np.float64],
    residual: NDArray[np.float64],
    free: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return one Gauss-Newton step: turns (g, d, d) and shifts (g, d) of the groups."""
    d = turned.shape[1]
    J = np.concatenate([_turning(turned), np.tile(np.eye(d), (len(turned), 1, 1))], axis=2)
    q = J.shape[2]
    weighted = J * o.weights[:, None, None]
    own = sums_each(np.swapaxes(weighted, 1, 2) @ J, o.group, o.n_groups)
    right = sums_each(np.einsum("nij,ni->nj", weighted, residual), o.group, o.n_groups)
    total = np.bincount(o.landmark, weights=o.weights, minlength=o.n_landmarks)
    root = 1 / np.sqrt(np.where(total > 0, total, 1))
    coupling = _blocks(weighted * root[o.landmark, None, None], o.landmark, o.group, o)
    columns = (free[:, None] * q + np.arange(q)).ravel()
    coupling = coupling[:, columns]
    own[:, range(q), range(q)] *= 1 + LOOSE
    step = np.zeros(o.n_groups * q)
    if len(columns):
        normal = sparse.block_diag(own[free]) - coupling.T @ coupling
        solver = splu(normal.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        step[columns] = -solver.solve(right.ravel()[columns])
    step = step.reshape(o.n_groups, q)
    return _rotations(step[:, : q - d]), step[:, q - d :]


def _turning(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivative (n, d, r) of turned points (n, d) by a small turn."""
    x, y = points[:, 0], points[:, 1]
    if points.shape[1] == 2:
        return np.stack([-y, x], axis=1)[:, :, None]
    z, zero = points[:, 2], np.zeros(len(points))
    rows = [[zero, z, -y], [-z, zero, x], [y, -x, zero]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def _rotations(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    if turns.shape[1] == 3:
        return np.asarray(Rotation.from_rotvec(turns).as_matrix())
    cos, sin = np.cos(turns[:, 0]), np.sin(turns[:, 0])
    return np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)


def _blocks(
    blocks: NDArray[np.float64],
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    o: RelativeObservations,
) -> sparse.csr_array:
    """Return the sparse matrix with blocks (n, d, q) at block rows and columns."""
    _, d, q = blocks.shape
    rows = np.broadcast_to((row[:, None] * d + np.arange(d))[:, :, None], blocks.shape)
    columns = np.broadcast_to((column[:, None] * q + np.arange(q))[:, None, :], blocks.shape)
    shape = (o.n_landmarks * d, o.n_groups * q)
    entries = (blocks.ravel(), (rows.ravel(), columns.ravel()))
    return sparse.coo_array(entries, shape=shape).tocsr()
