"""Matches of the planes of a scan with those of the map, and the pose fitted to them."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.motions import rotations
from relmap.planes3d.hypotheses import LEADERS, SKEW, Held, gates, importance, leaders
from relmap.planes3d.submap import Pose
from relmap.planes3d.surfaces import SIDE
from relmap.segmentation.space import Patches

THICKER = 10.0
"""Largest noise of a plane of the map that counts, as a multiple of that of a plane of the scan."""
SYSTEMATIC = 0.5
"""Error that the points of a plane have in common, as a fraction of their noise, until it is
estimated."""
DOUBTFUL = 4.0
"""Standard deviations above which the weight of a match decreases."""
ROUNDS, SETTLED, LAST = 8, 1e-3, 1e-7
"""Maximum number of steps of a fit, and the step that ends it, or the last one: metres, radians."""
WEAK, OPEN = 0.015, 0.1
"""A direction is weak if the standard deviation of the position exceeds the first fraction of the
range. The prediction is used there if it is more accurate, or if the second fraction is
exceeded."""

BESIDE, SHIFTS = (0.012, 0.1), 2
"""Length of shifts from a placement that are tried, as fractions of the range, and their number."""
FARTHEST, PARALLELS = 0.2, 4
"""Largest distance of planes that may repeat, as a fraction of the range, and number of the nearest
parallel ones that are tried for each plane of a scan."""
SHIFTED = 2.0
"""Tolerance of the matches after a shift, as a multiple of the usual one."""


def matched(
    R: Floats, t: Floats, seen: Patches, planes: Patches, near: Bools, loose: float
) -> tuple[Ints, Floats]:
    """Match the planes of a scan to overlapping planes of the map, each to the one that fits best.

    `R` (3, 3), `t` (3,): pose of the scan. `seen`, `planes`: planes of the scan, robot frame, and
    of the map, map frame. `near` (m, k): which planes overlap; see `Surfaces.overlapping`. `loose`:
    tolerance, as a multiple of the usual one. Returns `match` (m,): plane of the map; -1 for none.
    `off` (m,): residual as a fraction of the tolerance.
    """
    ratio = ratios(R, t, seen, planes, near, loose)
    best = ratio.argmin(axis=1) if ratio.shape[1] else np.zeros(len(seen), dtype=np.int64)
    least = ratio.min(axis=1, initial=np.inf)
    return np.where(least <= 1.0, best, -1), least


def ratios(
    R: Floats, t: Floats, seen: Patches, planes: Patches, near: Bools, loose: float
) -> Floats:
    """Return the residuals (m, k) of planes of a scan on those of the map; see `matched`.

    As a fraction of the tolerance; infinite where they do not overlap, or face other ways.
    """
    off = distances(R, t, seen, planes)
    own = seen.spread[:, None, 2]
    # Clutter that passed for a plane, half a metre thick, would match every plane within it.
    noise = np.hypot(own, np.minimum(planes.spread[:, 2], THICKER * own))
    away = np.linalg.norm(seen.centre, axis=1)[:, None]
    ratio = off / (loose * (2.0 * noise + 0.003 * away))
    turned = (seen.normal @ R.T) @ planes.normal.T
    ratio[turned < SIDE] = np.inf
    ratio[~near] = np.inf
    return np.asarray(ratio)


def shifts(R: Floats, t: Floats, seen: Patches, planes: Patches, near: Bools) -> list[Floats]:
    """Return the translations (3,) near a pose that bring most planes of a scan onto the map.

    Each brings one plane onto a parallel one. Parameters as of `matched`.
    """
    across = (seen.centre @ R.T + t) @ planes.normal.T - planes.offset
    alike = near & ((seen.normal @ R.T) @ planes.normal.T > SIDE)
    share = np.abs(across) / seen.reach_m
    found = []
    for k, j in np.argwhere(alike & (share > BESIDE[0]) & (share < BESIDE[1])).tolist():
        way = t - across[k, j] * planes.normal[j]
        match, off = matched(R, way, seen, planes, near, SHIFTED)
        found.append((importance(seen) @ np.where(match >= 0, 1 - off**2, 0.0), way))
    found.sort(key=lambda each: -each[0])
    return [way for _, way in found[:SHIFTS]]


def repeats(R: Floats, t: Floats, seen: Patches, planes: Patches) -> list[Floats]:
    """Return the translations (3,) of a pose to where most planes match if they repeat.

    Where planes repeat, as on stairs, the next ones are not at the surfaces of a scan: each plane
    of the scan may be any of the nearest parallel ones. Parameters as of `matched`.
    """
    from relmap.planes3d.hypothesis_kernels import best_ways

    mine = leaders(seen, 2 * LEADERS)
    across = (seen.centre[mine] @ R.T + t) @ planes.normal.T - planes.offset
    alike = (seen.normal[mine] @ R.T) @ planes.normal.T > SIDE
    off_m = np.where(alike, np.abs(across), np.inf)
    rows = np.argsort(off_m, axis=1, kind="stable")[:, :PARALLELS]
    nearest = np.zeros_like(alike)
    np.put_along_axis(nearest, rows, True, axis=1)
    k, j = np.nonzero(nearest & (off_m < FARTHEST * seen.reach_m))
    if not len(k):
        return []
    gate, still = gates(seen)[mine[k]], np.zeros(3)
    apart_m = 2 * float(np.median(gate))
    weight = importance(seen)[mine]
    ways, _ = best_ways(planes.normal[j], -across[k, j], k, gate, weight, still, apart_m)
    return [t + way for way in ways if np.linalg.norm(way) > apart_m]


def distances(R: Floats, t: Floats, seen: Patches, planes: Patches) -> Floats:
    """Return the root mean square distances (m, k) of the surfaces of patches from planes of a map.

    The noise of the points across their own plane does not count.
    """
    normal = planes.normal @ R
    across = (seen.centre @ R.T + t) @ planes.normal.T - planes.offset
    u = (seen.axes[:, 0] * seen.spread[:, :1]) @ normal.T
    v = (seen.axes[:, 1] * seen.spread[:, 1:2]) @ normal.T
    return np.sqrt(across**2 + u**2 + v**2)


def fixes_turn(normal: Floats) -> bool:
    """Return whether matched normals (m, 3) determine a rotation."""
    return len(normal) > 1 and bool(np.linalg.svd(normal, compute_uv=False)[1] > SKEW)


def fitted(
    pose: Pose, seen: Patches, planes: Patches, match: Ints, held: Held, last: bool = False
) -> tuple[Floats, Floats, Floats | None, bool]:
    """Fit a pose to matches by robust least squares.

    Only the last fit looks for weak directions that planes determine at all.

    `pose`, R (3, 3) and t (3,): first estimate. `seen`, `planes`: of the scan, robot frame, and of
    the map, map frame. `match` (m,): plane of the map that each plane of the scan matches; -1 for
    none. Returns `R` (3, 3), `t` (3,) and `free` (3,), `is_held`: see `Placed`.
    """
    rows, there = np.flatnonzero(match >= 0), match[match >= 0]
    n, offset = planes.normal[there], planes.offset[there]
    root = _root_information(seen, rows, planes.spread[there, 2])
    arm = np.concatenate([seen.axes[rows, :2], seen.centre[rows, None]], axis=1)
    R, t, H = _settled(pose, arm, n, offset, root, LAST if last else SETTLED)
    free, sd_m = _weakest(H, n)
    weak_m, open_m = (share * seen.reach_m for share in (WEAK, OPEN)) if last else (np.inf,) * 2
    if sd_m <= weak_m and sd_m < np.inf:
        return R, t, None, False
    is_held = not last or sd_m > np.clip(held.off_m, weak_m, open_m)
    if is_held:
        t = t + free * ((held.place - t) @ free)
    return R, t, directed(free), is_held


def _root_information(seen: Patches, rows: Ints, noise_m: Floats) -> Floats:
    """Return the square roots of the information (m, 3) of matched planes of a scan.

    Points of a plane have some of their errors in common. `noise_m` (m,): of the planes of the map.
    """
    spread = seen.spread[rows]
    lever = np.maximum(np.insert(spread[:, :2], 2, 1.0, axis=1), 1e-9)
    common = SYSTEMATIC**2 * (spread[:, 2:] ** 2 + noise_m[:, None] ** 2)
    return np.asarray(
        1 / np.sqrt(1 / np.maximum(seen.information[rows], 1e-12) + common / lever**2)
    )


def _settled(
    pose: Pose, arm: Floats, n: Floats, offset: Floats, root: Floats, settled: float
) -> tuple[Floats, Floats, Floats]:
    """Return rotation and translation fitted to matches, and the normal matrix (6, 6).

    `arm` (m, 3, 3): two directions along each plane of the scan and its centre, robot frame; `n`
    (m, 3), `offset` (m,): of the planes of the map; `root` (m, 3): see `_root_information`;
    `settled`: the step that ends the fit.
    """
    (R, t), H = pose, np.empty((6, 6))
    J = np.zeros((len(n), 3, 6))
    J[:, 2, 3:] = root[:, 2:] * n
    across = np.zeros((len(n), 3, 3))  # of the normals, as a matrix: x @ across is x cross n
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        across[:, b, a], across[:, c, a] = n[:, c], -n[:, b]
    for _ in range(ROUNDS):
        x = arm @ R.T
        off = (x @ n[:, :, None])[:, :, 0]
        off[:, 2] += n @ t - offset
        off *= root
        J[:, :, :3] = root[:, :, None] * (x @ across)
        size = np.sqrt((off * off).sum(axis=1))
        usual = np.partition(size, (len(size) - 1) // 2)[(len(size) - 1) // 2]
        weight = 1 / (1 + (size / max(DOUBTFUL, 2 * usual)) ** 2)
        weighed = (weight[:, None, None] * J).reshape(-1, 6).T
        H, g = weighed @ J.reshape(-1, 6), weighed @ off.ravel()
        diagonal = H.diagonal().reshape(2, 3).sum(axis=1).repeat(3)
        H += np.diag(1e-12 * diagonal + 1e-30)
        step = np.linalg.solve(H, g)
        R, t = rotations(-step[None, :3])[0] @ R, t - step[3:]
        if np.abs(step).max() < settled:
            break
    return R, t, H


def directed(axis: Floats) -> Floats:
    """Return an axis (3,) with its largest component positive."""
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))


def _weakest(H: Floats, n: Floats) -> tuple[Floats, float]:
    """Return the direction in which the position is least certain, and its deviation, metres.

    If the normals (m, 3) span two directions only, it is infinite: planes that are parallel but for
    their noise would determine it by chance.
    """
    _, singular, axes = np.linalg.svd(n)
    if len(n) < 3 or singular[2] < 0.1:
        return axes[2], np.inf
    reduced = H[3:, 3:] - H[3:, :3] @ np.linalg.solve(H[:3, :3], H[:3, 3:])
    least, across = np.linalg.eigh(reduced)
    return across[:, 0], float(least[0] ** -0.5) if least[0] > 0 else np.inf
