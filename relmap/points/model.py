"""Points as landmarks: three define a consistent basis, two in the plane (section III)."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association import Constellation, NearestPrevious, Registration
from relmap.core.config import MapperConfig
from relmap.core.state.store import POINTS, Rows, Shown, shown_points
from relmap.core.state.table import LandmarkState
from relmap.points.basis import relative_map


class PointModel:
    """The point model for the engine; see `relmap.core.model.LandmarkModel`."""

    columns = POINTS
    keeps_observations = False
    noise_spread = 1.0
    position_spread = 1.0
    drift_m = None

    def association(self, config: MapperConfig) -> Registration:
        """Return the association of scans without ids."""
        if config.registration == "nearest-previous":
            return NearestPrevious(config.gate_m)
        return Constellation(config.max_missed)

    def rows(self, seen: Floats, landmarks: Ints) -> Rows:
        """Return the stored columns of the identified points (n, d) of one scan."""
        known = landmarks >= 0
        return {"landmark": landmarks[known], "location": seen[known]}

    def points(self, rows: Rows) -> Shown:
        """Return the observed points unchanged."""
        return shown_points(rows)

    def average_in_basis(self, block: Floats) -> Floats | None:
        """Average a group's locations (g, i, d) in the basis of three of its points (Fig. 8)."""
        return relative_map(block)

    def min_shared(self, dimension: int) -> int:
        """Return the minimum number of mapped points that determine the pose of a group."""
        return dimension

    def is_compared(self, landmarks: Ints) -> Bools:
        """Return which points (n,) are compared with older ones: all of them."""
        return np.ones(len(landmarks), dtype=bool)

    def may_be(self, table: LandmarkState, new: int, old: int) -> bool:
        """Return that any point may be an older one."""
        return True
