"""Lines in the ground plane by RANSAC in local windows, with a density split along each.

A window holds few walls, so two of its points lie on the same wall far more often than two of the
scan's (local sampling: Torr and Davidson, "IMPSAC", PAMI 2003).  From the window a line grows along
its own band as long as points follow one another; the best lines claim their points first.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.noise import neighbour_distance, points_per_beam
from relmap.segmentation.wall import LEAST, SHARE, WALL

TRIES = 100
BEAMS = 0.5
"""Angle, in beams, below which points are the noise of one column, not a wall."""
UNCLAIMED = 0.6
"""Fraction of a line's points that must still be free for it to keep them; else it is regrown."""


def find_lines(
    xy: Floats, sigma: float, rng: np.random.Generator, beam: float
) -> tuple[Floats, Ints]:
    """Return lines and the line of each point.

    `xy` (n, 2), robot frame, metres. `sigma`: noise, metres. `beam`: angle between beams, radians;
    0 without beams. Returns `walls` (k, WALL): see `relmap.segmentation.wall`; best first. `labels`
    (n,): row of `walls`, -1 for none.
    """
    from relmap.segmentation.em.window_kernels import grow_lines

    labels, found = np.full(len(xy), -1), [np.zeros((0, WALL))]
    if len(xy) < LEAST:
        return found[0], labels
    window, repeat = max(6 * sigma, 2 * neighbour_distance(xy)), points_per_beam(xy)
    narrow, count = BEAMS * beam, 0
    while (labels < 0).sum() >= LEAST:
        free = np.flatnonzero(labels < 0)
        grown = grow_lines(xy[free], rng.random((TRIES, 2)), sigma, window, repeat, narrow)
        chosen, claims = _best_first(*grown[1:])
        if not chosen:
            break
        for k, claim in zip(chosen, claims, strict=True):
            labels[free[claim]] = count
            grown[0][k, SHARE] = claim.sum() / len(xy)
            count += 1
        found.append(grown[0][chosen])
    return np.concatenate(found), labels


def _best_first(members: Bools, scores: Floats) -> tuple[list[int], list[Bools]]:
    """Return which lines claim points, best first, and the points (n,) each claims."""
    size = members.sum(axis=1)
    quality = scores / np.maximum(size, 1)
    chosen: list[int] = []
    claims: list[Bools] = []
    left = size
    while True:
        score = np.where(left >= UNCLAIMED * size, left * quality, 0)
        best = int(score.argmax())
        if left[best] < LEAST or score[best] <= 0:
            return chosen, claims
        claim = members[best].copy()
        chosen.append(best)
        claims.append(claim)
        members &= ~claim
        left = members.sum(axis=1)
