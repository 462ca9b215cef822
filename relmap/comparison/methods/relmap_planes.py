"""relmap's planes: refined, not refined, and the paper's literal recipe."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.methods.base import NO_MAP, Method, MethodInfo
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.core.landmarks import LandmarkMap
from relmap.datasets.scans import SensorView
from relmap.evaluation.plane_run import segment_scan, segmenter_for
from relmap.planes import PlaneMapper
from relmap.planes.pairwise import pairwise_map
from relmap.planes.table import PlaneTable

Recipe = Literal["refined", "live", "paper"]


class RelmapPlanes(Method):
    """A plane mapper with its segmenter.

    Parameters
    ----------
    recipe : "refined", "live" or "paper"
        ``paper`` takes who is who from the mapper and places the walls by `pairwise_map`.
    view : SensorView
        What is known of the sensor.
    """

    def __init__(self, recipe: Recipe, view: SensorView) -> None:
        self._mapper = PlaneMapper()
        self._segmenter = segmenter_for(view)
        self._view = view
        self._recipe = recipe

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Segment and map one scan; points are of no landmark, so every label is -1."""
        self._mapper.update(segment_scan(self._segmenter, points_robot, self._view))
        return np.full(len(points_robot), -1, np.int64)

    def finish(self) -> None:
        """Map what is left and refine, where that is wanted."""
        self._mapper.finish()
        if self._recipe == "refined":
            self._mapper.refine()

    @property
    def planes(self) -> PlaneTable:
        """The walls."""
        table = self._mapper.planes
        return self._literally(table) if self._recipe == "paper" else table

    def _literally(self, table: PlaneTable) -> PlaneTable:
        """Return the walls where the paper's recipe puts them, in the mapper's map frame."""
        history = self._mapper.history
        placed = pairwise_map(history, int(history.plane.max(initial=-1)) + 1)[table.plane]
        both = np.asarray(np.isfinite(placed + table.ends).all(axis=(1, 2)))
        status = np.where(both, table.status, "unmapped")
        source, target = placed[both].reshape(-1, 2), table.ends[both].reshape(-1, 2)
        if not fixes_rotation(source):
            return replace(table, status=np.full(len(status), "unmapped"))
        R, t = fit_rigid(source, target)
        return replace(
            table, ends=np.where(both[:, None, None], placed @ R.T + t, np.nan), status=status
        )

    @property
    def map(self) -> LandmarkMap:
        """No landmarks: see `planes`."""
        return NO_MAP

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The poses, computed from the map."""
        return self._mapper.trajectory


REFINED = MethodInfo(
    "relmap-planes",
    "relmap, walls, refined at the end",
    lambda setup: RelmapPlanes("refined", setup.sensor),
    logs=("scans",),
)
LIVE = MethodInfo(
    "relmap-planes-live",
    "relmap, walls, as the map stands when the log is over",
    lambda setup: RelmapPlanes("live", setup.sensor),
    logs=("scans",),
)
LITERAL = MethodInfo(
    "relmap-planes-paper",
    "relmap, walls, placed by the paper's recipe of pairs (Figs 1, 2 and 4)",
    lambda setup: RelmapPlanes("paper", setup.sensor),
    logs=("scans",),
)
