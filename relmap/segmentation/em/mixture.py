"""Walls by expectation maximisation: the mixture whose component is the shape of a wall.

A component is Gaussian in the direction of the noise; along the wall it has the density of the
sensor's points, between two blurred ends. A uniform class holds the points of no wall. A Gaussian
mixture splits a wall, because a wall is not Gaussian along itself; this one does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.noise import FLOOR_M

PARAMETERS = 5
"""Parameters per wall: two of its line, two ends, its weight."""
STRAY_AT_FIRST = 0.05
STRAY_LEAST = 1e-4
TOLERANCE = 1e-4
CONCERNED = 0.01
"""Minimum fraction of a point's density that makes the point relevant to a wall."""


@dataclass(frozen=True, eq=False)
class WallMixture:
    """Walls and outliers that explain a scan.

    `walls` (k, WALL): see `relmap.segmentation.wall`. `sigma`: noise, metres. `stray`: fraction of
    points that belong to no wall. `area`: area over which these are uniform, square metres. `beam`:
    angle (radians) between the beams of points; 0 if points are uniform on the walls. `repeat`:
    number of points at one bearing, which count once for the extent of a wall. `fixed_noise`:
    whether the noise was given. `rest` (n,): for a subset of walls: the density of everything else
    at the relevant points.
    """

    walls: Floats
    sigma: float
    stray: float
    area: float
    beam: float = 0.0
    repeat: float = 1.0
    fixed_noise: bool = False
    rest: Floats | None = None

    @property
    def along(self) -> float:
        """Distance (metres) by which noise moves points along a wall; along beams, none."""
        return 0.0 if self.beam > 0 else self.sigma

    def density(self, xy: Floats) -> tuple[Floats, Floats]:
        """Return the density (k, n) of points (n, 2) under each wall, and of all together (n,)."""
        from relmap.segmentation.em.wall_kernels import expect

        return expect(xy, self.walls, self.sigma, self.beside(len(xy)), self.beam)

    def sightings(self, xy: Floats, wall: Floats) -> tuple[Floats, Floats, Floats]:
        """Return where points (n, 2) are along a wall, and how far from it; see the kernel."""
        from relmap.segmentation.em.wall_kernels import sightings

        return sightings(xy, wall, self.beam)

    def beside(self, n: int) -> Floats:
        """Return the density of everything except the walls at n points."""
        return np.full(n, self.stray / self.area) if self.rest is None else self.rest

    def likelihood(self, xy: Floats) -> float:
        """Return the log likelihood of points (n, 2)."""
        return float(np.log(self.density(xy)[1]).sum())

    def evidence(self, xy: Floats) -> float:
        """Return the log likelihood of points (n, 2) minus the penalty for parameters (BIC)."""
        return self.likelihood(xy) - len(self.walls) * wall_cost(len(xy))

    def labels(self, xy: Floats) -> Ints:
        """Return the most likely wall (n,) of each point (n, 2), -1 for none."""
        density, _ = self.density(xy)
        if len(density) == 0:
            return np.full(len(xy), -1)
        best = density.argmax(axis=0)
        known = density[best, np.arange(len(xy))] > self.stray / self.area
        return np.where(known, best, -1)

    def only(self, rows: Bools | list[int]) -> WallMixture:
        """Return the mixture of some of the walls."""
        return replace(self, walls=self.walls[rows])

    def with_walls(self, walls: Floats) -> WallMixture:
        """Return the mixture with other walls (k, WALL)."""
        return replace(self, walls=walls)

    def around(self, rows: list[int], xy: Floats) -> tuple[WallMixture, Floats]:
        """Return the mixture of a few walls, all else fixed, and the relevant points (m, 2)."""
        density, total = self.density(xy)
        theirs = density[rows].sum(axis=0)
        near = theirs > CONCERNED * total
        scale = len(xy) / max(int(near.sum()), 1)
        few = self.walls[rows]
        few[:, -1] *= scale
        rest = scale * np.maximum(total - theirs, self.stray / self.area)[near]
        return replace(self, walls=few, rest=rest), xy[near]


def wall_cost(n: int) -> float:
    """Return the penalty of a wall among n points (BIC; Schwarz, 1978), as log likelihood."""
    return 0.5 * PARAMETERS * math.log(max(n, 2))


def scan_area(xy: Floats, sigma: float) -> float:
    """Return the area (square metres) of the box about points (n, 2), blurred by the noise."""
    width_m, height_m = (xy.max(axis=0) - xy.min(axis=0) + 6 * sigma + 1e-3).tolist()
    return float(width_m * height_m)


def maximise(
    mixture: WallMixture, xy: Floats, steps: int, held: bool = False, tolerance: float = TOLERANCE
) -> WallMixture:
    """Return the mixture after EM, until it converges; if `held`, the ends of walls are fixed."""
    from relmap.segmentation.em.step_kernels import em_step

    walls, sigma, stray = mixture.walls.copy(), mixture.sigma, mixture.stray
    before = -np.inf
    for _ in range(steps if len(walls) else 0):
        rest = np.full(len(xy), stray / mixture.area) if mixture.rest is None else mixture.rest
        likelihood, spread, loose = em_step(xy, walls, sigma, rest, mixture.beam, held)
        if not mixture.fixed_noise:
            sigma = min(max(spread, FLOOR_M), 1.5 * sigma)
        stray = max(loose, STRAY_LEAST)
        if abs(likelihood - before) < tolerance * len(walls):
            break
        before = likelihood
    return replace(mixture, walls=walls, sigma=sigma, stray=stray)
