"""Planes and points from the same scans: one run of each, compared with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.feeding import Association
from relmap.evaluation.run import run_mapper
from relmap.evaluation.surface_points import SurfacePoints
from relmap.io.results import Result
from relmap.planes import PlaneMapper
from relmap.points import PointMapper
from relmap.segmentation import PlaneSegmenter

Method = Literal["planes", "points", "points, ids given"]
METHODS: tuple[Method, ...] = get_args(Method)
HALF = 0.5
"""Minimum coverage of a successful map."""


@dataclass(frozen=True)
class VariantRun:
    """One run.

    `spacing_m`, `noise`, `sigma`: noise is sigma in units of the spacing. `map_rmse_m`: error of
    corners or points after rigid alignment; None if nothing could be compared. `coverage`: fraction
    of the corners or points seen ten times that are in the map. `ate_m`: absolute trajectory error,
    over the available poses. `poses`: fraction of the scans with a pose in the map's largest
    submap.
    """

    method: Method
    spacing_m: float
    noise: float
    sigma: float
    seed: int
    map_rmse_m: float | None
    coverage: float
    ate_m: float | None
    poses: float


def map_of(method: Method, seen: SurfacePoints) -> tuple[Result, VariantRun]:
    """Segment the scans and map the walls, or map the points themselves; and evaluate the map."""
    if method == "planes":
        run = run_mapper(PlaneMapper(), seen.scans, refine=True, segmenter=PlaneSegmenter())
        found = evaluate(run.result, seen.walls_truth)
        rmse_m = found.corner_rmse_m
    else:
        association: Association = "nearest" if method == "points" else "known"
        run = run_mapper(PointMapper(), seen.points, association, refine=True)
        found = evaluate(run.result, seen.points_truth, seen.points)
        rmse_m = found.landmark_rmse_m
    about = (method, seen.spacing_m, seen.noise, seen.sigma, seen.seed)
    matched = found.counts["matched_poses"] / len(seen.scans)
    row = VariantRun(*about, rmse_m, found.coverage or 0.0, found.ate_m, matched)
    return run.result, row
