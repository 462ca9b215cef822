"""Where a scan may have been taken, by what no motion changes of planes.

The angles between normals do not depend on where planes are seen from, nor do the distances between
parallel ones, nor the shape of the corners that three of them make.  Two planes that are not
parallel fix a turn; three with independent normals fix the whole motion (the consistent basis in
space).  Where a scan shows two directions only, the way along both is not fixed: it is held.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.space import Patches

SKEW = np.sin(np.deg2rad(20.0))
"""Normals nearer to parallel than this (sine) do not fix a turn."""
ALIKE_RAD = np.deg2rad(3.0)
"""How far angles between normals may differ, and normals once turned."""
SAME_TURN = np.cos(np.deg2rad(6.0))
"""Turns that differ by less are one (cosine)."""
LEADERS, PAIRS, TURNS, PER_TURN = 10, 18, 36, 4
"""How many planes of a scan, the largest, make hypotheses; how many candidate matches of a turn,
how many turns are looked at, and how many ways of each are kept."""
FLAT_CORNER = 0.15
"""Least determinant of three normals that fix a way."""
OFF_M, OFF_SHARE = 4.0, 0.01
"""How far offsets may differ: so many standard deviations of points, and a share of the range."""


@dataclass(frozen=True, eq=False)
class Held:
    """Where a scan is taken to be in a direction that no plane measures.

    Attributes
    ----------
    place : (3,) float64, map frame, metres
    off_m : float
        How far it may be off, metres; infinite where nothing is known of the last steps.  A
        direction that planes measure better is not held.
    """

    place: Floats
    off_m: float


@dataclass(frozen=True, eq=False)
class Motions:
    """Hypotheses: h rigid motions from the frame of a scan into that of the map.

    Attributes
    ----------
    R : (h, 3, 3) float64
    t : (h, 3) float64, metres
    support : (h,) float64
        Share of the scan's planes that match, weighed by the root of their size.
    """

    R: Floats
    t: Floats
    support: Floats


def motions(seen: Patches, there: Patches, held: Held) -> Motions:
    """Return where a scan may have been taken, those of most support first.

    Parameters
    ----------
    seen, there : Patches
        Planes of the scan, and of the map.
    held : Held
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
        return Motions(np.empty((0, 3, 3)), np.empty((0, 3)), np.empty(0))
    return Motions(*(np.array(column) for column in zip(*found, strict=True)))


def importance(seen: Patches) -> Floats:
    """Return what each patch (m,) counts, by the root of its size; 1 in all.

    By its size a floor would count for more than all that tells where on the floor a scan is.
    """
    size = np.sqrt(np.bincount(seen.cell_patch, minlength=len(seen)))
    return np.asarray(size / max(size.sum(), 1.0))


def leaders(patches: Patches, most: int = LEADERS) -> Ints:
    """Return the largest patches (k,), ascending."""
    size = np.bincount(patches.cell_patch, minlength=len(patches))
    return np.sort(np.argsort(-size, kind="stable")[:most])


def tolerance(patches: Patches, rows: Ints) -> Floats:
    """Return how far the offsets of patches (k,) may be off, metres."""
    away = np.linalg.norm(patches.centre[rows], axis=1)
    return np.asarray(OFF_M * patches.spread[rows, 2] + OFF_SHARE * away)


def _turns(a: Floats, b: Floats) -> tuple[Floats, int]:
    """Return the turns (h, 3, 3) that bring two of the normals a onto two of b, and how many."""
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
    # Halfway between the two, so that both are as far off.
    x = first + second
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    z = across / sine[:, None]
    frame = np.stack([x, np.cross(z, x), z], axis=2)
    return frame, np.arctan2(sine, (first * second).sum(axis=1))


def _parallel(R: Floats, a: Floats, b: Floats) -> Bools:
    """Tell which normals a (m, 3), once turned, are parallel to which of b (k, 3)."""
    return np.asarray((a @ R.T) @ b.T > np.cos(ALIKE_RAD))


def _distinct(
    turns: Floats, count: int, near: tuple[Floats, Floats], weight: Floats
) -> list[Floats]:
    """Return turns, each unlike the others and fitted to what it makes parallel; best first."""
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
    """Return the turn that brings normals onto those that they are parallel to already."""
    i, j = np.nonzero(_parallel(R, a, b))
    u, _, vt = np.linalg.svd((b[j] * weight[i, None]).T @ a[i])
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    # Normals of one direction only do not fix a turn: what two planes said stands.
    return R if np.linalg.matrix_rank(a[i], SKEW) < 2 else np.asarray(u @ sign @ vt)


def _ways(
    seen: Patches, there: Patches, pairs: Ints, held: Floats, weight: Floats
) -> list[tuple[Floats, float]]:
    """Return ways from candidate matches (p, 2) of parallel planes, and their supports.

    Three matches fix a way; two do, held where they do not.
    """
    from relmap.planes3d.fitting_kernels import crossings

    i, j = pairs.T
    normal, off = there.normal[j], there.offset[j] - seen.offset[i]
    ways, gate = crossings(normal, off, i, held, FLAT_CORNER, SKEW), tolerance(seen, i)
    fits = np.abs(ways @ normal.T - off) < gate
    # A plane of the scan counts once, whatever number of planes it may be.
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
