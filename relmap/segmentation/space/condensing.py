"""The points of each plane, condensed without those that may be of another plane.

Noise moves points along their rays. Where two planes meet it moves points of one to the other, and
in every scan to the same side of it, so that no number of scans averages it away. Whether a ray
passes both planes within the noise depends on its direction only, which is exact. So does the place
where it meets its plane, and the noise at this range: with measured ranges instead, points that are
too near count more, and oblique planes are tilted.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.segmentation.space.growing import planes_of
from relmap.segmentation.space.voxels import moments_of, principal

APART = 2.0
"""A ray distinguishes two planes if it meets them farther apart than this many standard deviations
of each."""
MOST = 0.5
"""If fewer than this fraction of the points of a plane are of no other, all of them count."""


def condensed(
    points: Floats, label: Ints, noise_m: Floats, cell_m: float
) -> tuple[Floats, Floats, Ints]:
    """Return the weighted moments (m, 10) of planes about their middles, and these (m, 3).

    `label` (n,): the plane of each point (n, 3), -1 for none; `noise_m` (n,), metres: noise across
    planes, which gives the weights. A plane reaches `cell_m` beyond its points. Returns also the
    numbers (m,) of points that count.
    """
    from relmap.segmentation.space.condensing_kernels import range_errors, slid, undecided

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
