"""The planes of one scan in space, condensed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints, Singles


@dataclass(frozen=True, eq=False)
class Patches:
    """Planes of any direction seen in one scan, without their points: m planes, robot frame.

    The weighted sum of squared distances of a patch's points from any plane follows from
    `centre`, `axes` and `information`. For a plane with unit normal n at distance d from the
    centre it is, up to a constant, ``information @ [(n @ u) ** 2, (n @ v) ** 2, d ** 2]``. This is
    the 4x4 scatter of the points in the frame of the patch (as in BALM, Z. Liu and F. Zhang,
    RA-L 2021).

    Attributes
    ----------
    centre : (m, 3) float64, metres
        Weighted mean of the points.
    axes : (m, 3, 3) float64
        Rows u, v, n: the directions of largest, middle and smallest spread; right-handed. n is the
        normal and points to the sensor.
    information : (m, 3) float64
        1 / rad^2 of the tilt along u and along v, 1 / m^2 of the distance across.
    spread : (m, 3) float64, metres
        Standard deviation of the points along u, v and n.
    n_points : (m,) int64
    cells : (c, 3) float64, metres
        Positions of the points on the planes, about one per voxel.
    cell_patch : (c,) int64, ascending
        The patch of each cell.
    cell_m : float
        Size of the voxels.
    reach_m : float
        Median distance of the cells from the origin.
    loose : (k, 3) float64, metres
        Points on no plane, and on planes much thicker than the noise, thinned.
    rim : (r, 3) float64, metres
        Points just beyond the patches, in their planes, that scans saw through.
    rim_patch : (r,) int64
        The patch of each.
    ends : (e, 3) float32, metres
        Where the rays of the scan ended, on planes or not, about one per voxel.
    is_new : (e,) bool
        Which of these rays the scan before did not have: where the sensor stands still, a plane is
        looked at once.
    """

    centre: Floats
    axes: Floats
    information: Floats
    spread: Floats
    n_points: Ints
    cells: Floats
    cell_patch: Ints
    cell_m: float
    reach_m: float
    loose: Floats = field(default_factory=lambda: np.empty((0, 3)))
    rim: Floats = field(default_factory=lambda: np.empty((0, 3)))
    rim_patch: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    ends: Singles = field(default_factory=lambda: np.empty((0, 3), dtype=np.float32))
    is_new: Bools = field(default_factory=lambda: np.empty(0, dtype=np.bool_))

    def __len__(self) -> int:
        return len(self.n_points)

    @property
    def normal(self) -> Floats:
        """Unit normals (m, 3), pointing to the sensor."""
        return np.asarray(self.axes[:, 2])

    @property
    def offset(self) -> Floats:
        """Offsets (m,), metres, at most 0: ``normal @ x == offset`` on a plane."""
        return np.asarray(np.einsum("ij,ij->i", self.normal, self.centre))

    @property
    def scatter(self) -> Floats:
        """Scatters (m, 4, 4): ``[n, -d] @ S @ [n, -d]`` is the sum of squares of a plane (n, d)."""
        weight = self.information[:, 2]
        moment = (self.axes.transpose(0, 2, 1) * self.spread[:, None] ** 2) @ self.axes
        scatter = np.empty((len(self), 4, 4))
        c = self.centre
        scatter[:, :3, :3] = moment + c[:, :, None] * c[:, None]
        scatter[:, :3, 3] = scatter[:, 3, :3] = c
        scatter[:, 3, 3] = 1.0
        return np.asarray(weight[:, None, None] * scatter)


def reach_of(cells: Floats) -> float:
    """Return the median distance of cells (c, 3) from the origin; 0 if there are none."""
    return float(np.median(np.linalg.norm(cells, axis=1))) if len(cells) else 0.0


def no_patches(cell_m: float) -> Patches:
    """Return the patches of a scan without planes."""
    none = np.empty((0, 3))
    number: Ints = np.empty(0, dtype=np.int64)
    return Patches(none, np.empty((0, 3, 3)), none, none, number, none, number, cell_m, 0.0)
