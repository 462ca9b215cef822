"""Relations between two walls, and occlusion: a nearer wall splits the visible part of the other.

If noise fills a narrow shadow, it is not visible in the points, but follows from the occluding
wall. The fraction of walls found in single scans hardly changes, but without this the corners
beside a shadow are missing in maps.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.segmentation.em.mixture import WallMixture
from relmap.segmentation.wall import BEGIN, END, PX, PY, SHARE, UX, UY, corners, cut

HIDDEN = 0.7
"""Fraction of the smaller wall's view in which two walls cannot both be seen: walls are opaque."""
FLUSH = 4.0
"""Standard deviations within which a wall in front of another is the same one."""
PARALLEL_SINE = 0.3
BEFORE = 2.0
"""Standard deviations by which an occluding wall must be nearer."""
NARROWEST = 0.5
"""Minimum width of a shadow, in standard deviations."""
BESIDE = 0.8
"""Minimum visible length of a wall beyond a shadow, in standard deviations."""
LEAST = 16
"""Minimum number of points of an occluding wall."""
PLAIN = 2.0
"""Width of a shadow, in standard deviations, above which it must be visible in the points."""
LEAKED = 0.8
"""Points carried into a shadow by noise, in standard deviations of wall."""


def flush(w: Floats, v: Floats, sigma: float) -> bool:
    """Return whether the shorter of two walls lies on the longer one's line, within noise."""
    if w[END] - w[BEGIN] < v[END] - v[BEGIN]:
        w, v = v, w
    if abs(w[UX] * v[UY] - w[UY] * v[UX]) > PARALLEL_SINE:
        return False
    return bool((np.abs((corners(v) - w[:2]) @ (-w[UY], w[UX])) < FLUSH * sigma).all())


def side_by_side(w: Floats, v: Floats) -> bool:
    """Return whether most of the shorter of two walls lies beside the longer one."""
    if w[END] - w[BEGIN] < v[END] - v[BEGIN]:
        w, v = v, w
    t = np.sort((corners(v) - w[:2]) @ w[UX : UY + 1])
    return bool(min(w[END], t[1]) - max(w[BEGIN], t[0]) > HIDDEN * (t[1] - t[0]))


def one_hides_other(w: Floats, v: Floats, sigma: float) -> bool:
    """Return whether two walls share most of the smaller one's view: the sensor sees only one.

    By more than noise explains.
    """
    spans, blur = [], 0.0
    for wall in (w, v):
        ends = corners(wall)
        middle = ends.mean(axis=0)
        turned = ends @ np.array([[middle[0], -middle[1]], [middle[1], middle[0]]])
        bearing = np.arctan2(turned[:, 1], turned[:, 0]) + np.arctan2(middle[1], middle[0])
        spans.append((bearing.min(), bearing.max()))
        blur = max(blur, sigma / max(float(np.hypot(*middle)), 1e-9))
    (a, b), (c, d) = spans
    shift = 2 * np.pi * round(((a + b) - (c + d)) / (4 * np.pi))
    shared = min(b, d + shift) - max(a, c + shift)
    return bool(shared > HIDDEN * min(b - a, d - c) + blur)


def within_reach(w: Floats, v: Floats, sigma: float) -> bool:
    """Return whether two walls come so close that they may be one."""
    reach = 4 * sigma + 0.1 * min(w[END] - w[BEGIN], v[END] - v[BEGIN])
    for one, other in ((w, v), (v, w)):
        offset = corners(other) - one[:2]
        t, d = offset @ one[UX : UY + 1], offset @ (-one[UY], one[UX])
        beyond = np.maximum(np.maximum(one[BEGIN] - t, t - one[END]), 0)
        if (np.hypot(beyond, d) < reach).any():
            return True
    return False


def shadows(walls: Floats, k: int, sigma: float, n: int) -> Floats:
    """Return the stretches (s, 2) along wall k, among n points, that nearer walls hide."""
    wall = walls[k]
    others = np.delete(walls, k, axis=0)
    others = others[others[:, SHARE] * n >= LEAST]
    middle = 0.5 * (others[:, BEGIN] + others[:, END])
    t = np.column_stack([others[:, BEGIN], middle, others[:, END]])
    rays = others[:, None, PX : PX + 2] + t[:, :, None] * others[:, None, UX : UX + 2]
    across = rays[..., 0] * wall[UY] - rays[..., 1] * wall[UX]
    height = wall[PX] * wall[UY] - wall[PY] * wall[UX]
    met = height / np.where(np.abs(across) < 1e-9, 1e-9, across)  # in multiples of the ray
    nearer = (met[:, 1] - 1) * np.linalg.norm(rays[:, 1], axis=1) > BEFORE * sigma
    ahead = (met > 0).all(axis=1)
    place = ((met[..., None] * rays - wall[:2]) @ wall[UX : UY + 1])[:, [0, 2]]
    place = np.sort(place[nearer & ahead], axis=1)
    return np.asarray(place[place[:, 1] - place[:, 0] > NARROWEST * sigma])


def part_at_shadows(mixture: WallMixture, xy: Floats) -> WallMixture:
    """Split walls occluded by nearer ones, unless more points lie there than noise explains."""
    labels, walls, room = mixture.labels(xy), [], BESIDE * mixture.along
    for k, wall in enumerate(mixture.walls):
        pieces = [wall]
        t = np.sort(mixture.sightings(xy[labels == k], wall)[1])
        for low, high in shadows(mixture.walls, k, mixture.sigma, len(xy)):
            last = pieces[-1]
            inside = (low > last[BEGIN] + room) and (high < last[END] - room)
            if not inside or not _empty(t, low, high, wall, mixture.along):
                continue
            pieces[-1:] = cut(last, (low, high), float(np.mean(t < 0.5 * (low + high))))
        walls += pieces
    return mixture.with_walls(np.array(walls).reshape(-1, mixture.walls.shape[1]))


def _empty(t: Floats, low: float, high: float, wall: Floats, sigma: float) -> bool:
    """Return whether a stretch among sorted positions (m,) on a wall may contain only noise."""
    if len(t) < LEAST:
        return False
    if high - low < PLAIN * sigma:
        return True
    count = np.diff(np.searchsorted(t, [low, high]))[0]
    seen = max(wall[END] - wall[BEGIN] - (high - low), sigma)
    leaked = (len(t) - count) / seen * min(LEAKED * sigma, high - low)
    return bool(count < leaked + 3 * np.sqrt(leaked) + 1)


def parted(walls: Floats, i: int, j: int, sigma: float, n: int) -> bool:
    """Return whether a shadow separates two walls, among n points, that might be one."""
    if walls[i, END] - walls[i, BEGIN] < walls[j, END] - walls[j, BEGIN]:
        i, j = j, i
    w, v = walls[i], walls[j]
    low, high = np.sort((corners(v) - w[:2]) @ w[UX : UY + 1])
    if min(w[END], high) - max(w[BEGIN], low) > PLAIN * sigma:
        return False
    gap = (w[END], low) if low + high > w[BEGIN] + w[END] else (high, w[BEGIN])
    others = np.delete(walls, j, axis=0)
    dark = shadows(others, i - (j < i), sigma, n)
    near = (dark[:, 0] < max(gap) + sigma) & (dark[:, 1] > min(gap) - sigma)
    outer = (dark[:, 0] > min(w[BEGIN], low)) & (dark[:, 1] < max(w[END], high))
    return bool((near & outer).any())
