"""Every method that can be compared, by name."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from relmap.comparison.baselines.base import Setup
from relmap.comparison.baselines.batch import BatchLeastSquares
from relmap.comparison.baselines.ekf import as_mrpt_ships_it, linearised_at_best_fit
from relmap.comparison.baselines.frames import FrameToFrame, FrameToMap
from relmap.comparison.baselines.gtsam_methods import GtsamBatch, Isam2
from relmap.comparison.baselines.icp import KissIcp, SmallGicp
from relmap.core.config import MapperConfig
from relmap.core.errors import RelmapError, known_name
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.evaluation.feeding import Association
from relmap.evaluation.sources import LogKind
from relmap.planes import PlaneMapper
from relmap.planes.pairwise import pairwise_map
from relmap.planes.walls.table import PlaneTable
from relmap.planes3d import Plane3dMapper
from relmap.points import PointMapper

PAPER = MapperConfig(max_missed=0, refine_live=False)
WITHOUT_IDS = replace(PAPER, registration="nearest-previous")
"""Settings of sections II and III: no missed iterations, no live refinement, and without ids scans
are matched to the previous iteration only."""
_SCANS: tuple[LogKind, ...] = ("scans",)
_CLOUDS: tuple[LogKind, ...] = ("clouds",)
_ALL: tuple[LogKind, ...] = ("landmarks", "scans", "clouds")
_HOLDS = {"landmarks": "landmarks", "scans": "point scans", "clouds": "clouds that show floors"}
_GTSAM: dict[str, Any] = {"needs_ids": True, "needs": "gtsam"}


class PaperPlaneMapper(PlaneMapper):
    """Maps walls, associated as in `PlaneMapper`, by the recipe of pairs of Figs 1, 2 and 4."""

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


@dataclass(frozen=True)
class MethodInfo:
    """A method and the information needed to choose it.

    `make`: makes a new `Method` or `Plane3dMapper`; `logs`: accepted kinds of logs; `refine`:
    whether the map is refined at the end of the log; `needs_ids`: whether it needs known ids;
    `needs`: module of the optional extra that it requires.
    """

    name: str
    make: Callable[[Setup], Any]
    logs: tuple[LogKind, ...] = ("landmarks",)
    refine: bool = False
    needs_ids: bool = False
    needs: str | None = None

    @property
    def missing(self) -> str | None:
        """Reason why it cannot run; None if nothing is missing."""
        if self.needs is None or importlib.util.find_spec(self.needs) is not None:
            return None
        return f"{self.needs} is not installed: pip install 'relmap[peers]'"


METHODS: tuple[MethodInfo, ...] = (
    MethodInfo("relmap-points", lambda _: PointMapper(), refine=True),
    MethodInfo("relmap-points-live", lambda _: PointMapper()),
    MethodInfo("relmap-points-paper", lambda s: PointMapper(PAPER if s.has_ids else WITHOUT_IDS)),
    MethodInfo("relmap-planes", lambda _: PlaneMapper(), _SCANS, refine=True),
    MethodInfo("relmap-planes-live", lambda _: PlaneMapper(), _SCANS),
    MethodInfo("relmap-planes-paper", lambda _: PaperPlaneMapper(), _SCANS),
    MethodInfo("relmap-planes3d", lambda _: Plane3dMapper(), _CLOUDS, refine=True),
    MethodInfo("frame-to-frame", lambda setup: FrameToFrame(setup.dimension), needs_ids=True),
    MethodInfo("frame-to-map", lambda setup: FrameToMap(setup.dimension), needs_ids=True),
    MethodInfo("ekf-mrpt", as_mrpt_ships_it, needs_ids=True),
    MethodInfo("ekf", linearised_at_best_fit, needs_ids=True),
    MethodInfo("batch", lambda setup: BatchLeastSquares(setup.dimension), needs_ids=True),
    MethodInfo("isam2", lambda setup: Isam2(setup.dimension, setup.sigma_m), **_GTSAM),
    MethodInfo("gtsam-batch", lambda setup: GtsamBatch(setup.dimension, setup.sigma_m), **_GTSAM),
    MethodInfo("kiss-icp", lambda setup: KissIcp(setup.range_m), _ALL, needs="kiss_icp"),
    MethodInfo("small-gicp", lambda setup: SmallGicp(setup.range_m), _ALL, needs="small_gicp"),
)
"""In the order of tables."""


def find_method(name: str) -> MethodInfo:
    """Return a method by its name; RelmapError if there is none of that name."""
    known = {method.name: method for method in METHODS}
    return known[known_name(name, known, "method")]


def fitting_methods(log: LogKind, association: Association) -> list[MethodInfo]:
    """Return the methods that accept a log of this kind."""
    return [
        method
        for method in METHODS
        if log in method.logs and (association == "known" or not method.needs_ids)
    ]


def check_method(method: MethodInfo, log: LogKind, association: Association) -> None:
    """Check that a method accepts such a log; RelmapError if it does not."""
    fit = ", ".join(other.name for other in fitting_methods(log, association))
    if log not in method.logs:
        raise RelmapError(
            f"method {method.name} cannot map a log of {_HOLDS[log]}; these can: {fit}"
        )
    if method.needs_ids and association == "nearest":
        raise RelmapError(
            f"method {method.name} needs known ids: "
            f"--association known; without ids these can run: {fit}"
        )
