"""Merging the corners of walls that were lost and seen again (section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.globalmap import GlobalMap
from relmap.core.merging import Merger
from relmap.core.sightings import Sightings
from relmap.core.spatialindex import SpatialIndex
from relmap.planes.registration import PlaneRegistration

REACH_M = 1.5
"""How far the map may have drifted."""
TURN = np.cos(np.deg2rad(20.0))
"""How far, at most, a wall may have turned by that (cosine)."""
BLUR = 2.0
"""How much less sure corners are than the typical landmark."""


class CornerMerger(Merger):
    """Finds which corners in view are old ones: at the same end of a wall that looks the same way.

    The midpoints stay apart: each is at a distance of its own from the corner.

    Parameters
    ----------
    global_map, sightings, mature
        As for `Merger`.
    planes : PlaneRegistration
        Knows which end of a wall each corner is.
    """

    def __init__(
        self,
        global_map: GlobalMap,
        sightings: Sightings,
        mature: int,
        planes: PlaneRegistration,
    ) -> None:
        super().__init__(global_map, sightings, mature)
        self._planes = planes

    def leave(self, landmarks: NDArray[np.int64]) -> None:
        """Note that corners have left the view: from now on they may be seen again."""
        super().leave(landmarks[landmarks % 2 == 0])

    def find(
        self, landmarks: NDArray[np.int64], levels: NDArray[np.int64], noise_m: float
    ) -> NDArray[np.int64]:
        """Return pairs (k, 2) of corners: a new one, and the old one that it is."""
        corners = landmarks % 2 == 0
        return super().find(landmarks[corners], levels[corners], BLUR * noise_m)

    def _begun(self, landmarks: NDArray[np.int64]) -> SpatialIndex | None:
        return SpatialIndex(REACH_M, self._map.positions.shape[1])

    def _may_be(self, new: int, old: int) -> bool:
        """Tell whether a corner may be an older one: the same end of a wall with its direction."""
        corners = self._planes.chosen[[new // 2, old // 2]]
        ends, submaps = self._planes.wall_end[corners], self._planes.submap_of[corners]
        if ends[0] % 2 != ends[1] % 2 or submaps[0] != submaps[1]:
            return False
        if not super()._may_be(new, old):
            return False
        positions = self._map.positions
        a, b = positions[new + 1] - positions[new], positions[old + 1] - positions[old]
        # A midpoint that is not mapped tells nothing.
        return not a @ b < TURN * np.sqrt((a @ a) * (b @ b))
