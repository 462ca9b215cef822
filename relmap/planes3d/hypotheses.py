"""Hypotheses of the pose of a scan, from properties of planes that do not depend on the motion.

These are the angles between normals, the distances between parallel planes, and the points where
three planes meet. Two planes that are not parallel determine a rotation; three with independent
normals determine the pose (the consistent basis in space). If the normals of a scan have two
directions only, the translation along both planes is undetermined and is predicted instead.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.space import Patches

SKEW = np.sin(np.deg2rad(20.0))
"""Two normals closer to parallel than this (sine) do not determine a rotation."""
ALIKE_RAD = np.deg2rad(3.0)
"""Tolerance of angles between normals, and of matched normals after the rotation."""
SAME_TURN = np.cos(np.deg2rad(6.0))
"""Rotations that differ by less are the same (cosine)."""
LEADERS, PAIRS, TURNS, PER_TURN = 10, 18, 36, 4
"""Number of largest planes of a scan that give hypotheses, of candidate matches per rotation, of
rotations, and of translations per rotation."""
FLAT_CORNER = 0.15
"""Minimum determinant of three normals that determine a translation."""
OFF_M, OFF_SHARE = 4.0, 0.01
"""Tolerance of offsets: standard deviations of the points, and a fraction of the range."""


@dataclass(frozen=True, eq=False)
class Held:
    """The predicted position of a scan, used in a direction that no plane determines.

    Attributes
    ----------
    place : (3,) float64, map frame, metres
    off_m : float
        Standard deviation of the prediction, metres; infinite if there were no last steps. It is
        not used in a direction that the planes determine better.
    """

    place: Floats
    off_m: float


@dataclass(frozen=True, eq=False)
class Motions:
    """Hypotheses: h rigid motions from the frame of the scan to that of the map.

    Attributes
    ----------
    R : (h, 3, 3) float64
    t : (h, 3) float64, metres
    """

    R: Floats
    t: Floats


def motions(seen: Patches, there: Patches, held: Held) -> Motions:
    """Return hypotheses of the pose of a scan, largest support first.

    The support is the fraction of the scan's planes that match, weighted by the square root of
    their size.

    Parameters
    ----------
    seen, there : Patches
        Planes of the scan, robot frame, and of the map, map frame.
    held : Held

    Returns
    -------
    Motions
    """
    weight = importance(seen)
    mine, others = leaders(seen), leaders(there, 2 * LEADERS)
    near = seen.normal[mine], there.normal[others]
    found: list[tuple[Floats, Floats, float]] = []
    for R in _distinct(*_turns(*near), near, weight[mine]):
        a, b = np.nonzero(_parallel(R, *near))
        order = np.argsort(-weight[mine[a]], kind="stable")[:PAIRS]
        pairs = np.column_stack([mine[a], others[b]])[order]
        for t, support in _ways(seen, there, pairs, held.place, weight):
            found.append((R, t, support))
    found.sort(key=lambda each: -each[2])
    if not found:
        return Motions(np.empty((0, 3, 3)), np.empty((0, 3)))
    return Motions(np.array([R for R, _, _ in found]), np.array([t for _, t, _ in found]))


def importance(seen: Patches) -> Floats:
    """Return the weight of each patch (m,), the square root of its size; the sum is 1.

    Weighted by size, a floor would outweigh all planes that determine the position on it.
    """
    size = np.sqrt(np.bincount(seen.cell_patch, minlength=len(seen)))
    return np.asarray(size / max(size.sum(), 1.0))


def leaders(patches: Patches, most: int = LEADERS) -> Ints:
    """Return the largest patches (k,), ascending."""
    size = np.bincount(patches.cell_patch, minlength=len(patches))
    return np.sort(np.argsort(-size, kind="stable")[:most])


def tolerance(patches: Patches, rows: Ints) -> Floats:
    """Return the tolerance of the offsets of patches (k,), metres."""
    away = np.linalg.norm(patches.centre[rows], axis=1)
    return np.asarray(OFF_M * patches.spread[rows, 2] + OFF_SHARE * away)


def _turns(a: Floats, b: Floats) -> tuple[Floats, int]:
    """Return the rotations (h, 3, 3) that bring two of the normals a onto two of b, and h."""
    i = np.array(list(itertools.combinations(range(len(a)), 2)), dtype=np.int64).reshape(-1, 2)
    j = np.array(list(itertools.permutations(range(len(b)), 2)), dtype=np.int64).reshape(-1, 2)
    frame_a, angle_a = _frames(a, i)
    frame_b, angle_b = _frames(b, j)
    if not len(frame_a) or not len(frame_b):
        return np.empty((0, 3, 3)), 0
    p, q = np.nonzero(np.abs(angle_a[:, None] - angle_b) < ALIKE_RAD)
    return frame_b[q] @ frame_a[p].transpose(0, 2, 1), len(p)


def _frames(normal: Floats, pairs: Ints) -> tuple[Floats, Floats]:
    """Return frames (p, 3, 3), as columns, of pairs of normals, and the angles between these."""
    first, second = normal[pairs[:, 0]], normal[pairs[:, 1]]
    across = np.cross(first, second)
    sine = np.linalg.norm(across, axis=1)
    skew = sine > SKEW
    first, second, across, sine = first[skew], second[skew], across[skew], sine[skew]
    # Halfway between the two normals, so that both have the same error.
    x = first + second
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    z = across / sine[:, None]
    frame = np.stack([x, np.cross(z, x), z], axis=2)
    return frame, np.arctan2(sine, (first * second).sum(axis=1))


def _parallel(R: Floats, a: Floats, b: Floats) -> Bools:
    """Return which normals a (m, 3), rotated, are parallel to which normals b (k, 3)."""
    return np.asarray((a @ R.T) @ b.T > np.cos(ALIKE_RAD))


def _distinct(
    turns: Floats, count: int, near: tuple[Floats, Floats], weight: Floats
) -> list[Floats]:
    """Return distinct rotations, each fitted to the normals it makes parallel; best first."""
    if not count:
        return []
    a, b = near
    cosine = np.einsum("hij,mj,ki->hmk", turns, a, b, optimize=True)
    support = np.round((cosine.max(axis=2) > np.cos(ALIKE_RAD)) @ weight, 9)
    chosen: list[Floats] = []
    left = np.argsort(-support, kind="stable")
    while len(left) and len(chosen) < TURNS:
        R = _fitted(turns[left[0]], a, b, weight)
        chosen.append(R)
        apart = (np.einsum("hij,ij->h", turns[left], turns[left[0]]) - 1) / 2 < SAME_TURN
        left = left[apart]
    return chosen


def _fitted(R: Floats, a: Floats, b: Floats, weight: Floats) -> Floats:
    """Return the rotation that fits best the normals that are parallel already."""
    i, j = np.nonzero(_parallel(R, a, b))
    u, _, vt = np.linalg.svd((b[j] * weight[i, None]).T @ a[i])
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    # Normals of one direction do not determine a rotation: the one from two planes is kept.
    return R if np.linalg.matrix_rank(a[i], SKEW) < 2 else np.asarray(u @ sign @ vt)


def _ways(
    seen: Patches, there: Patches, pairs: Ints, held: Floats, weight: Floats
) -> list[tuple[Floats, float]]:
    """Return translations from candidate matches (p, 2) of parallel planes, and their supports.

    Three matches determine a translation; two do together with the predicted position.
    """
    from relmap.planes3d.fitting_kernels import crossings

    i, j = pairs.T
    normal, off = there.normal[j], there.offset[j] - seen.offset[i]
    ways, gate = crossings(normal, off, i, held, FLAT_CORNER, SKEW), tolerance(seen, i)
    fits = np.abs(ways @ normal.T - off) < gate
    # A plane of the scan counts once, however many planes of the map it may match.
    own, place = np.unique(i, return_inverse=True)
    counted = np.zeros((len(ways), len(own)), dtype=bool)
    for column, row in enumerate(place):
        counted[:, row] |= fits[:, column]
    support = np.round(counted @ weight[own], 9)
    kept: list[tuple[Floats, float]] = []
    left = np.argsort(-support, kind="stable")
    while len(left) and len(kept) < PER_TURN:
        kept.append((ways[left[0]], float(support[left[0]])))
        away = ((ways[left] - ways[left[0]]) ** 2).sum(axis=1)
        left = left[away > (2 * np.median(gate)) ** 2]
    return kept
