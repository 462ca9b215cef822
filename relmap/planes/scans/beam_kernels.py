"""Agreement of the beams of two scans for a motion between them, compiled.

A scan is `points` (n, 2), robot frame, sorted by bearing from `origin` (2,), where the sensor is;
`solid` (n,) marks those on walls, `loose` (n,) those on small free-standing objects; and its
`surfaces`.  A motion is yaw, x, y from the frame of the earlier scan into that of the later one.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper, unrolled
from relmap.planes.scans.beams import NEAR_M
from relmap.planes.scans.surface_kernels import BESIDE, LANES, squared_nearest

Fan = tuple[Floats, Floats, Bools, Bools, Floats, Floats, Ints]

GAP_M, GAP = 0.3, 0.1
"""Beams farther apart than this plus so much of the range do not share a surface."""
GAP_RAD, MISSING = 0.1, 1.5
"""Bearings farther apart than this are outside the field of view; if they are so many times farther
apart than others, a beam is missing, and a gap there may be anything."""
PARTS, NEAR = 1024, 2
"""Parts of all directions, of which the first beam is known; and how many beams farther on the next
one is found sooner from there than from the last one."""
SAME = 0.005
"""Difference of the agreement of a point below which it favours no motion: measured ranges of a
wall are off by some millimetres, depending on the angle, which standing still repeats."""
STRAIGHT, FARTHER = 0.05, 4.0
"""Points lie on a line up to this fraction of their distance, and this ratio of distances."""


@helper
def _rank(x: float, y: float) -> float:
    """Return a number that is ordered as the bearings of directions are, -2 to 2, and cheaper."""
    off = y / (abs(x) + abs(y)) if x != 0 or y != 0 else 0.0
    if x >= 0:
        return off
    return 2 - off if y >= 0 else -2 - off


@helper
def _continues(points: Floats, i: int, j: int, k: int) -> bool:
    """Return whether the line through two points passes near a third one, beyond the second."""
    if i < 0 or i >= len(points):
        return False
    ux, uy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    vx, vy = points[k, 0] - points[j, 0], points[k, 1] - points[j, 1]
    size, ahead = math.sqrt(ux * ux + uy * uy), math.sqrt(vx * vx + vy * vy)
    off = abs(ux * vy - uy * vx) / max(size, 1e-9)
    return bool(ux * vx + uy * vy > 0 and off < STRAIGHT * ahead and ahead < FARTHER * size)


@helper
def _part(rank: float) -> int:
    """Return the part of all directions in which a rank is."""
    return min(max(int(PARTS / 4 * (rank + 2)), 0), PARTS - 1)


@helper
def _index(ranks: Floats) -> Ints:
    """Return the first beam in each part of all directions, or after it; (`PARTS`,)."""
    index, i = np.empty(PARTS, dtype=np.int64), 0
    for part in range(PARTS):
        while i < len(ranks) and _part(ranks[i]) < part:
            i += 1
        index[part] = i
    return index


@compiled
def surfaces(points: Floats, bearings: Floats, origin: Floats) -> tuple[Floats, Floats, Ints]:
    """Return what lies between each beam and the one before, (6, n + 7), and ranks (n,) of beams.

    The end of the previous beam, the vector from it to the end of this one, the inverse of its
    squared length or -1 for a gap, and the range of the shorter beam, or -1 out of view. The column
    of beam j is j + `BESIDE`; the first and the last one are repeated beyond. Also returns the
    `_index`.
    """
    n, spacing = len(points), np.inf
    found, ranks = np.zeros((6, n + LANES - 1)), np.empty(n)
    for j in range(1, n):
        if bearings[j] - bearings[j - 1] > 1e-4:
            spacing = min(spacing, bearings[j] - bearings[j - 1])
    for j in range(n):
        ranks[j] = _rank(points[j, 0] - origin[0], points[j, 1] - origin[1])
    for k in range(found.shape[1] if n > 1 else 0):
        j = min(max(k - BESIDE, 1), n - 1)
        ax, ay = points[j - 1, 0], points[j - 1, 1]
        ux, uy = points[j, 0] - ax, points[j, 1] - ay
        length = ux * ux + uy * uy
        gap = length > (GAP_M + GAP * math.sqrt(ax * ax + ay * ay)) ** 2
        found[0, k], found[1, k], found[2, k], found[3, k] = ax, ay, ux, uy
        found[4, k] = -1.0 if gap else 1.0 / max(length, 1e-12)
        found[5, k] = math.sqrt(
            min(
                (points[j, 0] - origin[0]) ** 2 + (points[j, 1] - origin[1]) ** 2,
                (ax - origin[0]) ** 2 + (ay - origin[1]) ** 2,
            )
        )
        apart = bearings[j] - bearings[j - 1]
        missing = apart > MISSING * spacing
        # On a line with a neighbour: a wall that is seen at a grazing angle.
        on_line = _continues(points, j - 2, j - 1, j) or _continues(points, j + 1, j, j - 1)
        if gap and not missing and on_line:
            found[4, k] = 1.0 / max(length, 1e-12)
        if apart > GAP_RAD or (gap and missing):
            found[5, k] = -1.0
    return found, ranks, _index(ranks)


@helper
def _beam_from(ranks: Floats, rank: float, i: int) -> int:
    """Return the first beam whose rank (n,) is at least a given one, searched from beam i on."""
    while i < len(ranks) and ranks[i] < rank:
        i += 1
    while i > 0 and ranks[i - 1] >= rank:
        i -= 1
    return i


@helper
def _compare(
    seen: Fan,
    other: Fan,
    motion: Floats,
    near_m: float,
    step: int,
    firm: bool,
    sums: Floats,
    values: Floats,
) -> None:
    """Count the points of `other`, transformed into the frame of `seen`, that agree with its beams.

    `sums` are the points on a surface that was seen, the wall points in front of one, where a beam
    passed through, the undecided ones, and those out of view.  Unless empty, `values` are NaN and
    get the contribution of each point: 0.5 to 1, -1 and 0; those out of view stay NaN.
    """
    _, origin, _, loose, lines, ranks, index = seen
    points, _, solid, apart, _, _, _ = other
    c, s, n, i = math.cos(motion[0]), math.sin(motion[0]), len(ranks), 0
    agree, against, undecided, unseen, near = sums[0], 0, 0, 0, near_m * near_m
    for k in range(0, len(points), step):
        if firm and apart[k]:
            continue
        px, py = points[k, 0], points[k, 1]
        x, y = c * px - s * py + motion[1], s * px + c * py + motion[2]
        dx, dy = x - origin[0], y - origin[1]
        rank = _rank(dx, dy)
        i = _beam_from(ranks, rank, index[_part(rank)] if step > NEAR else i)
        range_m = lines[5, i + BESIDE]
        if i == 0 or i == n or range_m < 0:
            unseen += 1
            continue
        off = squared_nearest(x, y, lines, i)
        # Branches would be mispredicted for many points, which takes longer than the arithmetic.
        is_near, value = off < near, 1 - 0.5 * off / near
        passed = math.sqrt(dx * dx + dy * dy) < range_m - 2 * near_m
        is_against = (not is_near) & passed & solid[k]
        is_out = (not is_near) & (not passed) & firm & loose[i] & loose[i - 1]
        agree += value if is_near else 0.0
        against += is_against
        unseen += is_out
        undecided += not (is_near | is_against | is_out)
        if len(values) > 0:
            rest = np.nan if is_out else (-1.0 if is_against else 0.0)
            values[k] = value if is_near else rest
    sums[0], sums[1], sums[2] = agree, sums[1] + against, sums[2] + undecided
    sums[3] += unseen


@helper
def _inverse(motion: Floats) -> Floats:
    """Return the inverse of a motion (3,)."""
    c, s, back = math.cos(motion[0]), math.sin(motion[0]), np.empty(3)
    back[0] = -motion[0]
    back[1], back[2] = -c * motion[1] - s * motion[2], s * motion[1] - c * motion[2]
    return back


@compiled
def compared(
    earlier: Fan, later: Fan, motions: Floats, near_m: float, step: int, firm: bool
) -> Floats:
    """Return how many points of both scans agree, contradict, are undecided, and out of view.

    Shape (k, 4), for each of k motions; the beams are subsampled.
    """
    sums, none = np.zeros((len(motions), 4)), np.empty(0)
    for k in range(len(motions)):
        motion, back = motions[k], _inverse(motions[k])
        _compare(later, earlier, motion, near_m, step, firm, sums[k], none)
        _compare(earlier, later, back, near_m, step, firm, sums[k], none)
    return sums


@unrolled
def differences(earlier: Fan, later: Fan, motions: Floats, firm: bool) -> Floats:
    """Return by how much each point of both scans agrees better with motions than with the first.

    Of 1 + k motions, and n and m points: (k, n + m). A point contributes 0.5 to 1 if it agrees, -1
    if it contradicts, 0 if undecided. Differences below `SAME`, and of points that are out of view
    by one of both motions or loose, are 0.
    """
    n, sums = len(earlier[0]), np.zeros(4)
    size = n + len(later[0])
    first, values, off = np.empty(size), np.empty(size), np.zeros((len(motions) - 1, size))
    for k in range(len(motions)):
        own = values if k > 0 else first
        for i in range(size):
            own[i] = np.nan
        motion, back = motions[k], _inverse(motions[k])
        _compare(later, earlier, motion, NEAR_M, 1, firm, sums, own[:n])
        _compare(earlier, later, back, NEAR_M, 1, firm, sums, own[n:])
        if k > 0:
            for i in range(size):
                difference = values[i] - first[i]
                if abs(difference) >= SAME:  # not if NaN
                    off[k - 1, i] = difference
    return off
