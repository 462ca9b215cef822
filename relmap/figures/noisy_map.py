"""Both maps of the same noisy points: Fig. 7's, and the one that points alone give."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from relmap.evaluation import metrics
from relmap.evaluation.evaluate import evaluate
from relmap.figures.crossing import map_planes, map_points, wall_points
from relmap.figures.pose_fit import fit_poses
from relmap.io.results import Result

NOISE = 0.3
"""Sigma over the spacing: points are no longer distinguishable from one scan to the next."""


@dataclass(frozen=True, eq=False)
class NoisyMaps:
    """Two maps in the frame of the truth, metres.

    Attributes
    ----------
    spacing_m, noise, sigma : float
        Noise is sigma in units of the spacing.
    seed : int
    true_walls : (w, 2, 2) float64
    walls : (m, 2, 2) float64
    planes_path, points_path : (k, 2) float64
    points : (p, 2) float64
        As far as they are mapped; from above.
    planes_rmse_m, points_rmse_m : float or None
        Of corners and of points.
    planes_coverage, points_coverage : float
        Share of corners and points seen ten times that stand in the map.
    """

    COLUMNS: ClassVar = ("what", "number", "x0", "y0", "x1", "y1")

    spacing_m: float
    noise: float
    sigma: float
    seed: int
    true_walls: NDArray[np.float64]
    walls: NDArray[np.float64]
    planes_path: NDArray[np.float64]
    points_path: NDArray[np.float64]
    points: NDArray[np.float64]
    planes_rmse_m: float | None
    points_rmse_m: float | None
    planes_coverage: float
    points_coverage: float

    @property
    def limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners (2,), (2,) of a box around the true walls, with a rim."""
        flat = self.true_walls.reshape(-1, 2)
        return flat.min(axis=0) - 1.0, flat.max(axis=0) + 1.0

    @property
    def said_of_planes(self) -> str:
        """What there is to say of the map of planes, in one line."""
        return self._said(self.planes_rmse_m, self.planes_coverage, "corner")

    @property
    def said_of_points(self) -> str:
        """What there is to say of the map of points, in one line."""
        return self._said(self.points_rmse_m, self.points_coverage, "point")

    def _said(self, rmse_m: float | None, coverage: float, what: str) -> str:
        if rmse_m is None:
            return f"{coverage:.0%} of the {what}s mapped"
        in_sigma = f" = {rmse_m / self.sigma:.2f} sigma" if self.sigma > 0 else ""
        return f"{what} RMSE {rmse_m:.3f} m{in_sigma}, {coverage:.0%} of the {what}s mapped"

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield a line for each wall, point and pose, as `COLUMNS` name them; metres."""
        for what, lines in (("true wall", self.true_walls), ("mapped wall", self.walls)):
            for number, line in enumerate(lines.reshape(-1, 4).tolist()):
                yield what, number, *line
        for what, places in (
            ("mapped point", self.points),
            ("pose, planes", self.planes_path),
            ("pose, points", self.points_path),
        ):
            for number, place in enumerate(places.tolist()):
                yield what, number, *place, "", ""


def run_noisy_maps(
    spacing_m: float = 0.2, noise: float = NOISE, seed: int = 0, iterations: int | None = None
) -> NoisyMaps:
    """Map fixed points on the walls of a building as planes, and as points.

    Parameters
    ----------
    spacing_m : float
        Of the points on the walls, metres.
    noise : float
        Sigma in units of the spacing.
    seed : int
    iterations : int, optional
        Scans; one loop where left out.
    """
    seen = wall_points(spacing_m, noise, seed, iterations)
    run, result = map_planes(seen), map_points(seen)
    truth = seen.walls_truth
    walls = evaluate(run.result, truth)
    points = evaluate(result, seen.points_truth, seen.points)
    R, t, path = _placed(run.result, truth.stamps_s, truth.poses)
    mapped = run.planes.status == "static"
    R_points, t_points, points_path = _placed(result, truth.stamps_s, truth.poses)
    return NoisyMaps(
        spacing_m,
        noise,
        seen.sigma,
        seed,
        truth.ends,
        run.planes.ends[mapped] @ R.T + t,
        path,
        points_path,
        result.landmarks.position[result.mapped, :2] @ R_points.T + t_points,
        walls.corner_rmse_m,
        points.landmark_rmse_m,
        walls.coverage or 0.0,
        points.coverage or 0.0,
    )


def _placed(
    result: Result, stamps_s: NDArray[np.float64], poses: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the planar motion of a map into the frame of the truth, and its path there."""
    mine, other = metrics.match_stamps(result.stamps_s, stamps_s)
    if not len(mine):
        return np.eye(2), np.zeros(2), np.empty((0, 2))
    R, t = fit_poses(result.poses[mine], poses[other])
    return R, t, result.poses[:, :2, 3] @ R.T + t
