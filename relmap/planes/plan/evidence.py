"""Evidence of scans and beams for each stretch of a wall: seen, hit, or seen through."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes.scans.beam_store import BeamStore
from relmap.planes.walls.assembly import Assembled, directions
from relmap.planes.walls.joining import placed_ends

BIN_M = 0.05
"""Length of a stretch."""
CELL_M, MOST_CELLS = 0.25, 4096
"""Size of the cells of a grid over walls, and their largest number along an axis: those of a wider
grid are larger, for a sensor may report a wall far away that is none."""
RIM = 2
"""Number of stretches beyond either end of the observed part of a wall."""
MOST_BEAMS = 400_000
"""Number of observations above which counts saturate."""
NEAR_M, NEAR = 0.08, 3.0
"""Largest distance of a beam's end from the wall it hits: metres, and in standard deviations."""
BEFORE_M = 0.2
"""Distance in front of a wall at which the end of a beam counts against the wall."""
SAMPLED, FAR_M = 10, 0.5
"""Subsampling of the beams for the noise estimate, and largest distance from a wall used."""
LEAST_SINE = float(np.sin(np.deg2rad(8.0)))
"""Beams at a smaller angle to a wall do not determine where they cross it."""
MEDIAN = 1.4826


@dataclass(frozen=True, eq=False)
class Stretches:
    """Walls divided into stretches of equal length; w walls, b stretches in total.

    `base`, `normal`, `along` (w, 2): a point on each wall, and unit vectors to its front and from
    its right to its left; `low` (w,), metres: start of the first stretch, along the wall; `first`
    (w + 1,): the first stretch of each wall; `seen` (b,): number of observations of the wall there;
    `hits`, `against` (b,): number of beams that end there, and that pass through or end shortly
    before.
    """

    base: Floats
    normal: Floats
    along: Floats
    low: Floats
    first: Ints
    seen: Ints
    hits: Ints
    against: Ints

    @property
    def wall(self) -> Ints:
        """The wall of each stretch, (b,)."""
        return np.repeat(np.arange(len(self.low)), np.diff(self.first))

    @property
    def place(self) -> Floats:
        """Position of the middle of each stretch along its wall; (b,) metres."""
        wall = self.wall
        place = self.low[wall] + BIN_M * (np.arange(len(wall)) - self.first[wall] + 0.5)
        return np.asarray(place)


def stretches_of(
    assembled: Assembled, poses: Floats, span: tuple[int, int], beams: BeamStore
) -> Stretches:
    """Return the evidence of the scans and beams of a submap for its walls.

    `poses` (k, 4, 4): ``T_submap_robot`` of the iterations of the span; `span` (int, int).
    """
    from relmap.planes.plan.plan_kernels import beams_on_walls

    state, of = assembled.state, assembled.given.wall
    normal, along = directions(state.angle)
    base = state.centre + state.across[:, None] * normal
    n = len(base)
    reach = np.einsum("nei,ni->ne", placed_ends(assembled) - base[of][:, None], along[of])
    reach.sort(axis=1)  # before refinement, some are reversed
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, of, reach[:, 0])
    np.maximum.at(high, of, reach[:, 1])
    low -= RIM * BIN_M
    counts = np.ceil((high - low) / BIN_M).astype(np.int64) + RIM
    first = np.concatenate([[0], np.cumsum(counts)])
    at = np.rint((reach - low[of][:, None]) / BIN_M).astype(np.int64) + first[of][:, None]
    change = np.bincount(at[:, 0], minlength=first[-1]) - np.bincount(at[:, 1], minlength=first[-1])
    none = np.zeros(first[-1], dtype=np.int64)
    blank = Stretches(base, normal, along, low, first, np.cumsum(change), none, none)
    begins, ends, _ = beams.placed(poses, span, MOST_BEAMS)
    given = (base, normal, low, first), grid_over(blank)
    some = begins[::SAMPLED].copy(), ends[::SAMPLED].copy()
    *_, off = beams_on_walls(some, *given, FAR_M, FAR_M)
    off = off[off < FAR_M]
    noise_m = MEDIAN * float(np.median(off)) if len(off) else 0.0
    near_m = max(NEAR_M, NEAR * noise_m)
    hits, against, _ = beams_on_walls((begins, ends), *given, near_m, near_m + BEFORE_M)
    return replace(blank, hits=hits, against=against)


def grid_over(walls: Stretches) -> tuple[Floats, Ints, Ints, Ints, float]:
    """Return a grid over the walls, listing those in or next to each cell; see `beams_on_walls`."""
    wall, n = walls.wall, len(walls.low)
    points = walls.base[wall] + walls.place[:, None] * walls.along[wall]
    cell_m = max(CELL_M, float(np.ptp(points, axis=0).max()) / MOST_CELLS)
    corner = points.min(axis=0) - 2 * cell_m
    cell = ((points - corner) / cell_m).astype(np.int64)
    shape = cell.max(axis=0) + 3
    beside = (-1, 0, 1)
    at = [(cell[:, 0] + x) * shape[1] + cell[:, 1] + y for x in beside for y in beside]
    key = np.unique(np.concatenate([each * n + wall for each in at]))
    starts = np.searchsorted(key // n, np.arange(shape[0] * shape[1] + 1))
    return corner, shape, starts, key % n, cell_m
