"""Planes grown over flat voxels, and joined where they are the same within the noise."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.space.voxels import Voxels, principal

PARALLEL = np.cos(np.deg2rad(5.0))
"""Tolerance of the normals of planes that are the same (cosine)."""
TURN = np.cos(np.deg2rad(25.0))
"""Tolerance of the normal of a voxel (cosine): it is inaccurate if it has few points."""
REACH = 3.0
"""Largest distance of the centres of voxels from their plane, in standard deviations."""
FEWEST_VOXELS = 4
"""Minimum number of voxels of a plane."""
REGROWN = 6
"""Maximum number of refits of a plane while it grows."""
ALIKE = 1.5
"""Two planes are the same if the root mean square distance of the points of each from their common
plane is at most this multiple of the noise."""


def moments_by(moments: Floats, label: Ints) -> Floats:
    """Return the moments (m, 10) of planes, the sums of those of their voxels."""
    sums = np.zeros((int(label.max(initial=-1)) + 1, moments.shape[1]))
    np.add.at(sums, label[label >= 0], moments[label >= 0])
    return sums


def planes_of(moments: Floats) -> Floats:
    """Return normals that point to the sensor, and offsets: (m, 4)."""
    centre, _, axes = principal(moments)
    normal = axes[:, 0]
    offset = (normal * centre).sum(axis=1)
    sign = np.where(offset > 0, -1.0, 1.0)
    return np.column_stack([normal * sign[:, None], offset * sign])


def grown(voxels: Voxels, flat: Bools, sigma: Floats) -> Ints:
    """Return the plane (v,) of each voxel, -1 for none.

    Parameters
    ----------
    voxels : Voxels
    flat : (v,) bool
        Voxels that may belong to a plane.
    sigma : (v,) float64, metres
        Noise of their points across planes.
    """
    toward = -np.sign((voxels.normal * voxels.centre).sum(axis=1))
    normal = voxels.normal * toward[:, None]
    planes = np.column_stack([normal, (normal * voxels.centre).sum(axis=1)])
    may = flat & (voxels.thickness < REACH * sigma)
    points = np.maximum(voxels.moments[:, 0], 1)
    reach = REACH * sigma * np.sqrt(1 / points + 0.25)
    # The flattest first, relative to the noise.
    seeds = np.flatnonzero(may)[np.argsort((voxels.thickness / sigma)[may], kind="stable")]
    label, found, grown = _regions(seeds, planes[seeds], voxels, normal, may.copy(), reach)
    # Then the largest first: a bent part of a plane that grew before it is taken back.
    order = np.argsort(-np.bincount(label[label >= 0], minlength=len(found)), kind="stable")
    seeds = np.concatenate([found[order], seeds])
    planes = np.concatenate([grown[order], planes[seeds[len(found) :]]])
    return _regions(seeds, planes, voxels, normal, may, reach)[0]


def _regions(
    seeds: Ints, planes: Floats, voxels: Voxels, normal: Floats, may: Bools, reach: Floats
) -> tuple[Ints, Ints, Floats]:
    """Grow planes (s, 4) from seeds (s,) in this order, over voxels that may belong to one.

    Returns
    -------
    label : (v,) int64
        The region of each voxel, -1 for none.
    seeds : (r,) int64, planes : (r, 4) float64
        Of the regions.
    """
    from relmap.segmentation.space.growing_kernels import grow

    label, queue = np.full(len(may), -1), np.empty(len(may), dtype=np.int64)
    found: list[int] = []
    fitted: list[Floats] = []
    for seed, plane in zip(seeds.tolist(), planes, strict=True):
        if label[seed] >= 0 or not may[seed]:
            continue
        size, mine, plane = 0, queue[:0], np.append(plane, TURN)
        for _ in range(REGROWN):
            label[mine] = -1
            rest = voxels.around, voxels.centre, normal, may, label, queue
            count = grow(seed, len(found), plane, reach, *rest)
            mine = queue[:count].copy()
            if count <= 1.1 * size or count < FEWEST_VOXELS:
                break
            size = count
            plane[:4] = planes_of(voxels.moments[mine].sum(axis=0)[None])[0]
        if count < FEWEST_VOXELS:
            label[mine] = -1
            may[seed] = False
        else:
            found.append(seed)
            fitted.append(plane[:4])
    return label, np.array(found, dtype=np.int64), np.array(fitted).reshape(-1, 4)


def joined(sums: Floats, noise: Floats) -> Ints:
    """Return the number (m + 1,) of each plane after joining the same ones; the last is -1.

    Parameters
    ----------
    sums : (m, 10) float64
        Moments of their points; changed.
    noise : (m,) float64
        Mean square of the noise of each plane; changed.
    """
    own = np.arange(len(sums))
    for a, b in _alike(sums, noise).tolist():
        a, b = own[a], own[b]
        if a == b:
            continue
        pair = sums[[a, b]]
        plane = planes_of(pair.sum(axis=0)[None])[0]
        thin = np.maximum(noise[[a, b]], ALIKE**-2 * principal(pair)[1][:, 0])
        if (_square_off(pair, plane) < ALIKE**2 * thin).all():
            a, b = min(a, b), max(a, b)
            own[own == b] = a
            noise[a] = (noise[[a, b]] * sums[[a, b], 0]).sum() / sums[[a, b], 0].sum()
            sums[a] += sums[b]
    return np.append(np.unique(own, return_inverse=True)[1], -1)


def _square_off(moments: Floats, plane: Floats) -> Floats:
    """Return the mean square distance (m,) of points, known by their moments, from a plane."""
    x, y, z, d = plane
    products = np.array([x * x, 2 * x * y, 2 * x * z, y * y, 2 * y * z, z * z])
    ahead = moments[:, 1:4] @ plane[:3]
    return np.asarray((moments[:, 4:] @ products - 2 * d * ahead) / moments[:, 0] + d * d)


def _alike(sums: Floats, noise: Floats) -> Ints:
    """Return the pairs (p, 2) of planes that may be the same, those with most points first."""
    planes, centre = planes_of(sums), sums[:, 1:4] / sums[:, :1]
    off = np.abs(centre @ planes[:, :3].T - planes[:, 3])
    near = off < REACH * np.sqrt(noise[:, None] + noise)
    pairs = np.argwhere(np.triu((planes[:, :3] @ planes[:, :3].T > PARALLEL) & near & near.T, 1))
    return pairs[np.argsort(-sums[pairs, 0].sum(axis=1), kind="stable")]
