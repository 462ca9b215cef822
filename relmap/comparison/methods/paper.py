"""relmap with the paper's settings, for comparison with the defaults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.association import NearestPrevious, Registration
from relmap.core.config import MapperConfig
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.planes import PlaneMapper
from relmap.planes.pairwise import pairwise_map
from relmap.planes.walls.table import PlaneTable
from relmap.points.mapper import PointMapper
from relmap.points.model import PointModel

PAPER = MapperConfig(max_missed=0, refine_live=False)
"""Settings of sections II and III: no missed iterations, no live refinement."""


class PaperPointModel(PointModel):
    """Without ids, scans are matched to the previous iteration only."""

    def association(self, config: MapperConfig) -> Registration:
        """Return the paper's matching."""
        return NearestPrevious(None)


class PaperPointMapper(PointMapper):
    """Maps points as in the paper."""

    def _model(self) -> PointModel:
        return PaperPointModel()


class PaperPlaneMapper(PlaneMapper):
    """Maps walls by the paper's recipe of pairs (Figs 1, 2 and 4).

    Walls are associated as in `PlaneMapper`.
    """

    @property
    def planes(self) -> PlaneTable:
        """Every wall ever seen, placed by `pairwise_map` and moved into the mapper's map frame."""
        table, history = super().planes, self.history
        placed = pairwise_map(history, int(history.plane.max(initial=-1)) + 1)[table.plane]
        both = np.asarray(np.isfinite(placed + table.ends).all(axis=(1, 2)))
        source, target = placed[both].reshape(-1, 2), table.ends[both].reshape(-1, 2)
        if not fixes_rotation(source):
            return replace(table, status=np.full(len(both), "unmapped"))
        R, t = fit_rigid(source, target)
        ends = np.where(both[:, None, None], placed @ R.T + t, np.nan)
        return replace(table, ends=ends, status=np.where(both, table.status, "unmapped"))
