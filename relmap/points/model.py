"""Points as landmarks: three define a consistent basis, two in the plane (section III)."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association import Constellation, NearestPrevious, Registration
from relmap.core.config import MapperConfig
from relmap.core.state.store import POINTS, Rows, Shown, shown_points
from relmap.core.state.table import LandmarkState


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
        if len(landmarks) and landmarks[landmarks.argmin()] < 0:
            known = landmarks >= 0
            landmarks, seen = landmarks[known], seen[known]
        return {"landmark": landmarks, "location": seen}

    def points(self, rows: Rows) -> Shown:
        """Return the observed points unchanged."""
        return shown_points(rows)

    def average_in_basis(self, block: Floats) -> Floats | None:
        """Average a group's locations in its consistent basis (section III, Fig. 8).

        B0 is the point farthest from the centre, B1 the farthest from B0, and in space B2 the
        farthest from the line through both. B0 is the origin, B1 lies on the negative x axis, and
        in space B2 in the xz plane, at positive z.

        `block` (g, i, d), robot frame, metres: every member seen in every iteration. Returns
        (g, d), group frame, metres, or None if the group determines no basis.
        """
        import relmap.points.basis_kernels as kernels

        mean, is_determined = kernels.average_in_basis(block)
        return mean if is_determined else None

    def min_shared(self, dimension: int) -> int:
        """Return the minimum number of mapped points that determine the pose of a group."""
        return dimension

    def least_noise_m(self, rows: Rows) -> float:
        """Return that nothing is known of the noise."""
        return 0.0

    def compared(self, landmarks: Ints) -> Ints:
        """Return those of points (n,) that are compared with older ones: all of them."""
        return landmarks

    def may_be(self, table: LandmarkState, new: Ints, old: Ints) -> Bools:
        """Return which points (n,) may be older ones (n,): all of them."""
        return np.ones(len(new), dtype=bool)
