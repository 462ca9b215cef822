"""Planes against points on the same raw points, over the noise: where the one overtakes the other.

The points lie fixed on the walls of a building (`surface_points`).  The plane mapper segments each
scan; the point mapper takes the points themselves for landmarks.  Both have default settings and no
odometry.  Points with given ids show what is lost where the association has to be found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.run import Association, run_mapper
from relmap.figures.figure06 import longest
from relmap.figures.surface_points import SurfacePoints, scan_surface_points
from relmap.io.results import Result
from relmap.planes import PlaneMapper
from relmap.points.mapper import PointMapper
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import simulate_building

Method = Literal["planes", "points", "points, ids given"]
METHODS: tuple[Method, ...] = get_args(Method)
HALF = 0.5
"""A map that holds less than this share of the corners or points has failed."""
Cell = tuple[float, float, int]
"""Spacing, noise over spacing, seed."""


@dataclass(frozen=True)
class CrossingRow:
    """One run.

    Attributes
    ----------
    method : str
    spacing_m, noise, sigma : float
        Noise is sigma in units of the spacing.
    seed : int
    map_rmse_m : float or None
        Of corners or points after rigid alignment; None where nothing could be compared.
    coverage : float
        Share of the corners or points seen ten times that stand in the map.
    ate_m : float or None
        Absolute trajectory error, over the poses that there are.
    poses : float
        Share of the scans that have a pose in the map's largest submap.
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


@dataclass(frozen=True)
class Crossing:
    """All runs with points of one spacing, in the order of `METHODS` within each cell."""

    spacing_m: float
    runs: tuple[CrossingRow, ...]

    @property
    def noise(self) -> NDArray[np.float64]:
        """All noises in units of the spacing, ascending; (n,)."""
        return np.unique([row.noise for row in self.runs])

    def values(self, name: str, method: Method) -> NDArray[np.float64]:
        """Return an attribute of all runs of a method, (noises, seeds); infinite where None."""
        found = [
            [getattr(row, name) for row in self.runs if (row.method, row.noise) == (method, noise)]
            for noise in self.noise
        ]
        return np.array([[np.inf if v is None else v for v in values] for values in found])

    def median(self, name: str, method: Method) -> NDArray[np.float64]:
        """Return the median over the seeds, (noises,), of what `values` returns."""
        return np.asarray(np.median(self.values(name, method), axis=1))

    def failed(self, method: Method) -> NDArray[np.bool_]:
        """Return at which noises the median run of a method maps too little, (noises,)."""
        return self.median("coverage", method) < HALF

    def planes_ahead(self, method: Method) -> tuple[float, float] | None:
        """Return the noises, over the spacing, between which planes have the better map.

        Of several such intervals it is the longest.  It begins where the medians of the map error
        cross, on straight lines between two noises, or at the first noise at which points fail; it
        ends with the last noise at which planes are still ahead.  None where they never are.
        """
        planes, points = (
            np.where(self.failed(which), np.inf, self.median("map_rmse_m", which))
            for which in (METHODS[0], method)
        )
        ahead = planes < points
        if not ahead.any():
            return None
        noise, (k, end) = self.noise, longest(ahead)
        begin, last = float(noise[k]), float(noise[end - 1])
        if k == 0 or not np.isfinite(points[k - 1] + planes[k - 1] + points[k] + planes[k]):
            return begin, last
        before, after = points[k - 1] - planes[k - 1], points[k] - planes[k]
        return float(noise[k - 1] + (noise[k] - noise[k - 1]) * before / (before - after)), last

    def fails_at(self, method: Method) -> float | None:
        """Return the noise, over the spacing, from which on a method maps too little, if any."""
        works = np.flatnonzero(~self.failed(method))
        beyond = self.noise[works[-1] + 1 if len(works) else 0 :]
        return float(beyond[0]) if len(beyond) else None


def run_crossing(
    spacings_m: Iterable[float],
    noises: Iterable[float],
    seeds: Iterable[int],
    iterations: int | None = None,
    progress: Callable[[list[Cell]], Iterable[Cell]] = iter,
) -> list[Crossing]:
    """Map the same points as planes and as points, for all spacings, noises and seeds.

    Parameters
    ----------
    spacings_m : iterable of float
        Of the points on the walls, metres.
    noises : iterable of float
        In units of the spacing.
    seeds : iterable of int
        Of building, points and noise.
    iterations : int, optional
        Scans of a run; one loop where left out.
    progress : callable, optional
        Wraps the list of cells, to show progress.

    Returns
    -------
    list of Crossing
        One for each spacing.
    """
    runs: dict[float, list[CrossingRow]] = {}
    for spacing_m, noise, seed in progress(list(product(spacings_m, noises, seeds))):
        seen = wall_points(spacing_m, noise, seed, iterations)
        runs.setdefault(spacing_m, []).extend(map_of(method, seen)[1] for method in METHODS)
    return [Crossing(spacing_m, tuple(each)) for spacing_m, each in runs.items()]


def wall_points(
    spacing_m: float, noise: float, seed: int, iterations: int | None = None
) -> SurfacePoints:
    """Return a drive through a building past fixed points; see `run_crossing`."""
    building = simulate_building(points=1, sigma=0.0, seed=seed, iterations=iterations)
    return scan_surface_points(building, spacing_m, noise, seed)


def map_of(method: Method, seen: SurfacePoints) -> tuple[Result, CrossingRow]:
    """Segment the scans and map the walls, or map the points themselves; and judge the map."""
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
    row = CrossingRow(*about, rmse_m, found.coverage or 0.0, found.ate_m, matched)
    return run.result, row
