"""Walls as landmarks: a corner and its estimated midpoint are two static points."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.config import MapperConfig
from relmap.core.geometry.alignment import fixes_rotation
from relmap.core.geometry.robust import median
from relmap.core.state.store import Rows, Shown
from relmap.core.state.table import LandmarkState
from relmap.planes.linking.registration import PlaneRegistration
from relmap.planes.scans.corners import BLUNT
from relmap.planes.scans.observation import PlaneObservation

TURN = np.cos(np.deg2rad(20.0))
"""Largest rotation of a wall when it is seen again (cosine)."""


class WallModel:
    """The wall model for the engine; see `relmap.core.model.LandmarkModel`.

    Corner `k` is landmark `2 k`, its midpoint `2 k + 1`.

    `walls`: provides the wall end of each corner.
    """

    columns: ClassVar[Rows] = {
        "landmark": np.empty((0, 2), dtype=np.int64),
        "location": np.empty((0, 2, 2)),
        "wall": np.empty(0, dtype=np.int64),
        "corner": np.empty((0, 2), dtype=np.int64),
        "kind": np.empty((0, 2), dtype=np.int8),
        "sd": np.empty(0),
        "z_extent": np.empty((0, 2)),
    }
    """Columns of an observed wall: right and left end, untransformed; the landmark at either end
    used by the map, if any; the number of the wall, and of the corner at either end; the given end
    types; the standard deviation of its distance; its lowest and highest z."""
    keeps_observations = True
    noise_spread = 3.0
    position_spread = 2.0
    drift_m = 1.5

    def __init__(self, walls: PlaneRegistration) -> None:
        self._walls = walls

    def rows(self, seen: PlaneObservation, walls: Ints) -> Rows:
        """Return the stored columns of the walls of one scan, with these numbers (m,)."""
        return {
            "landmark": self._walls.landmark,
            "location": seen.ends,
            "wall": walls,
            "corner": self._walls.corner,
            "kind": seen.kind,
            "sd": seen.sd,
            "z_extent": seen.z_extent,
        }

    def points(self, rows: Rows) -> Shown:
        """Return the corners used by the map, and their estimated midpoints."""
        from relmap.planes.scans.corner_kernels import corners_and_midpoints

        walls = rows["landmark"], rows["corner"], rows["location"]
        return Shown(*corners_and_midpoints(*walls, self._walls.half))

    def association(self, config: MapperConfig) -> PlaneRegistration:
        """Return the association."""
        return self._walls

    def average_in_basis(self, block: Floats) -> Floats | None:
        """Average a group's locations in a basis invariant to rotation and translation.

        Every iteration is rotated so that the line through the two points farthest apart is at 0
        degrees, and then averaged (Fig. 1). If there is only one wall, the pair lies on it, as in
        Fig. 2; the larger the distance, the smaller the effect of noise on the rotation.

        `block` (g, i, 2), robot frame, metres: every member seen in every iteration. Returns
        (g, 2), group frame, metres, or None if the group determines no basis.
        """
        middle = block[:, block.shape[1] // 2]
        if not fixes_rotation(middle):
            return None
        apart = np.linalg.norm(middle[:, None] - middle, axis=2)
        first, second = np.unravel_index(np.argmax(apart), apart.shape)
        axis = block[second] - block[first]
        length = np.linalg.norm(axis, axis=1)
        fixed = length > 0  # two ends may coincide
        axis = axis[fixed] / length[fixed, None]
        relative = (block - block[first])[:, fixed]
        x = (relative * axis).sum(axis=2)
        y = relative[..., 1] * axis[:, 0] - relative[..., 0] * axis[:, 1]
        return np.stack([x.mean(axis=1), y.mean(axis=1)], axis=1)

    def min_shared(self, dimension: int) -> int:
        """Return the minimum number of mapped points per group: a corner and its midpoint."""
        return 2

    def least_noise_m(self, rows: Rows) -> float:
        """Return the usual noise of a corner along its wall, from that of the distances of walls.

        A corner and its midpoint keep their distance, and so do corners where two walls meet.
        """
        return BLUNT * median(rows["sd"]) if len(rows["sd"]) else 0.0

    def compared(self, landmarks: Ints) -> Ints:
        """Return those of points (n,) that are compared with older ones: corners.

        Midpoints are not: their distance from the corner differs between tracks.
        """
        return np.asarray(landmarks[landmarks % 2 == 0])

    def may_be(self, table: LandmarkState, new: Ints, old: Ints) -> Bools:
        """Return which corners (n,) may be older ones: same end, and a wall with its direction."""
        ends, one, other = self._walls.wall_end, new // 2, old // 2
        same = (ends[one] % 2 == ends[other] % 2) & (
            self._walls.submap_of(one) == self._walls.submap_of(other)
        )
        positions = table.position
        a, b = positions[new + 1] - positions[new], positions[old + 1] - positions[old]
        turned = (a * b).sum(axis=1) < TURN * np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
        return np.asarray(same & ~turned)  # an unmapped midpoint is not informative
