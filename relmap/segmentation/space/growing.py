"""Planes grown over flat voxels, joined where they are the same within the noise, and condensed.

Noise moves points along their rays. Where two planes meet it moves points of one to the other, and
in every scan to the same side of it, so that no number of scans averages it away. Whether a ray
passes both planes within the noise depends on its direction only, which is exact. So does the place
where it meets its plane, and the noise at this range: with measured ranges instead, points that are
too near count more, and oblique planes are tilted.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.space.voxels import Voxels, moments_of, principal

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
APART = 2.0
"""A ray distinguishes two planes if it meets them farther apart than this many standard deviations
of each."""
MOST = 0.5
"""If fewer than this fraction of the points of a plane are of no other, all of them count."""


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

    `flat` (v,): voxels that may belong to a plane; `sigma` (v,), metres: noise of their points
    across planes.
    """
    from relmap.segmentation.space.growing_kernels import grow_regions

    toward = -np.sign((voxels.normal * voxels.centre).sum(axis=1))
    normal = voxels.normal * toward[:, None]
    planes = np.column_stack([normal, (normal * voxels.centre).sum(axis=1)])
    may = flat & (voxels.thickness < REACH * sigma)
    points = np.maximum(voxels.moments[:, 0], 1)
    reach = REACH * sigma * np.sqrt(1 / points + 0.25)
    # The flattest first, relative to the noise.
    seeds = np.flatnonzero(may)[np.argsort((voxels.thickness / sigma)[may], kind="stable")]
    connected = voxels.moments, reach, voxels.around, voxels.centre, normal
    label = np.full(len(may), -1)
    found, grown = grow_regions(seeds, planes[seeds], connected, may.copy(), label)
    # Then the largest first: a bent part of a plane that grew before it is taken back.
    order = np.argsort(-np.bincount(label[label >= 0], minlength=len(found)), kind="stable")
    seeds = np.concatenate([found[order], seeds])
    planes = np.concatenate([grown[order], planes[seeds[len(found) :]]])
    label[:] = -1
    grow_regions(seeds, planes, connected, may, label)
    return label


def joined(sums: Floats, noise: Floats) -> Ints:
    """Return the number (m + 1,) of each plane after joining the same ones; the last is -1.

    `sums` (m, 10): moments of their points; changed. `noise` (m,): mean square of the noise of each
    plane; changed.
    """
    from relmap.segmentation.space.growing_kernels import join_same

    own = np.arange(len(sums))
    planes, centre = planes_of(sums), sums[:, 1:4] / sums[:, :1]
    off = np.abs(centre @ planes[:, :3].T - planes[:, 3])
    near = off < REACH * np.sqrt(noise[:, None] + noise)
    pairs = np.argwhere(np.triu((planes[:, :3] @ planes[:, :3].T > PARALLEL) & near & near.T, 1))
    pairs = pairs[np.argsort(-sums[pairs, 0].sum(axis=1), kind="stable")]  # most points first
    join_same(pairs, sums, noise, own)
    return np.append(np.unique(own, return_inverse=True)[1], -1)


def condensed(
    points: Floats, label: Ints, noise_m: Floats, cell_m: float
) -> tuple[Floats, Floats, Ints]:
    """Return the weighted moments (m, 10) of planes about their middles, and these (m, 3).

    `label` (n,): the plane of each point (n, 3), -1 for none; `noise_m` (n,), metres: noise across
    planes, which gives the weights. A plane reaches `cell_m` beyond its points. Returns also the
    numbers (m,) of points that count.
    """
    from relmap.segmentation.space.cloud_kernels import range_errors, slid, undecided

    count = int(label.max(initial=-1)) + 1
    moments = moments_of(points, label, count, noise_m)
    planes, axes = planes_of(moments), principal(moments)[2]
    mixed = undecided(points, label, noise_m, planes, axes, cell_m)
    most = MOST * np.bincount(label[label >= 0], minlength=count)
    enough = np.bincount(label[(label >= 0) & ~mixed], minlength=count) >= most
    label = np.where(mixed & np.append(enough, False)[label], -1, label)
    at = slid(points, label, planes, range_errors(points, label, planes))
    number = np.bincount(label[label >= 0], minlength=count)
    # About their own mean, so that rounding errors do not grow with the range.
    middle = moments_of(at, label, count)[:, 1:4] / number[:, None]
    return moments_of(at, label, count, noise_m, middle), middle, number
