"""The interface that a kind of landmark implements for the engine (`points`, `planes`)."""

from __future__ import annotations

from typing import Any, Protocol

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import Registration
from relmap.core.config import MapperConfig
from relmap.core.state.store import Rows, Shown
from relmap.core.state.table import LandmarkState


class LandmarkModel(Protocol):
    """A kind of landmark, as the engine sees it.

    The engine maps static points. A model defines what an observation stores (Fig. 3), which points
    it shows, how observations are associated between iterations, and the consistent basis. Members
    are listed in the order in which they are used for a scan.
    """

    def association(self, config: MapperConfig) -> Registration:
        """Return the association of scans without ids."""
        ...

    @property
    def columns(self) -> Rows:
        """The stored columns of an observation, without rows.

        `landmark` (n,) or (n, k) int64, -1 for none; `location`, untransformed; and further columns
        of the kind of landmark.
        """
        ...

    @property
    def keeps_observations(self) -> bool:
        """Whether observations are kept after the last group that needs them."""
        ...

    def rows(self, seen: Any, found: Ints) -> Rows:
        """Return the columns to store for one scan.

        `seen`: sequence of n observations. `found` (n,): landmark of each observation, as numbered
        by the registration; negative if unknown.
        """
        ...

    def points(self, rows: Rows) -> Shown:
        """Return the points that represent landmarks, computed from stored rows."""
        ...

    def average_in_basis(self, block: Floats) -> Floats | None:
        """Average a group's locations in its consistent basis (Figs 1, 2 and 8).

        `block` (g, i, d), robot frame, metres: every member seen in every iteration. Returns
        (g, d), group frame, metres, or None if the group determines no basis.
        """
        ...

    def min_shared(self, dimension: int) -> int:
        """Return the minimum number of mapped points that determine the pose of a group."""
        ...

    @property
    def noise_spread(self) -> float:
        """Ratio of the largest to the typical noise of a point."""
        ...

    def least_noise_m(self, rows: Rows) -> float:
        """Return the least noise of the points of one scan, given its rows; 0 if unknown.

        Points computed from one observation keep their distances, whatever the noise.
        """
        ...

    def compared(self, landmarks: Ints) -> Ints:
        """Return those of points (n,) that are compared with older ones when re-observed."""
        ...

    def may_be(self, table: LandmarkState, new: Ints, old: Ints) -> Bools:
        """Return which points (n,) may be older ones (n,), judged by all but their positions."""
        ...

    @property
    def position_spread(self) -> float:
        """As `noise_spread`, for the positions used to compare re-observed points."""
        ...

    @property
    def drift_m(self) -> float | None:
        """Possible drift of the map by then, metres; None derives it from the points' spacing."""
        ...
