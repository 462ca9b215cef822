"""How far off a refined map is expected to be, and how much of that is due to its gaps.

What little connects, as the few landmarks seen on both sides of a gap, may turn about it. The
covariance of a landmark, in the frame of one scan, hardly shows this: it grows with the distance
anyway. The error that is left after the map is aligned with the true one does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import derivatives
from relmap.core.refinement.joint import Refined

LOST = 1e-9
"""Singular values, relative to the largest, of motions that are known exactly."""
SLIGHT = 0.01
"""Part of the expected squared error below which a gap does not matter."""
DOMINANT = 0.75
"""Part from which gaps determine how far off the map is: twice as far as without them."""


@dataclass(frozen=True, eq=False)
class Hinges:
    """How far off a refined map is expected to be, and how much of that is due to its gaps.

    `expected_error_m`: root mean square error of the landmarks after rigid alignment; `share`:
    fraction of its square that would be missing if the motion across all gaps were known; `before`,
    `after` (g,): the iterations next to each gap; `shares` (g,): the same fraction for each gap.
    """

    expected_error_m: float
    share: float
    before: Ints
    after: Ints
    shares: Floats


def hinges_of(
    refined: Refined, before: Ints, after: Ints, shown: Callable[[int], Ints]
) -> Hinges | None:
    """Return the expected error of a map, and the part of it due to gaps; None if not known.

    `before`, `after` (g,): the iterations next to each gap; `shown`: returns the rows of the
    landmarks that an iteration shows.
    """
    covariances, times = refined.covariances, refined.spread.times
    if not refined.has_joint_covariances or not np.isfinite(covariances).all():
        return None
    motions = derivatives(refined.positions - refined.positions.mean(axis=0))
    m, d, q = motions.shape
    flat = motions.reshape(m * d, q)
    frame = np.linalg.pinv(flat)
    whole = float(np.trace(covariances.sum(axis=0)))
    whole -= float(np.trace(frame @ times(motions).reshape(m * d, q)))
    each, sides = np.zeros(len(before)), []
    for k, (one, other) in enumerate(zip(before.tolist(), after.tolist(), strict=True)):
        side = _motion(motions, shown(other)) - _motion(motions, shown(one))
        spread = times(side).reshape(m * d, q)
        side, aligned = side.reshape(m * d, q), spread - flat @ (frame @ spread)
        each[k] = _due(side.T @ spread, aligned) / whole
        if each[k] >= SLIGHT:
            sides.append((side, spread, aligned))
    together = 0.0
    if sides:
        side, spread, aligned = (np.concatenate(one, axis=1) for one in zip(*sides, strict=True))
        together = _due(side.T @ spread, aligned) / whole
    return Hinges(float(np.sqrt(max(whole, 0.0) / m)), together, before, after, each)


def _due(inner: Floats, aligned: Floats) -> float:
    """Return by how much the squared error is less if some motions (c,) are known.

    `inner` (c, c): their covariance; `aligned` (n, c): that with the positions, after alignment.
    """
    inverse = np.linalg.pinv(inner, LOST, hermitian=True)
    return float(np.sum(inverse * (aligned.T @ aligned)))


def _motion(motions: Floats, seen: Ints) -> Floats:
    """Return the columns (m, d, q) that give the motion of some landmarks from that of all."""
    found = np.zeros_like(motions)
    own = motions[seen]
    inverse = np.linalg.pinv(own.reshape(-1, own.shape[2]))
    found[seen] = inverse.T.reshape(own.shape)
    return found
