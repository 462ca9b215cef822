"""Voxels of a cloud: the plane of the points of each, and their noise."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.scan import TINY

FEWEST = 6
"""Minimum number of points of a voxel that define a plane."""
FLAT, WIDE = 0.12, 0.1
"""Largest thickness of the points of a flat voxel, as a fraction of four times their width, and
minimum width, as a fraction of its size. Noise is estimated, and planes grow, from flat voxels."""
QUANTILE = 0.7
"""Quantile of the thickness of flat voxels that is the noise: surfaces are rough, and ranges have
steps."""
BINS = 8
"""Number of ranges at which the noise is estimated."""
ROUNDING = 1e-6
"""Noise below this fraction of the range is rounding, as of float32."""
GRAZING = 0.3
"""Minimum fraction of the noise along a ray that is across a plane: directions have errors, too."""
NEAR = 0.1
"""Voxels have the same size below this fraction of the median range."""
AROUND = np.array([a for a in itertools.product((-1, 0, 1), repeat=3) if any(a)])
BITS = 21
"""Bits of the key of a voxel for each axis."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """The v voxels of one scan.

    `of` (n,): the voxel of each point. `around` (v, 26): the neighbours of each; -1 for none.
    `moments` (v, 10): number, sum and sums of products (xx, xy, xz, yy, yz, zz) of its points.
    `centre`, `normal` (v, 3); `thickness`, `width` (v,), metres: standard deviations of its points
    in the directions of smallest and middle spread. These and the normal are 0 where the points are
    too few. `range_m` (v,); `size_m` (v,).
    """

    of: Ints
    around: Ints
    moments: Floats
    centre: Floats
    normal: Floats
    thickness: Floats
    width: Floats
    range_m: Floats
    size_m: Floats

    @property
    def flat(self) -> Bools:
        """Which voxels (v,) probably hold points of one plane only."""
        enough = (self.moments[:, 0] >= FEWEST) & (self.width > WIDE * self.size_m)
        return np.asarray(enough & (self.thickness < FLAT * 4 * self.width))

    @property
    def steepness(self) -> Floats:
        """Fraction of an error along the ray that is across the plane of each voxel (v,)."""
        along = np.abs((self.normal * self.centre).sum(axis=1))
        return np.asarray(np.maximum(along / np.maximum(self.range_m, TINY), GRAZING))

    def noise(self, flat: Bools) -> tuple[Floats, Floats]:
        """Return ranges and the noise along rays at these, ascending; both (b,), metres."""
        range_m, thick = self.range_m[flat], self.thickness[flat] / self.steepness[flat]
        if not len(range_m):
            return np.ones(1), np.ones(1)
        order = np.argsort(range_m, kind="stable")
        parts = np.array_split(order, min(BINS, max(len(order) // 20, 1)))
        at = np.array([_quantile(range_m[part], 0.5) for part in parts])
        sigma = np.array([_quantile(np.sort(thick[part]), QUANTILE) for part in parts])
        return at, np.maximum.accumulate(np.maximum(sigma, ROUNDING * at + TINY))


def _quantile(values: Floats, q: float) -> float:
    """Return a quantile of ascending values, interpolated; numpy's takes longer for few values."""
    place = q * (len(values) - 1)
    low, high = values[int(place)], values[min(int(place) + 1, len(values) - 1)]
    return float(low + (high - low) * (place % 1))


def cells_of(points: Floats, range_m: Floats, size_m: float, middle_m: float) -> tuple[Ints, Ints]:
    """Return the keys (v,), ascending, of the voxels of points (n, 3), and the voxel (n,) of each.

    Their size grows with the square root of the range, because the spacing of points and the noise
    grow; `size_m` is the size at the median range.
    """
    from relmap.segmentation.space.cloud_kernels import numbered_cells

    keys, of = numbered_cells(points, range_m, size_m, middle_m)
    order = np.argsort(keys)
    number = np.empty(len(keys), dtype=np.int64)
    number[order] = np.arange(len(keys))
    return keys[order], number[of]


def voxels_of(points: Floats, keys: Ints, of: Ints, size_m: float, middle_m: float) -> Voxels:
    """Return the voxels of points (n, 3), robot frame, metres; see `cells_of`."""
    from relmap.segmentation.space.cloud_kernels import neighbours

    around = neighbours(keys, AROUND @ np.array([1 << (2 * BITS), 1 << BITS, 1]))
    moments = moments_of(points, of, len(keys))
    n = moments[:, 0]
    centre, spread = moments[:, 1:4] / n[:, None], np.zeros((len(keys), 3))
    normal, full = np.zeros((len(keys), 3)), n >= FEWEST
    _, spread[full], axes = principal(moments[full])
    normal[full] = axes[:, 0]
    # A fitted plane has three degrees of freedom.
    scale = np.sqrt(n / np.maximum(n - 3, 1))
    thickness, width = np.sqrt(spread[:, 0]) * scale, np.sqrt(spread[:, 1])
    away = np.linalg.norm(centre, axis=1)
    size = size_m * np.sqrt(np.maximum(away / middle_m, NEAR))
    return Voxels(of, around, moments, centre, normal, thickness, width, away, size)


def uniform_voxels(points: Floats, size_m: float) -> Voxels:
    """Return voxels of one size of points (n, 3) in any frame."""
    keys, of = cells_of(points, np.ones(len(points)), size_m, 1.0)
    voxels = voxels_of(points, keys, of, size_m, 1.0)
    return replace(voxels, size_m=np.full(len(keys), size_m))


def moments_of(
    points: Floats, of: Ints, count: int, sigma: Floats | None = None, middle: Floats | None = None
) -> Floats:
    """Return the moments (count, 10) of points (n, 3) by group; see `Voxels`.

    They are weighted by the noise (n,) of the points, and about a middle (count, 3) of each group,
    if these are given.
    """
    from relmap.segmentation.space.growing_kernels import add_moments

    moments = np.zeros((count, 10))
    add_moments(points, of, sigma, middle, moments)
    return moments


def principal(moments: Floats) -> tuple[Floats, Floats, Floats]:
    """Return centres (v, 3), variances (v, 3), ascending, and their axes (v, 3, 3), as rows."""
    centre = moments[:, 1:4] / moments[:, :1]
    second = moments[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3) / moments[:, :1, None]
    spread, axes = np.linalg.eigh(second - centre[:, :, None] * centre[:, None])
    return centre, np.maximum(spread, 0.0), axes.transpose(0, 2, 1)
