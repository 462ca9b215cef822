"""Compiled loops of `relmap.planes3d.hypotheses`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.rotation_kernels import best_rotation
from relmap.core.linalg.compiling import helper, unrolled
from relmap.core.linalg.order_kernels import ordered
from relmap.core.linalg.small_kernels import diagonalise
from relmap.planes3d.hypotheses import FLAT_CORNER, PARALLEL, PER_TURN, SAME_TURN, SKEW, TURNS

ROUNDED = 1e9
"""Supports that differ by less than the inverse are the same: the first hypothesis is preferred."""


@helper
def _turned(R: Floats, a: Floats, turned: Floats) -> None:
    """Set the normals (m, 3), rotated."""
    for i in range(len(a)):
        for d in range(3):
            turned[i, d] = R[d, 0] * a[i, 0] + R[d, 1] * a[i, 1] + R[d, 2] * a[i, 2]


@helper
def _cosine(a: Floats, b: Floats, i: int, j: int) -> float:
    return float(a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2])


@helper
def _fitted(R: Floats, a: Floats, b: Floats, weight: Floats, turned: Floats) -> Floats:
    """Return the rotation that fits best the normals that are parallel already."""
    moment, scatter = np.zeros((3, 3)), np.zeros((3, 3))
    _turned(R, a, turned)
    for i in range(len(a)):
        for j in range(len(b)):
            if _cosine(turned, b, i, j) <= PARALLEL:
                continue
            for p in range(3):
                for q in range(3):
                    moment[p, q] += weight[i] * a[i, p] * b[j, q]
                    scatter[p, q] += a[i, p] * a[i, q]
    diagonalise(scatter)
    large = 0
    for d in range(3):
        large += scatter[d, d] > SKEW * SKEW
    # Normals of one direction do not determine a rotation: the one from two planes is kept.
    return R if large < 2 else best_rotation(moment, R)


@unrolled
def distinct_turns(turns: Floats, a: Floats, b: Floats, weight: Floats) -> Floats:
    """Return distinct rotations (k, 3, 3), each fitted to the normals it makes parallel.

    Those that make more normals parallel come first.

    `turns` (h, 3, 3); `a` (m, 3), `b` (n, 3): normals of the scan, and of the map; `weight` (m,).
    """
    count, turned = len(turns), np.empty((len(a), 3))
    support, open_ = np.zeros(count), np.ones(count, dtype=np.bool_)
    for h in range(count):
        _turned(turns[h], a, turned)
        for i in range(len(a)):
            for j in range(len(b)):
                if _cosine(turned, b, i, j) > PARALLEL:
                    support[h] -= weight[i]
                    break
        support[h] = np.floor(support[h] * ROUNDED + 0.5)
    chosen, found = np.empty((TURNS, 3, 3)), 0
    for h in ordered(support):
        if not open_[h] or found == TURNS:
            continue
        R = _fitted(turns[h], a, b, weight, turned)
        for other in range(count):
            trace = 0.0
            for p in range(3):
                for q in range(3):
                    trace += turns[other, p, q] * turns[h, p, q]
                    chosen[found, p, q] = R[p, q]
            open_[other] &= (trace - 1) / 2 < SAME_TURN
        found += 1
    return chosen[:found]


@helper
def _way_of_two(
    a: Floats, b: Floats, off_a: float, off_b: float, held: Floats, area: float, way: Floats
) -> None:
    """Set the translation (3,) closest to the predicted one that satisfies two matches."""
    cosine = 0.0
    for d in range(3):
        off_a -= a[d] * held[d]
        off_b -= b[d] * held[d]
        cosine += a[d] * b[d]
    along_a, along_b = (off_a - cosine * off_b) / area, (off_b - cosine * off_a) / area
    for d in range(3):
        way[d] = held[d] + along_a * a[d] + along_b * b[d]


@helper
def _crossings(normal: Floats, off: Floats, of: Ints, held: Floats) -> Floats:
    """Return the translations (w, 3) that satisfy three matches, and those that satisfy two."""
    count, found = len(of), 0
    ways = np.empty((count * (count - 1) // 2 + count * (count - 1) * (count - 2) // 6, 3))
    for i in range(count):
        for j in range(i + 1, count):
            if of[i] == of[j]:
                continue
            a, b = normal[i], normal[j]
            cx, cy = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]
            cz = a[0] * b[1] - a[1] * b[0]
            area = cx * cx + cy * cy + cz * cz
            if area > SKEW**2:
                _way_of_two(a, b, off[i], off[j], held, area, ways[found])
                found += 1
            for k in range(j + 1, count):
                if of[k] == of[i] or of[k] == of[j]:
                    continue
                c = normal[k]
                volume = cx * c[0] + cy * c[1] + cz * c[2]
                if abs(volume) <= FLAT_CORNER:
                    continue
                for d in range(3):
                    e, f = (d + 1) % 3, (d + 2) % 3
                    ways[found, d] = (
                        off[i] * (b[e] * c[f] - b[f] * c[e])
                        + off[j] * (c[e] * a[f] - c[f] * a[e])
                        + off[k] * (a[e] * b[f] - a[f] * b[e])
                    ) / volume
                found += 1
    return ways[:found]


@helper
def _support(
    way: Floats, normal: Floats, off: Floats, of: Ints, gate: Floats, weight: Floats
) -> float:
    """Return the sum of the weights of the planes of a scan that a translation makes match."""
    support, last = 0.0, -1
    for p in range(len(of)):
        ahead = way[0] * normal[p, 0] + way[1] * normal[p, 1] + way[2] * normal[p, 2]
        # A plane of the scan counts once, however many planes of the map it may match.
        if of[p] != last and abs(ahead - off[p]) < gate[p]:
            support, last = support + weight[of[p]], of[p]
    return float(np.floor(support * ROUNDED + 0.5) / ROUNDED)


@helper
def _strongest(ways: Floats, support: Floats, held: Floats) -> int:
    """Return the translation (of w, 3) with most support, -1 if none is left.

    Of those with the same support, as from stairs, which match each other, it is the one closest to
    the predicted one.
    """
    best, nearest = -1, np.inf
    for w in range(len(ways)):
        if support[w] < 0 or (best >= 0 and support[w] < support[best]):
            continue
        square = 0.0
        for d in range(3):
            square += (ways[w, d] - held[d]) ** 2
        if best < 0 or support[w] > support[best] or square < nearest:
            best, nearest = w, square
    return best


@unrolled
def best_ways(
    normal: Floats,
    off: Floats,
    of: Ints,
    gate: Floats,
    weight: Floats,
    held: Floats,
    apart_m: float,
) -> tuple[Floats, Floats]:
    """Return translations (k, 3) from candidate matches, and their supports, best first.

    `normal` (p, 3), `off` (p,): a match requires ``normal @ translation == off``. `of` (p,), equal
    ones together: plane of the scan of each match; two matches of one plane are not combined.
    `gate` (p,): tolerance of a match, metres. `weight` (m,): of the planes of the scan. `held`
    (3,): predicted translation, used in the direction that two matches leave open. `apart_m`:
    translations closer than this are the same.
    """
    ways = _crossings(normal, off, of, held)
    support, kept = np.empty(len(ways)), np.empty((PER_TURN, 3))
    for w in range(len(ways)):
        support[w] = _support(ways[w], normal, off, of, gate, weight)
    supports, found = np.empty(PER_TURN), 0
    while found < PER_TURN:
        best = _strongest(ways, support, held)
        if best < 0:
            break
        supports[found] = support[best]
        for d in range(3):
            kept[found, d] = ways[best, d]
        for w in range(len(ways)):
            square = 0.0
            for d in range(3):
                square += (ways[w, d] - kept[found, d]) ** 2
            if square <= apart_m * apart_m:
                support[w] = -1.0
        found += 1
    return kept[:found], supports[:found]
