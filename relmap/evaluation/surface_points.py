"""Fixed surface points of walls, mapped both as planes and as points.

A simulated scanner samples new points in each scan, and no point is seen twice. Here the points are
fixed on the walls: each is a landmark, seen whenever its stretch of the wall is, with new noise
each time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.feeding import Association
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import truth_of
from relmap.evaluation.truth import Truth
from relmap.io.results import Result
from relmap.planes import PlaneMapper
from relmap.points import PointMapper
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import Building, BuildingScan, simulate_building

Method = Literal["planes", "points", "points, ids given"]
METHODS: tuple[Method, ...] = get_args(Method)
HALF = 0.5
"""Minimum coverage of a successful map."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """A run past fixed points on walls, as input for both variants.

    `scans`: without the identities of the points; `points`: the same points, with ids for the
    evaluation only; `spacing_m`: each square of this side on a wall has one point; `noise`:
    standard deviation of each coordinate in units of the spacing.
    """

    scans: ScanLog
    points: ObservationLog
    walls_truth: Truth
    points_truth: Truth
    spacing_m: float
    noise: float
    seed: int

    @property
    def sigma(self) -> float:
        """Standard deviation of each coordinate, metres."""
        return self.noise * self.spacing_m


def wall_points(
    spacing_m: float, noise: float, seed: int, iterations: int | None = None
) -> SurfacePoints:
    """Return a drive through a building past fixed points.

    `spacing_m`, `noise`, `seed`: as for `scan_surface_points`; the seed is also that of the
    building. `iterations`: number of scans; one loop if omitted.
    """
    building = simulate_building(points=1, sigma=0.0, seed=seed, iterations=iterations)
    return scan_surface_points(building, spacing_m, noise, seed)


def scan_surface_points(
    building: Building, spacing_m: float, noise: float, seed: int
) -> SurfacePoints:
    """Simulate a robot that drives through a building and sees fixed points of its walls.

    `building`: its path and visible walls are used, but not its points; `spacing_m`: side of the
    squares that contain one random point each, metres; `noise`: standard deviation of the normal
    noise of each coordinate, in units of the spacing; `seed`: seed of points and noise. Raises
    `RelmapError` if the spacing is not positive or the noise is negative.
    """
    if not (0 < spacing_m < np.inf and 0 <= noise < np.inf):
        raise RelmapError(
            f"spacing is {spacing_m} and noise {noise}; "
            "they must be a positive length, metres, and a multiple of it, 0 or more"
        )
    rng = np.random.default_rng(seed)
    places, wall, along = _points_on(building.walls, spacing_m, rng)
    pairs = list(zip(building.scans, building.trajectory, strict=True))
    seen = [rng.permutation(_in_view(scan, T, building.walls, wall, along)) for scan, T in pairs]
    sigma, stamps_s, poses = noise * spacing_m, building.stamps_s, building.trajectory
    points = [
        (places[rows] - T[:3, 3]) @ T[:3, :3] + sigma * rng.standard_normal((len(rows), 3))
        for rows, T in zip(seen, poses, strict=True)
    ]
    log = replace(ObservationLog.of_scans(points, seen), stamps_s=stamps_s)
    scans = ScanLog(3, stamps_s, points.__getitem__, poses)
    status = np.full(len(places), "static")
    points_truth = Truth(np.arange(len(places)), places, status, stamps_s, poses)
    return SurfacePoints(scans, log, truth_of(building), points_truth, spacing_m, noise, seed)


def _points_on(
    walls: Floats, spacing_m: float, rng: np.random.Generator
) -> tuple[Floats, Ints, Floats]:
    """Return points (n, 3), map frame; their walls (n,); position along the wall, 0 to 1, (n,)."""
    places, owner, along = [], [], []
    for number, wall in enumerate(walls):
        first, last = wall[:2], wall[2:4]
        length, height = float(np.linalg.norm(last - first)), float(wall[5] - wall[4])
        columns = max(1, round(length / spacing_m))
        rows = max(1, round(height / spacing_m))
        n = columns * rows
        t = (np.arange(n) % columns + rng.uniform(0, 1, n)) / columns
        z = wall[4] + height * (np.arange(n) // columns + rng.uniform(0, 1, n)) / rows
        places.append(np.column_stack([first + t[:, None] * (last - first), z]))
        owner.append(np.full(n, number))
        along.append(t)
    return np.concatenate(places), np.concatenate(owner), np.concatenate(along)


def _in_view(
    scan: BuildingScan, T_map_robot: Floats, walls: Floats, wall: Ints, along: Floats
) -> Ints:
    """Return the points of the visible stretches of walls, ascending."""
    seen = scan.seen
    first = walls[seen.wall, :2]
    across = walls[seen.wall, 2:4] - first
    ends_map = seen.ends @ T_map_robot[:2, :2].T + T_map_robot[:2, 3]
    reach = ((ends_map - first[:, None]) * across[:, None]).sum(axis=2)
    reach /= (across**2).sum(axis=1)[:, None]
    begin, end = np.searchsorted(wall, seen.wall), np.searchsorted(wall, seen.wall, side="right")
    rows = [
        b + np.flatnonzero((along[b:e] >= low) & (along[b:e] <= high))
        for b, e, (low, high) in zip(begin, end, reach, strict=True)
    ]
    return np.sort(np.concatenate([*rows, np.empty(0, dtype=np.int64)]))


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
    return run.result, VariantRun(*about, rmse_m, found.coverage or 0.0, found.ate_m, matched)
