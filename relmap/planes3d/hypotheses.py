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

from relmap.core.arrays import Floats, Ints
from relmap.segmentation.space import Patches

SKEW = np.sin(np.deg2rad(20.0))
"""Two normals closer to parallel than this (sine) do not determine a rotation."""
ALIKE_RAD = np.deg2rad(3.0)
"""Tolerance of angles between normals, and of matched normals after the rotation."""
PARALLEL = np.cos(ALIKE_RAD)
SAME_TURN = np.cos(np.deg2rad(6.0))
"""Rotations that differ by less are the same (cosine)."""
LEADERS, TURNS, PER_TURN = 10, 36, 4
"""Number of largest planes of a scan that give hypotheses, of rotations, and of translations per
rotation."""
FLAT_CORNER = 0.15
"""Minimum determinant of three normals that determine a translation."""
OFF_M, OFF_SHARE = 4.0, 0.01
"""Tolerance of offsets: standard deviations of the points, and a fraction of the range."""


@dataclass(frozen=True, eq=False)
class Held:
    """The predicted position of a scan, used in a direction that no plane determines.

    `place` (3,), map frame, metres. `off_m`: standard deviation of the prediction, metres; infinite
    if there were no last steps. It is not used in a direction that the planes determine better.
    """

    place: Floats
    off_m: float


def motions(seen: Patches, there: Patches, held: Held) -> tuple[Floats, Floats]:
    """Return hypotheses of the pose of a scan, largest support first: (h, 3, 3) and (h, 3).

    The support is the fraction of the scan's planes that match, weighted by the square root of
    their size.

    `seen`, `there`: planes of the scan, robot frame, and of the map, map frame.
    """
    from relmap.planes3d.hypothesis_kernels import best_ways, distinct_turns

    size, mine, others = importance(seen), leaders(seen), leaders(there, 2 * LEADERS)
    a, b, weight = seen.normal[mine], there.normal[others], size[mine]
    gate = gates(seen)[mine]
    turns, found = distinct_turns(_turns(a, b), a, b, weight), list[tuple[Floats, Floats]]()
    for R in turns:
        i, j = np.nonzero((a @ R.T) @ b.T > PARALLEL)
        apart_m = 2 * float(np.median(gate[i])) if len(i) else 0.0
        off = there.offset[others[j]] - seen.offset[mine[i]]
        # Three matches determine a translation; two do together with the predicted position.
        found.append(best_ways(b[j], off, i, gate[i], weight, held.place, apart_m))
    count = [len(support) for _, support in found]
    if not sum(count):
        return np.empty((0, 3, 3)), np.empty((0, 3))
    R, t = np.repeat(turns, count, axis=0), np.concatenate([ways for ways, _ in found])
    order = np.argsort(-np.concatenate([support for _, support in found]), kind="stable")
    return R[order], t[order]


def gates(seen: Patches) -> Floats:
    """Return the tolerance of the offset of each patch (m,), metres."""
    return np.asarray(OFF_M * seen.spread[:, 2] + OFF_SHARE * np.linalg.norm(seen.centre, axis=1))


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


def _turns(a: Floats, b: Floats) -> Floats:
    """Return the rotations (h, 3, 3) that bring two of the normals a onto two of b."""
    i = np.array(list(itertools.combinations(range(len(a)), 2)), dtype=np.int64).reshape(-1, 2)
    j = np.array(list(itertools.permutations(range(len(b)), 2)), dtype=np.int64).reshape(-1, 2)
    frame_a, angle_a = _frames(a, i)
    frame_b, angle_b = _frames(b, j)
    if not len(frame_a) or not len(frame_b):
        return np.empty((0, 3, 3))
    p, q = np.nonzero(np.abs(angle_a[:, None] - angle_b) < ALIKE_RAD)
    return frame_b[q] @ frame_a[p].transpose(0, 2, 1)


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
