"""relmap's points: refined, not refined, and with the paper's literal settings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.methods.base import Method, MethodInfo
from relmap.core.association import NearestPrevious, Registration
from relmap.core.config import MapperConfig
from relmap.core.landmarks import LandmarkMap
from relmap.points.mapper import PointMapper
from relmap.points.model import PointModel

PAPER = MapperConfig(max_missed=0, refine_live=False)
"""As sections II and III have it: gone once missed, and not refined on the way."""


class PaperPointModel(PointModel):
    """Where no ids are given, scans are matched to the previous iteration alone."""

    def association(self, config: MapperConfig) -> Registration:
        """Return the paper's matching."""
        return NearestPrevious(None)


class PaperPointMapper(PointMapper):
    """Maps points as the paper does."""

    def _model(self) -> PointModel:
        return PaperPointModel()


class RelmapPoints(Method):
    """A point mapper.

    Parameters
    ----------
    mapper : PointMapper
        A fresh one.
    refine : bool
        Whether to refine the map at the end.
    """

    def __init__(self, mapper: PointMapper, refine: bool) -> None:
        self._mapper = mapper
        self._refine = refine

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Map one scan; see `Method.update`."""
        return self._mapper.update(points_robot, ids)

    def finish(self) -> None:
        """Map what is left and refine, where that is wanted."""
        self._mapper.finish()
        if self._refine:
            self._mapper.refine()

    def landmarks_of(self, labels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return what landmarks are called now; see `PointMapper.landmarks_of`."""
        return self._mapper.landmarks_of(labels)

    @property
    def map(self) -> LandmarkMap:
        """The landmarks of the largest piece."""
        return self._mapper.map

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The poses, computed from the map."""
        return self._mapper.trajectory


REFINED = MethodInfo(
    "relmap-points",
    "relmap, points, refined at the end",
    lambda setup: RelmapPoints(PointMapper(), refine=True),
)
LIVE = MethodInfo(
    "relmap-points-live",
    "relmap, points, as the map stands when the log is over",
    lambda setup: RelmapPoints(PointMapper(), refine=False),
)
LITERAL = MethodInfo(
    "relmap-points-paper",
    "relmap, points, the paper's settings: nearest of the previous iteration, no refinement",
    lambda setup: RelmapPoints(PaperPointMapper(PAPER), refine=False),
)
