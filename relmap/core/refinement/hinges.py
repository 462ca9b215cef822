"""How far off a refined map is expected to be, and how much of that is due to some steps.

What little connects, as the few landmarks seen on both sides of a step, may turn about it. The
covariance of a landmark, in the frame of one scan, hardly shows this: it grows with the distance
anyway. The error that is left after the map is aligned with the true one does.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import derivatives
from relmap.core.refinement.joint import Refined

LOST = 1e-9
"""Singular values, relative to the largest, of motions that are known exactly."""
SLIGHT = 0.01
"""Part of the expected squared error below which a step does not matter."""
DOMINANT = 0.75
"""Part from which steps determine how far off the map is: twice as far as without them."""


def expected_error(
    refined: Refined, steps: list[tuple[Ints, Ints]]
) -> tuple[float, float, Floats] | None:
    """Return the expected error of a map, and the part of it due to steps of the robot.

    `steps`: rows of the landmarks that are seen before, and after, each of s steps. Returns the
    root mean square error of the landmarks after rigid alignment, metres; the fraction of its
    square that would be missing if all these steps were known; and the same (s,) for each. None if
    the covariances are not known.
    """
    covariances = refined.covariances
    if refined.spread.problem.unknown is None or not np.isfinite(covariances).all():
        return None
    motions = derivatives(refined.positions - refined.positions.mean(axis=0))
    m, d, q = motions.shape
    flat = motions.reshape(m * d, q)
    frame = np.linalg.pinv(flat)
    whole = float(np.trace(covariances.sum(axis=0)))
    whole -= float(np.trace(frame @ refined.spread.times(motions).reshape(m * d, q)))
    each, sides = np.zeros(len(steps)), []
    for k, (before, after) in enumerate(steps):
        side = _motion(motions, after) - _motion(motions, before)
        spread = refined.spread.times(side).reshape(m * d, q)
        side, aligned = side.reshape(m * d, q), spread - flat @ (frame @ spread)
        each[k] = _due(side.T @ spread, aligned) / whole
        if each[k] >= SLIGHT:
            sides.append((side, spread, aligned))
    together = 0.0
    if sides:
        side, spread, aligned = (np.concatenate(one, axis=1) for one in zip(*sides, strict=True))
        together = _due(side.T @ spread, aligned) / whole
    return float(np.sqrt(max(whole, 0.0) / m)), together, each


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
