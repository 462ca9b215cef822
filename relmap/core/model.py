"""What a kind of landmark supplies to the engine; `points` and `planes` each have a model."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from relmap.core.association.base import Registration
from relmap.core.config import MapperConfig
from relmap.core.state.store import Rows, Shown
from relmap.core.state.table import LandmarkState


class LandmarkModel(Protocol):
    """A kind of landmark, as far as the engine has to know it.

    The engine maps points at rest.  A model says what an observation holds (Fig. 3), which points
    it shows, how the observations of one iteration find those of the iterations before, and what
    basis is consistent.  Members are in the order in which a scan meets them.
    """

    def association(self, config: MapperConfig) -> Registration:
        """Return the association of scans without ids."""
        ...

    @property
    def columns(self) -> Rows:
        """What is stored of an observation: columns without rows.

        `landmark` (n,) or (n, k) int64, -1 for none; `location`, untransformed; and what else the
        kind of landmark has.
        """
        ...

    @property
    def keeps_observations(self) -> bool:
        """Whether observations are kept that no group needs any more."""
        ...

    def rows(self, seen: Any, found: NDArray[np.int64]) -> Rows:
        """Return what is stored of one scan.

        Parameters
        ----------
        seen : sequence of n observations
        found : (n,) int64
            Whom each is of, as the registration numbers them; negative where unknown.
        """
        ...

    def points(self, rows: Rows) -> Shown:
        """Return the points that stand for landmarks, as stored rows show them."""
        ...

    def average_in_basis(self, block: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Average a group's locations in its consistent basis (Figs 1, 2 and 8).

        Parameters
        ----------
        block : (g, i, d) float64, robot frame, metres
            Every member seen in every iteration.

        Returns
        -------
        (g, d) float64, group frame, metres, or None where the group fixes no basis
        """
        ...

    def min_shared(self, dimension: int) -> int:
        """Return how few mapped points fix a group."""
        ...

    @property
    def noise_spread(self) -> float:
        """How many times noisier than the typical point the noisiest are."""
        ...

    def is_compared(self, landmarks: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which points (n,) are compared with older ones when they are seen again; (n,)."""
        ...

    def may_be(self, table: LandmarkState, new: int, old: int) -> bool:
        """Tell whether nothing but the position speaks against a point being an older one."""
        ...

    @property
    def position_spread(self) -> float:
        """As `noise_spread`, of the positions by which such points are compared."""
        ...

    @property
    def drift_m(self) -> float | None:
        """How far the map may have drifted by then, metres; None goes by the points' spacing."""
        ...
