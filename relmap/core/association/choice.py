"""Data association: by ids if the scans have them, else by the model's registration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import Registration
from relmap.core.association.known import KnownAssociation
from relmap.core.config import WITH_IDS, MapperConfig, changed, refuse
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.core.model import LandmarkModel


class DataAssociation:
    """Applies one registration to all scans, chosen at the first scan with observations.

    `registration`: None before the first observation.
    """

    STATE = "is_known _first_scan registration"

    def __init__(self, model: LandmarkModel, config: MapperConfig) -> None:
        self.registration: Registration | None = None
        self._first_scan = 0
        self._model = model
        self._config = config

    def choose(self, ids: Ints | None, iteration: int) -> None:
        """Choose the registration by the first non-empty scan; check those that follow.

        Raises `RelmapError` if ids come with some scans but not with others, or with settings for
        scans without.
        """
        if self.registration is None:
            if ids is not None:
                refuse(changed(self._config), WITH_IDS)
            self.is_known, self._first_scan = ids is not None, iteration
        if self.is_known != (ids is not None) or self.registration is None:
            given = "came with" if ids is None else "did not come with"
            raise RelmapError(f"ids {given} earlier scans; give them with every scan or none")

    def match(
        self,
        seen: Any,
        ids: Ints | None,
        motion: Floats | None = None,
        covariances: Floats | None = None,
    ) -> Ints:
        """Return the landmark of each observation (n,) of an iteration; negative if unknown.

        `seen`: sequence of n observations of the model's kind, robot frame; `ids` (n,): known
        association; `motion` (4, 4): odometry since the previous iteration; `covariances`
        (n, d, d): of the observations, robot frame, square metres.
        """
        if self.registration is None:
            return np.empty(0, dtype=np.int64)
        self.registration.inform(motion, covariances)
        return self.registration.match(seen, ids)

    @property
    def current(self) -> Registration:
        """The registration; before the first observation one that knows nothing."""
        return self.registration or Registration()

    @property
    def is_known(self) -> bool | None:
        """Whether ids come with the scans; None before the first scan."""
        registration = self.registration
        return None if registration is None else isinstance(registration, KnownAssociation)

    @is_known.setter
    def is_known(self, known: bool | None) -> None:
        if known is not None:
            own = self._model.association
            self.registration = KnownAssociation() if known else own(self._config)

    @property
    def has_ids(self) -> bool:
        """Whether the association is complete."""
        return self.is_known is not False

    @property
    def rejected(self) -> Ints:
        """Iterations (r,), ascending, whose scans match no other scan and do not enter the map."""
        return np.array(self.current.rejected, dtype=np.int64) + self._first_scan

    @property
    def overruled(self) -> Ints:
        """Iteration and row of each observation (r, 2) that was not assigned to its given id."""
        if not isinstance(self.registration, KnownAssociation):
            return np.empty((0, 2), dtype=np.int64)
        scans = np.array(self.registration.overruled_scans, dtype=np.int64) + self._first_scan
        return np.column_stack([scans, np.array(self.registration.overruled_rows, dtype=np.int64)])
