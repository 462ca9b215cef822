"""relmap itself: refined, not refined, and as the paper has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.methods.base import NO_MAP, Method, MethodInfo
from relmap.core.association import NearestPrevious, Registration
from relmap.core.config import MapperConfig
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.core.landmarks import LandmarkMap
from relmap.datasets.scans import SensorView
from relmap.evaluation.run import AnyMapper, segment_scan, segmenter_for
from relmap.planes import PlaneMapper
from relmap.planes.pairwise import pairwise_map
from relmap.planes.table import PlaneTable
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


class Relmap(Method):
    """A mapper of points.

    Parameters
    ----------
    mapper : PointMapper or PlaneMapper
        A fresh one.
    refine : bool
        Whether to refine the map at the end.
    """

    def __init__(self, mapper: AnyMapper, refine: bool) -> None:
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
        """The landmarks of the largest submap."""
        return self._mapper.map

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The poses, computed from the map."""
        return self._mapper.trajectory


class RelmapPlanes(Relmap):
    """A mapper of walls with its segmenter.

    Parameters
    ----------
    view : SensorView
        What is known of the sensor.
    refine : bool
        Whether to refine the map at the end.
    literal : bool
        Whether to take only who is who from the mapper and place the walls by `pairwise_map`.
    """

    def __init__(self, view: SensorView, refine: bool = False, literal: bool = False) -> None:
        self._walls = PlaneMapper()
        super().__init__(self._walls, refine)
        self._segmenter, self._view, self._literal = segmenter_for(view), view, literal

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Segment and map one scan; points are of no landmark, so every label is -1."""
        self._walls.update(segment_scan(self._segmenter, points_robot, self._view))
        return np.full(len(points_robot), -1, np.int64)

    def landmarks_of(self, labels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the labels: points are of no landmark."""
        return labels

    @property
    def map(self) -> LandmarkMap:
        """No landmarks: see `planes`."""
        return NO_MAP

    @property
    def planes(self) -> PlaneTable:
        """The walls, in the mapper's map frame."""
        table = self._walls.planes
        if not self._literal:
            return table
        history = self._walls.history
        placed = pairwise_map(history, int(history.plane.max(initial=-1)) + 1)[table.plane]
        both = np.asarray(np.isfinite(placed + table.ends).all(axis=(1, 2)))
        status = np.where(both, table.status, "unmapped")
        source, target = placed[both].reshape(-1, 2), table.ends[both].reshape(-1, 2)
        if not fixes_rotation(source):
            return replace(table, status=np.full(len(status), "unmapped"))
        R, t = fit_rigid(source, target)
        ends = np.where(both[:, None, None], placed @ R.T + t, np.nan)
        return replace(table, ends=ends, status=status)


REFINED = MethodInfo(
    "relmap-points",
    "relmap, points, refined at the end",
    lambda setup: Relmap(PointMapper(), refine=True),
)
LIVE = MethodInfo(
    "relmap-points-live",
    "relmap, points, as the map stands when the log is over",
    lambda setup: Relmap(PointMapper(), refine=False),
)
LITERAL = MethodInfo(
    "relmap-points-paper",
    "relmap, points, the paper's settings: nearest of the previous iteration, no refinement",
    lambda setup: Relmap(PaperPointMapper(PAPER), refine=False),
)
REFINED_PLANES = MethodInfo(
    "relmap-planes",
    "relmap, walls, refined at the end",
    lambda setup: RelmapPlanes(setup.sensor, refine=True),
    logs=("scans",),
)
LIVE_PLANES = MethodInfo(
    "relmap-planes-live",
    "relmap, walls, as the map stands when the log is over",
    lambda setup: RelmapPlanes(setup.sensor),
    logs=("scans",),
)
LITERAL_PLANES = MethodInfo(
    "relmap-planes-paper",
    "relmap, walls, placed by the paper's recipe of pairs (Figs 1, 2 and 4)",
    lambda setup: RelmapPlanes(setup.sensor, literal=True),
    logs=("scans",),
)
