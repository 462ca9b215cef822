"""Whether a place has one shape in two refined submaps, by the covariances of both.

Positions averaged over many observations may still be uncertain, as few landmarks in view transfer
the heading. A refined submap describes this: its landmarks err jointly (Neira and Tardos, 2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from relmap.core.arrays import Floats, Ints
from relmap.core.association.placement import Placement
from relmap.core.association.reobservation.evidence import LOCAL_DRIFT
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.refinement.joint import Refined

UNLIKELY = 1e-5
"""Accepted probability that the shapes of one place differ by more."""
LEAST = 1e-9
"""Variance of a coordinate at least, relative to the mean one, for rounding."""


@dataclass(frozen=True, eq=False)
class Compared:
    """How closely two arrangements of some landmarks agree.

    `square`: of their difference after the best motion, in variances; `freedom`: its expectation.
    `log_size`: log of the volume, among all arrangements, of those of one variance and within a
    motion of one metre and one radian. `placement`: of the first arrangement on the other.
    """

    square: float
    freedom: int
    log_size: float
    placement: Placement


class Shapes:
    """Compares places in refined submaps.

    `refined`: the submaps; `drift`: variance by which segments deviate from them, relative to that
    of an observation (`local_drift`): what exceeds the usual one is not in the covariances.
    """

    def __init__(self, refined: Sequence[Refined] = (), drift: float = LOCAL_DRIFT) -> None:
        self._refined = [one for one in refined if is_known(one)]
        self._variance = drift - LOCAL_DRIFT

    def know(self, landmarks: Ints) -> bool:
        """Return whether the joint covariance of landmarks (k,) is known."""
        return any(np.isin(landmarks, one.landmarks).all() for one in self._refined)

    def agree(self, here: Ints, there: Ints) -> bool | None:
        """Return whether landmarks (k,) are arranged as others (k,) are, up to a motion.

        None if the joint covariance of either is unknown.
        """
        first, second = self._joint(here), self._joint(there)
        if first is None or second is None:
            return None
        found = compared(*first, *second)
        return bool(found.square <= chdtri(found.freedom, UNLIKELY))

    def _joint(self, landmarks: Ints) -> tuple[Floats, Floats] | None:
        """Return positions (k, d) and their covariance (k d, k d), if they are of one submap."""
        for refined in self._refined:
            rows = np.searchsorted(refined.landmarks, landmarks)
            rows[rows == len(refined.landmarks)] = 0
            if np.array_equal(refined.landmarks[rows], landmarks):
                return refined.positions[rows], joint_covariance(refined, rows, self._variance)
        return None


def is_known(refined: Refined) -> bool:
    """Return whether the joint covariances of a submap tell how closely places must agree."""
    return refined.converged and refined.has_joint_covariances and not refined.is_exact


def joint_covariance(refined: Refined, rows: Ints, variance: float) -> Floats:
    """Return the covariance (k d, k d), square metres, of landmarks in rows (k,), to be inverted.

    `variance`: added to that of each coordinate, relative to that of an observation.
    """
    found = refined.joint_covariance(rows)
    more = variance * refined.noise_m**2 + LEAST * np.diag(found).mean()
    return np.asarray(found + more * np.eye(len(found)))


def compared(mine: Floats, own: Floats, its: Floats, spread: Floats) -> Compared:
    """Return how closely positions (k, d) are arranged as others (k, d) are, up to a motion.

    `own`, `spread` (k d, k d): covariances of both.
    """
    R, t = fit_rigid(mine, its)
    turn = np.kron(np.eye(len(mine)), R)
    root = np.linalg.cholesky(turn @ own @ turn.T + spread)
    moved = _by_motion(its - its.mean(axis=0))
    off = (mine @ R.T + t - its).reshape(-1, 1)
    whitened = solve_triangular(root, np.hstack([off, moved]), lower=True)
    motion = np.linalg.lstsq(whitened[:, 1:], whitened[:, 0])[0]
    left = whitened[:, 0] - whitened[:, 1:] @ motion
    log_size = float(np.log(np.diag(root)).sum())
    log_size += float(np.linalg.slogdet(whitened[:, 1:].T @ whitened[:, 1:])[1]) / 2
    freedom = len(moved) - moved.shape[1]
    return Compared(float(left @ left), freedom, log_size, Placement(R, t, len(mine)))


def _by_motion(points: Floats) -> Floats:
    """Return by how much points (k, d) move by a small motion (k d, 3 d - 3)."""
    k, d = points.shape
    shifts = np.tile(np.eye(d), (k, 1))
    first, second = np.triu_indices(d, 1)
    turns = np.zeros((k, d, len(first)))
    each = np.arange(len(first))
    turns[:, first, each], turns[:, second, each] = -points[:, second], points[:, first]
    return np.hstack([shifts, turns.reshape(k * d, -1)])
