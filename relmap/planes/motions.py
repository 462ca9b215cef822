"""Motions in the plane as arrays: yaw, x, y from one robot frame into another."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.motions import rotations, transforms

APART_M, APART_RAD = 0.3, np.deg2rad(8.0)
"""Motions that differ by more are distinct."""


def others(
    motions: Floats, motion: Floats, apart_m: float = APART_M, apart_rad: float = APART_RAD
) -> Bools:
    """Return which motions (k, 3) are distinct from one (3,)."""
    off = np.hypot(*(motions[:, 1:] - motion[1:]).T)
    return np.asarray((off > apart_m) | (np.abs(wrapped(motions[:, 0] - motion[0])) > apart_rad))


def distinct(
    motions: Floats, order: Ints, most: int, apart_m: float = APART_M, apart_rad: float = APART_RAD
) -> Ints:
    """Return the first distinct motions in a given order, up to a maximum.

    `motions` (n, 3): yaw, x, y: radians and metres; `order` (n,): rows of the motions, the
    preferred first; `most`: maximum number of motions; `apart_m`, `apart_rad`: motions that differ
    by more are distinct. Returns (k,): rows of the motions.
    """
    kept: list[int] = []
    while len(order) and len(kept) < most:
        kept.append(int(order[0]))
        turn, x, y = (motions[kept[-1]] - motions[order]).T
        far = (np.hypot(x, y) > apart_m) | (np.abs(wrapped(turn)) > apart_rad)
        order = order[far]
    return np.array(kept, dtype=np.int64)


def after(first: Floats, second: Floats) -> Floats:
    """Return the composition of a motion (3,) with each of others (k, 3)."""
    c, s, both = np.cos(second[:, 0]), np.sin(second[:, 0]), np.empty((len(second), 3))
    both[:, 0] = first[0] + second[:, 0]
    both[:, 1] = c * first[1] - s * first[2] + second[:, 1]
    both[:, 2] = s * first[1] + c * first[2] + second[:, 2]
    return both


def then(first: Floats, second: Floats) -> Floats:
    """Return the composition of two motions (3,)."""
    yaw, x, y = first.tolist()
    turn, ahead, aside = second.tolist()
    c, s = float(np.cos(turn)), float(np.sin(turn))
    return np.array([yaw + turn, c * x - s * y + ahead, s * x + c * y + aside])


def motion_over(motions: Floats) -> Floats:
    """Return the composition of motions (k, 3), in order, as one (3,)."""
    cosines, sines = np.cos(motions[:, 0]).tolist(), np.sin(motions[:, 0]).tolist()
    yaw = x = y = 0.0
    for (turn, ahead, aside), c, s in zip(motions.tolist(), cosines, sines, strict=True):
        yaw, x, y = yaw + turn, c * x - s * y + ahead, s * x + c * y + aside
    return np.array([yaw, x, y])


def inverse(motion: Floats) -> Floats:
    """Return the inverse of a motion (3,), or of each of some (k, 3)."""
    turn, x, y = motion.T
    c, s = np.cos(turn), np.sin(turn)
    return np.array([-turn, -c * x - s * y, s * x - c * y]).T


def matrices(motions: Floats) -> Floats:
    """Return motions (k, 3) as (k, 4, 4)."""
    return transforms(rotations(motions[:, :1]), motions[:, 1:])


def from_matrices(T: Floats) -> Floats:
    """Return the planar motions (..., 3) of matrices (..., 4, 4)."""
    turn = np.arctan2(T[..., 1, 0], T[..., 0, 0])
    return np.concatenate([turn[..., None], T[..., :2, 3]], axis=-1)


def wrapped(angle: Floats) -> Floats:
    """Return angles wrapped to half a turn around 0."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
