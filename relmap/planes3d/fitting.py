"""Which planes of the map a scan shows where it is taken to be, and where that puts it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes3d.hypotheses import SKEW, Held
from relmap.segmentation.space import Patches

LOOKED_AT = 800
"""Cells of a scan that tell which planes overlap."""
NEAR = 3.0
"""How far from a cell of the map a cell on the same plane is, in cells, where surfaces overlap."""
SIDE = np.cos(np.deg2rad(12.0))
"""How far the normals of one plane may differ (cosine)."""
SYSTEMATIC = 0.5
"""Error that the points of a plane have in common, as a share of their noise, as long as the map
does not tell."""
BENT_RAD = 1e-4
"""How far the map may be bent."""
DOUBTFUL = 4.0
"""Standard deviations from which a match counts less."""
ROUNDS, SETTLED, ROUNDING = 8, 1e-7, 1e-13
"""Steps of a fit at most, and step that ends it, and the last one, metres and radians."""
WEAK, OPEN = 0.015, 0.1
"""A direction in which the place is known no better than the first share of the range is weak.  It
is held where planes tell less than the last steps do, or not even the second share."""


class Surfaces:
    """Planes of the map with the places where they were seen.

    Parameters
    ----------
    planes : Patches
        In the frame of the map.

    Attributes
    ----------
    tree : cKDTree
        Of their cells.
    """

    def __init__(self, planes: Patches) -> None:
        self.planes = planes
        self.tree = cKDTree(planes.cells)

    def near(self, points: Floats, reach: float) -> Ints:
        """Return the plane of the nearest cell of each point (n,); -1 where it is out of reach."""
        cell = self.tree.query(points, distance_upper_bound=reach)[1]
        return np.asarray(np.append(self.planes.cell_patch, -1)[cell])


def matched(
    R: Floats, t: Floats, seen: Patches, there: Surfaces, loose: float
) -> tuple[Ints, Floats]:
    """Return the plane of the map (m,) that each plane of a scan lies on, and how far off it is.

    It is -1 for none, and as far off as a match may be where that is 1.

    Of several the one that fits best is taken, of those that it overlaps with.

    Parameters
    ----------
    R, t
        Where the scan was taken.
    seen, there
    loose : float
        How many times as far off as usual planes may be.
    """
    planes = there.planes
    off = distances(R, t, seen, planes)
    noise = np.hypot(seen.spread[:, None, 2], planes.spread[:, 2])
    away = np.linalg.norm(seen.centre, axis=1)[:, None]
    ratio = off / (loose * (2.0 * noise + 0.003 * away))
    turned = (seen.normal @ R.T) @ planes.normal.T
    ratio[turned < SIDE] = np.inf
    ratio[~overlapping(R, t, seen, there)] = np.inf
    best = ratio.argmin(axis=1) if ratio.shape[1] else np.zeros(len(seen), dtype=np.int64)
    least = ratio.min(axis=1, initial=np.inf)
    return np.where(least <= 1.0, best, -1), least


def overlapping(R: Floats, t: Floats, seen: Patches, there: Surfaces) -> Bools:
    """Tell which planes of a scan were seen near where those of the map (k,) were; (m, k)."""
    planes, near = there.planes, np.zeros((len(seen), len(there.planes)), dtype=bool)
    rows = np.arange(0, len(seen.cells), max(len(seen.cells) // LOOKED_AT, 1))
    points, of = seen.cells[rows] @ R.T + t, seen.cell_patch[rows]
    reach = 2 * NEAR * max(planes.cell_m, seen.cell_m)
    away, cell = there.tree.query(points, k=4, distance_upper_bound=reach)
    plane = np.append(planes.cell_patch, 0)[cell]
    hit = np.isfinite(away)
    near[np.broadcast_to(of[:, None], plane.shape)[hit], plane[hit]] = True
    return near


def distances(R: Floats, t: Floats, seen: Patches, planes: Patches) -> Floats:
    """Return the root mean square distances (m, k) of planes, where seen, from those of a map.

    Without what is noise.
    """
    normal = planes.normal @ R
    across = (seen.centre @ R.T + t) @ planes.normal.T - planes.offset
    u = (seen.axes[:, 0] * seen.spread[:, :1]) @ normal.T
    v = (seen.axes[:, 1] * seen.spread[:, 1:2]) @ normal.T
    return np.sqrt(across**2 + u**2 + v**2)


def fixes_turn(normal: Floats) -> bool:
    """Tell whether planes (m, 3) that match fix a turn."""
    return len(normal) > 1 and bool(np.linalg.svd(normal, compute_uv=False)[1] > SKEW)


def fitted(
    R: Floats,
    t: Floats,
    seen: Patches,
    planes: Patches,
    match: Ints,
    held: Held,
    last: bool = False,
) -> tuple[Floats, Floats, Floats | None, bool]:
    """Fit a placement to matches, by least squares that let go of what does not fit.

    Only the last fit asks for weak directions in which something tells.

    Returns
    -------
    R : (3, 3) float64, t : (3,) float64
    free : (3,) float64 or None, is_held : bool
        As `Placed` has them.
    """
    from relmap.planes3d.fitting_kernels import placement_equations

    rows = np.flatnonzero(match >= 0)
    n = planes.normal[match[rows]]
    there = np.column_stack([n, planes.offset[match[rows]]])
    root = np.sqrt(_information(seen, rows, planes, match))
    axes, centre = seen.axes[rows], seen.centre[rows]
    for _ in range(ROUNDS):
        H, g = placement_equations(R, t, axes, centre, there, root, DOUBTFUL)
        # A little that holds where nothing tells.
        hold = np.repeat([np.trace(H[:3, :3]), np.trace(H[3:, 3:])], 3) * 1e-12 + 1e-30
        step = -np.linalg.solve(H + np.diag(hold), g)
        R, t = Rotation.from_rotvec(step[:3]).as_matrix() @ R, t + step[3:]
        if np.abs(step).max() < (ROUNDING if last else SETTLED):
            break
    free, sd_m = _weakest(H + np.diag(hold), n)
    weak_m, open_m = (share * seen.reach_m for share in (WEAK, OPEN)) if last else (np.inf,) * 2
    if sd_m <= weak_m and sd_m < np.inf:
        return R, t, None, False
    is_held = not last or sd_m > np.clip(held.off_m, weak_m, open_m)
    if is_held:
        t = t + free * ((held.place - t) @ free)
    return R, t, directed(free), is_held


def directed(axis: Floats) -> Floats:
    """Return an axis (3,) with its largest component positive."""
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))


def _weakest(H: Floats, n: Floats) -> tuple[Floats, float]:
    """Return the direction in which the place is known worst, and how well: metres.

    Planes that are parallel but for their noise would invent a constraint there, so the directions
    of the normals count, not how sure they are.
    """
    _, singular, axes = np.linalg.svd(n)
    if len(n) < 3 or singular[2] < 0.1:
        return axes[2], np.inf
    reduced = H[3:, 3:] - H[3:, :3] @ np.linalg.solve(H[:3, :3], H[:3, 3:])
    least, across = np.linalg.eigh(reduced)
    return across[:, 0], float(least[0] ** -0.5) if least[0] > 0 else np.inf


def _information(seen: Patches, rows: Ints, planes: Patches, match: Ints) -> Floats:
    """Return the information (r, 3) of matches: of patches, and of the planes that they are.

    Points of a plane have some of their errors in common, and the map is not exact.
    """
    spread, range_m = seen.spread[rows], np.linalg.norm(seen.centre[rows], axis=1)
    shared = SYSTEMATIC * np.hypot(spread[:, 2], planes.spread[match[rows], 2])
    off = np.hypot(shared, BENT_RAD * range_m)
    tilt = np.hypot(shared[:, None] / np.maximum(spread[:, :2], 1e-9), BENT_RAD)
    variance = 1 / np.maximum(seen.information[rows], 1e-12)
    return np.asarray(1 / (variance + np.column_stack([tilt, off]) ** 2))
