"""Segmentation of one scan into planes of any direction, grown from flat voxels and refitted.

Flat voxels are seeds. A plane grows over connected voxels that lie on it and is refitted as it
grows (Poppinga et al., IROS 2008; Feng et al., ICRA 2014). Planes that are the same within the
noise are joined. Each point is then assigned to the nearest plane in its voxel or its neighbours,
and planes are fitted to their points with a noise along the rays that grows with the range.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.scan import checked_points
from relmap.segmentation.space.growing import condensed, grown, joined, moments_by, planes_of
from relmap.segmentation.space.patches import Patches, no_patches, reach_of
from relmap.segmentation.space.voxels import Voxels, cells_of, moments_of, principal, voxels_of

VOXEL = 0.04
"""Size of a voxel, as a fraction of the median range."""
REFITS = 2
"""Number of refits of the planes to their points."""
SCALES = (1.0, 2.5, 5.0)
"""Sizes of voxels: larger ones find noisy or sparse planes in the points that are left."""
ROUGH = 2.0
"""Planes thicker than this multiple of the noise may be none: their points are kept, too."""
THIN = 1 / 5
"""Size of the voxels in which one of the points on no plane is kept, as a fraction of the usual."""
SPARSE, COARSER, COARSEST = 30, 1.5, 0.2
"""If voxels have fewer points in the median they are enlarged by this factor, up to a fraction of
the median range."""


class PatchSegmenter:
    """Finds planes of any direction in the points of a lidar or depth camera.

    Parameters
    ----------
    voxel_m : float, optional
        Size of the voxels at the median range; 4 % of the median range or more if omitted.
    min_points : int
        Minimum number of points of a plane.
    most : int
        Maximum number of planes of a scan; those with most points are kept.

    Raises
    ------
    RelmapError
        If a setting is out of range.

    Attributes
    ----------
    patches_ : Patches
        Planes of the last scan.
    labels_ : (n,) int64
        The plane of each of its points, -1 for none.
    noise_m_ : (n,) float64
        Standard deviation of each point across planes, as estimated.
    """

    patches_: Patches
    labels_: Ints
    noise_m_: Floats

    def __init__(self, voxel_m: float | None = None, min_points: int = 60, most: int = 60) -> None:
        if voxel_m is not None and not 0 < voxel_m < np.inf:
            raise RelmapError(f"voxel_m is {voxel_m}; it must be above 0")
        if min_points < 10 or most < 1:
            given = f"min_points is {min_points} and most is {most}"
            raise RelmapError(f"{given}; they must be at least 10 and 1")
        self.voxel_m = voxel_m
        self.min_points = min_points
        self.most = most

    def fit(self, points: ArrayLike) -> PatchSegmenter:
        """Find the planes of one scan.

        Parameters
        ----------
        points : (n, 3) array, sensor frame, metres

        Returns
        -------
        PatchSegmenter
            Itself.

        Raises
        ------
        RelmapError
            If the points are 2-D, or a coordinate is not finite.
        """
        points = checked_points(points, 0)
        if points.shape[1] != 3:
            raise RelmapError("points has 2 columns; planes in space need x, y and z")
        range_m = np.sqrt(np.einsum("ij,ij->i", points, points))
        self.labels_, self.noise_m_ = np.full(len(points), -1), np.ones(len(points))
        self.patches_, usual_m = no_patches(1.0), np.full(len(points), np.inf)
        left = np.flatnonzero(range_m > 0)
        if len(left) < self.min_points:
            return self
        middle_m = float(np.median(range_m[left]))  # rays without a return may end at the sensor
        cells, of = [np.empty((0, 3))], [np.empty(0, dtype=np.int64)]
        near, away = _rows(points, range_m, left)
        size_m, keys, of_points = self._cells(near, away, middle_m)
        for scale in SCALES:
            if scale != 1:
                near, away = _rows(points, range_m, left)
                keys, of_points = cells_of(near, away, scale * size_m, middle_m)
            voxels = voxels_of(near, keys, of_points, scale * size_m, middle_m)
            found, noise_m, labels = self._planes_in(near, away, voxels)
            first = int(self.labels_.max(initial=-1)) + 1
            usual_m[left] = np.minimum(usual_m[left], noise_m)
            self.noise_m_[left] = noise_m
            self.labels_[left] = np.where(found >= 0, first + found, -1)
            cells.append(voxels.centre[labels >= 0])
            of.append(first + labels[labels >= 0])
            left = left[found < 0]
            if len(left) < self.min_points:
                break
        self._condense(points, np.concatenate(cells), np.concatenate(of), size_m)
        thin = THIN * size_m, middle_m
        self.patches_ = replace(self.patches_, loose=self._loose(points, range_m, usual_m, thin))
        return self

    def _loose(
        self, points: Floats, range_m: Floats, usual_m: Floats, size: tuple[float, float]
    ) -> Floats:
        """Return points (k, 3) on no plane, or on one much thicker than the noise (n,), thinned.

        `size`: of the voxels in which one is kept, and the range at which it holds, metres.
        """
        mine, count = self.labels_ >= 0, self.patches_.n_points
        square = np.bincount(self.labels_[mine], usual_m[mine] ** 2, len(count))
        rough = self.patches_.spread[:, 2] > ROUGH * np.sqrt(square / count)
        left = np.flatnonzero((range_m > 0) & np.append(rough, True)[self.labels_])
        near, away = _rows(points, range_m, left)
        keys, of = cells_of(near, away, *size)
        first = np.empty(len(keys), dtype=np.int64)
        first[of[::-1]] = np.arange(len(of))[::-1]
        return near[first]

    def _cells(self, points: Floats, range_m: Floats, middle_m: float) -> tuple[float, Ints, Ints]:
        """Return a size of voxels with enough points in the median, and their `cells_of`."""
        size_m = self.voxel_m or VOXEL * middle_m
        while True:
            keys, of = cells_of(points, range_m, size_m, middle_m)
            larger_m, number = size_m * COARSER, np.bincount(of)
            enough = 2 * number[number >= SPARSE].sum() >= len(points)
            if self.voxel_m or enough or larger_m >= COARSEST * middle_m:
                return size_m, keys, of
            size_m = larger_m

    def _planes_in(
        self, points: Floats, range_m: Floats, voxels: Voxels
    ) -> tuple[Ints, Floats, Ints]:
        """Return the plane (n,) of each point, its noise (n,), and the plane (v,) of each voxel."""
        from relmap.segmentation.space.cloud_kernels import range_errors
        from relmap.segmentation.space.growing_kernels import label_points

        flat = voxels.flat
        noise = voxels.noise(flat)
        noise_m, sigma = np.interp(range_m, *noise), np.interp(voxels.range_m, *noise)
        sigma = sigma * voxels.steepness
        label = grown(voxels, flat, sigma)
        mine, number = label >= 0, voxels.moments[:, 0]
        sums = moments_by(voxels.moments, label)
        square = np.bincount(label[mine], (sigma**2 * number)[mine], len(sums))
        label = joined(sums, square / np.maximum(sums[:, 0], 1))[label]
        planes = planes_of(moments_by(voxels.moments, label))
        found, steepness = np.full(len(points), -1), np.ones(len(points))
        for _ in range(REFITS):
            if not len(planes):
                break
            around = voxels.of, noise_m, voxels.around
            label_points(points, *around, label, planes, found, steepness)
            keep = np.bincount(found + 1, minlength=len(planes) + 1)[1:] >= self.min_points
            name = np.append(np.where(keep, np.cumsum(keep) - 1, -1), -1)
            label, found = name[label], name[found]
            planes = planes_of(moments_of(points, found, int(keep.sum()), noise_m))
        error_m = range_errors(points, found, planes)
        noise_m = np.interp(range_m - error_m, *noise)
        return found, noise_m * np.where(found >= 0, steepness, 1.0), label

    def _condense(self, points: Floats, cells: Floats, cell_of: Ints, size_m: float) -> None:
        """Join planes that are the same, and set `labels_` and `patches_`, most points first."""
        count = int(self.labels_.max(initial=-1)) + 1
        mine = self.labels_ >= 0
        sums = moments_of(points, self.labels_, count)
        square = np.bincount(self.labels_[mine], self.noise_m_[mine] ** 2, count)
        own = joined(sums, square / np.maximum(sums[:, 0], 1))
        number = np.bincount(own[self.labels_[mine]], minlength=count)
        order = np.argsort(-number, kind="stable")
        order = order[number[order] > 0][: self.most]
        name = np.full(count + 1, -1)
        name[order] = np.arange(len(order))
        name = np.append(name[own[:-1]], -1)
        self.labels_, cell_of, number = name[self.labels_], name[cell_of], number[order]
        sums, middle, used = condensed(points, self.labels_, self.noise_m_, size_m)
        shift, variance, axes = principal(sums)
        weight, centre = sums[:, 0], middle + shift
        axes = axes[:, ::-1].copy()
        axes[:, 2] *= np.where((axes[:, 2] * centre).sum(axis=1) > 0, -1.0, 1.0)[:, None]
        axes[:, 0] = np.cross(axes[:, 1], axes[:, 2])
        variance = variance[:, ::-1]
        # The thickness of a plane is a better estimate of its noise than its range.
        expected = used / weight
        weight = weight * expected / np.maximum(variance[:, 2], 1e-2 * expected)
        tilt = weight[:, None] * (variance[:, :2] - variance[:, 2:])
        cells, cell_of = _cells(cells, cell_of, centre, axes[:, 2])
        information, spread = np.column_stack([tilt, weight]), np.sqrt(variance)
        reach_m = reach_of(cells)
        self.patches_ = Patches(
            centre, axes, information, spread, number, cells, cell_of, size_m, reach_m
        )


def _rows(points: Floats, range_m: Floats, rows: Ints) -> tuple[Floats, Floats]:
    """Return points (n, 3) and their ranges, not copied if all are chosen."""
    return (points, range_m) if len(rows) == len(points) else (points[rows], range_m[rows])


def _cells(cells: Floats, of: Ints, centre: Floats, normal: Floats) -> tuple[Floats, Ints]:
    """Return centres of voxels (c, 3) projected to their planes, and the planes (c,), ascending."""
    order = np.argsort(of, kind="stable")
    order = order[of[order] >= 0]
    at, of = cells[order], of[order]
    off = ((at - centre[of]) * normal[of]).sum(axis=1)
    return at - off[:, None] * normal[of], of
