"""The planes of one scan, as a segmenter returns them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.shown import Table

END_TYPES = ("corner", "view", "range", "occluded")
"""End types in order of precedence: the first that applies is used."""


@dataclass(frozen=True, eq=False, repr=False)
class Planes(Table):
    """Vertical planes seen in one scan: robot frame, metres; m planes.

    The two ends are the vertical edges, from right to left as the wall is seen from the sensor.

    Attributes
    ----------
    midpoint : (m, 3) or (m, 2) float64
        With as many columns as the points.
    normal : (m, 2) float64
        Unit, horizontal, pointing to the sensor.
    ends : (m, 2, 2) float64
        x, y of the right and the left end.
    size : (m,) float64
        Distance between the ends.
    z_extent : (m, 2) float64
        Lowest and highest z; 0 if the points have none.
    noise : (m,) float64
        Root mean square distance of its points.
    n_points : (m,) int64
    end_type : (m, 2) str
        One of `END_TYPES`: a true end, cut by the edge of the view, by the range, or hidden.
    """

    midpoint: Floats
    normal: Floats
    ends: Floats
    size: Floats
    z_extent: Floats
    noise: Floats
    n_points: Ints
    end_type: NDArray[np.str_]


def make_planes(
    points: Floats, labels: Ints, ends: Floats, end_type: NDArray[np.str_], sigma: float
) -> Planes:
    """Compute planes from labelled points.

    `points` (n, 2) or (n, 3), robot frame, metres. `labels` (n,): plane of each point, -1 for none;
    every plane has points. `ends` (m, 2, 2): x, y of the right and the left end of each. `end_type`
    (m, 2); `sigma`: noise, metres.
    """
    m, own = len(ends), (labels >= 0).nonzero()[0]
    along = ends[:, 1] - ends[:, 0]
    size = np.hypot(along[:, 0], along[:, 1])
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / size[:, None]
    middle, at = ends.mean(axis=1), labels[own]
    # `take`, as rows by index take ten times as long.
    off = points[:, :2].take(own, axis=0) - middle.take(at, axis=0)
    direction = normal.take(at, axis=0)
    across = off[:, 0] * direction[:, 0] + off[:, 1] * direction[:, 1]
    n_points = np.bincount(at, minlength=m)
    squares = np.bincount(at, weights=across**2, minlength=m)
    z_extent = np.zeros((m, 2))
    if points.shape[1] == 3:
        from relmap.segmentation.ends.end_kernels import box_extent

        order = np.argsort(at, kind="stable")
        parts = np.split(points[own, 2][order], np.cumsum(n_points)[:-1]) if m else []
        # The ends of a blurred box, as along the wall.
        z_extent = np.array([box_extent(part, sigma) for part in parts]).reshape(m, 2)
        middle = np.column_stack([middle, z_extent.mean(axis=1)])
    noise = np.sqrt(squares / n_points)
    return Planes(middle, normal, ends, size, z_extent, noise, n_points, end_type)
