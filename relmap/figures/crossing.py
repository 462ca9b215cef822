"""Planes against points on the same raw points, over the noise: where the one overtakes the other.

The points lie fixed on the walls of a building (`surface_points`).  The plane mapper segments each
scan; the point mapper takes the points themselves for landmarks.  Both have default settings and no
odometry.  Points whose ids are given show what is lost by not knowing which point is which.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import astuple, dataclass, fields
from itertools import product
from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.feeding import Association
from relmap.evaluation.run import run_mapper
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
    """All runs, in the order of `METHODS` within each cell."""

    COLUMNS: ClassVar = tuple(field.name for field in fields(CrossingRow))

    runs: tuple[CrossingRow, ...]

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield a line per run, as `COLUMNS` name them."""
        return (tuple("" if v is None else v for v in astuple(row)) for row in self.runs)

    @property
    def spacings_m(self) -> list[float]:
        """All spacings, ascending."""
        return sorted({row.spacing_m for row in self.runs})

    def noises(self, spacing_m: float) -> list[float]:
        """All noises with this spacing, ascending, in units of it."""
        return sorted({row.noise for row in self.runs if row.spacing_m == spacing_m})

    def values(self, name: str, method: Method, spacing_m: float) -> NDArray[np.float64]:
        """Return one figure of all runs, (noises, seeds); what could not be had is infinite."""
        of = [row for row in self.runs if row.method == method and row.spacing_m == spacing_m]
        found = [
            [getattr(row, name) for row in of if row.noise == noise]
            for noise in self.noises(spacing_m)
        ]
        return np.array([[np.inf if v is None else v for v in values] for values in found])

    def median(self, name: str, method: Method, spacing_m: float) -> NDArray[np.float64]:
        """Return the median over the seeds, (noises,)."""
        return np.asarray(np.median(self.values(name, method, spacing_m), axis=1))

    def planes_ahead(self, method: Method, spacing_m: float) -> tuple[float, float] | None:
        """Return the noises, over the spacing, between which planes have the better map.

        Of several such intervals it is the longest.  It begins where the medians of the map error
        cross, on straight lines between two noises, or at the first noise at which points fail; it
        ends with the last noise at which planes are still ahead.  None where they never are.
        """
        noise = np.array(self.noises(spacing_m))
        planes, points = self.error("planes", spacing_m), self.error(method, spacing_m)
        ahead = planes < points
        if not ahead.any():
            return None
        k, end = longest(ahead)
        last = float(noise[end - 1])
        if k == 0:
            return float(noise[0]), last
        before, after = points[k - 1] - planes[k - 1], points[k] - planes[k]
        if not (np.isfinite(before) and np.isfinite(after)):
            return float(noise[k]), last
        return float(noise[k - 1] + (noise[k] - noise[k - 1]) * before / (before - after)), last

    def error(self, method: Method, spacing_m: float) -> NDArray[np.float64]:
        """Return the median map error, (noises,) metres; infinite where the map has failed."""
        failed = self.median("coverage", method, spacing_m) < HALF
        return np.where(failed, np.inf, self.median("map_rmse_m", method, spacing_m))

    def fails_at(self, method: Method, spacing_m: float) -> float | None:
        """Return the noise, over the spacing, from which on the median run maps too little."""
        works = np.flatnonzero(self.median("coverage", method, spacing_m) >= HALF)
        first = int(works[-1]) + 1 if len(works) else 0
        noises = self.noises(spacing_m)
        return noises[first] if first < len(noises) else None


def run_crossing(
    spacings_m: Iterable[float],
    noises: Iterable[float],
    seeds: Iterable[int],
    iterations: int | None = None,
    progress: Callable[[list[Cell]], Iterable[Cell]] | None = None,
) -> Crossing:
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
        Wraps the list of cells, to show how far it is.
    """
    cells = list(product(spacings_m, noises, seeds))
    runs: list[CrossingRow] = []
    for spacing_m, noise, seed in progress(cells) if progress else cells:
        seen = wall_points(spacing_m, noise, seed, iterations)
        runs.extend(map_of(method, seen, noise, seed)[1] for method in METHODS)
    return Crossing(tuple(runs))


def wall_points(
    spacing_m: float, noise: float, seed: int, iterations: int | None = None
) -> SurfacePoints:
    """Return a drive through a building past fixed points, noise in units of their spacing."""
    building = simulate_building(points=1, sigma=0.0, seed=seed, iterations=iterations)
    return scan_surface_points(building, spacing_m, noise * spacing_m, seed)


def map_of(
    method: Method, seen: SurfacePoints, noise: float, seed: int
) -> tuple[Result, CrossingRow]:
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
    about = (method, seen.spacing_m, noise, seen.sigma, seed)
    matched = found.counts["matched_poses"] / len(seen.scans)
    row = CrossingRow(*about, rmse_m, found.coverage or 0.0, found.ate_m, matched)
    return run.result, row
