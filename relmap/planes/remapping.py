"""Mapping all scans again, with other motions into some of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.mapper import RelativeMapper
from relmap.planes.linking.registration import PlaneRegistration
from relmap.planes.model import WallModel
from relmap.planes.places.locating import LocatingMapper
from relmap.planes.scans.observation import seen_before
from relmap.planes.submaps.periods import periods_off

MENDED = 2
"""Maximum number of times that all scans are mapped again, as more steps are clear then."""


class RemappingMapper(LocatingMapper):
    """The part of `PlaneMapper` that maps scans, again if links are a period of the walls off."""

    def _model(self) -> WallModel:
        self._planes = PlaneRegistration(self.config.max_missed, self.config.bridge_m)
        return WallModel(self._planes)

    def _connect(self) -> None:
        """Let the links read what the engine stores."""
        self.engine.association.is_known = False
        self._planes.links.store = self.engine.store
        self._planes.links.wheels.given = self.engine.motions

    def _tie(self) -> None:
        """Tie submaps; replace links that are a period of the walls off."""
        self._planes.links.tie()
        for _ in range(MENDED):
            if not (instead := periods_off(self._planes.links)):
                break
            self._map_again(instead)
            self._planes.links.tie()

    def _map_again(self, instead: dict[int, Floats]) -> None:
        """Map all scans again, with these motions (3,) into some of them.

        The walls that such scans have in common with those before are others then, and so are all
        groups that they are in.
        """
        old, store = self._planes, self.engine.store
        self._engine = RelativeMapper(self._model(), self.config)
        self._connect()
        links, beams = self._planes.links, old.links.beams
        links.instead, self._planes.n_planes = old.links.instead | instead, old.n_planes
        for scan in range(len(old.links)):
            seen = replace(seen_before(store, scan), beams=beams.given(scan))
            self._engine.update(seen, None)
        links.beams = beams  # also those of clouds
        self._planes.follow(old, store)
        self._refined_walls = None
        self._moved = np.empty(0, dtype=np.int64)
