"""Paths of a robot with landmarks along them: streets, corridors, stairs and more.

Each kind tests another aspect of data association: loops, perceptual aliasing, landmarks on a line
or a plane, which leave the rotation undetermined, or landmarks closer together than the robot's
step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats
from relmap.simulation.drive import lengths_along, places_along

ROUNDING_M = 2.0
"""Standard deviation of the filter that rounds the corners of a path, metres."""
FINE_M = 0.1
"""Sampling of a path before rounding, metres."""
JITTER = 0.05
"""Deviation of columns and marks on stairs from a regular grid, in spacings."""
THIN = 0.02
"""Distance of landmarks from their line or plane, in spacings."""
CLUMP, CLUMP_M = 6, 0.5
"""Landmarks per cluster, and their standard deviation from its centre, metres."""
ASIDE_M = 6.0
"""Largest distance of landmarks from the path, metres; above a plane the robot has half of it."""
BEYOND_M = 12.0
"""Extent of areas and lines of landmarks beyond the path, metres."""
STEPS = 4
"""Marks on stairs in the space of a landmark elsewhere."""
TALL_M = 5.0
"""Half the height over which landmarks are spread in space, metres."""


@dataclass(frozen=True, eq=False)
class Place:
    """A path and the landmarks along it, map frame, metres.

    `way` (k, 3): corners of the path; `landmarks_map` (m, 3); `planar`: whether everything is in
    the plane z = 0.
    """

    way: Floats
    landmarks_map: Floats
    planar: bool


def streets(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return a grid of four blocks whose streets are driven so that six loops close."""
    nodes = "00 10 20 21 22 12 02 01 00 10 11 12 02 01 11 21 20 10 00"
    corners = np.array([[int(node[0]), int(node[1]), 0.0] for node in nodes.split()])
    return _along(corners * length_m / (len(corners) - 1), spacing_m, rng)


def corridor(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return a straight path, driven there and back."""
    end = length_m / 2
    return _along(np.array([[0.0, 0, 0], [end, 0, 0], [end, 2, 0], [0, 2, 0]]), spacing_m, rng)


def ring(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return a circle that is driven round once, and a tenth of it again."""
    angle = np.linspace(0, 2.2 * np.pi, 400)
    radius = length_m / (2.2 * np.pi)
    circle = [np.sin(angle), 1 - np.cos(angle), 0 * angle]
    return _along(radius * np.column_stack(circle), spacing_m, rng)


def field(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return an area that is covered in strips, and then across them."""
    size = length_m / 9
    strips = [[x * size / 3, y * size, 0.0] for x in range(4) for y in ((0, 1), (1, 0))[x % 2]]
    across = [[x * size, y * size / 3, 0.0] for y in range(4) for x in ((1, 0), (0, 1))[y % 2]]
    low, high = np.full(2, -BEYOND_M), np.full(2, size + BEYOND_M)
    return Place(np.array(strips + across), _scattered(low, high, spacing_m, rng), True)


def clumps(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return a field with clustered landmarks."""
    place = field(length_m, spacing_m * np.sqrt(CLUMP), rng)
    landmarks = np.repeat(place.landmarks_map, CLUMP, axis=0)
    landmarks[:, :2] += rng.normal(0, CLUMP_M, (len(landmarks), 2))
    return Place(place.way, landmarks, True)


def columns(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return a hall with columns on an almost regular lattice."""
    place = field(length_m, spacing_m, rng)
    low, high = place.landmarks_map.min(axis=0), place.landmarks_map.max(axis=0)
    x, y = (np.arange(low[axis], high[axis], spacing_m) for axis in (0, 1))
    lattice = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    lattice += rng.normal(0, JITTER * spacing_m, lattice.shape)
    return Place(place.way, np.column_stack([lattice, np.zeros(len(lattice))]), True)


def line(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return a straight path along landmarks that are almost collinear."""
    count = round((length_m + 2 * BEYOND_M) / spacing_m)
    x = rng.uniform(-BEYOND_M, length_m + BEYOND_M, count)
    y = ASIDE_M + rng.normal(0, THIN * spacing_m, count)
    way = np.array([[0.0, 0, 0], [length_m, 0, 0]])
    return Place(way, np.column_stack([x, y, 0 * x]), True)


def plane(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return a flight over landmarks that are almost coplanar."""
    place = field(length_m, spacing_m, rng)
    landmarks = place.landmarks_map
    landmarks[:, 2] = rng.normal(0, THIN * spacing_m, len(landmarks))
    return Place(place.way + np.array([0, 0, ASIDE_M / 2]), landmarks, False)


def stairs(length_m: float, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return stairs round a square well, with a mark on either side at regular distances."""
    side, rise = 6.0, 0.25
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]])
    n = int((length_m + BEYOND_M) / side) + 2
    way = np.column_stack([corners[np.arange(n) % 4], rise * side * np.arange(n)])
    gap_m = spacing_m / STEPS
    middle = places_along(way, side * np.arange(n), np.arange(0, side * (n - 1), gap_m))
    outward = middle[:, :2] - side / 2
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    marks = np.concatenate([middle, middle])
    marks[:, :2] += np.concatenate([outward, -outward])
    marks += rng.normal(0, JITTER * gap_m, marks.shape)
    return Place(way[: int(length_m / side) + 1], marks, False)


KINDS: dict[str, Callable[[float, float, np.random.Generator], Place]] = {
    make.__name__: make
    for make in (streets, corridor, ring, field, clumps, columns, line, plane, stairs)
}


def raised(place: Place, rng: np.random.Generator) -> Place:
    """Return a planar place in space: landmarks at all heights, and a path up and down."""
    landmarks, way = place.landmarks_map.copy(), sampled(place.way, FINE_M)
    landmarks[:, 2] = rng.uniform(-TALL_M, TALL_M, len(landmarks))
    way[:, 2] = 1.0 * np.sin(np.arange(len(way)) * FINE_M / 15.0)
    return Place(way, landmarks, False)


def sampled(way: Floats, step_m: float) -> Floats:
    """Return the points (n, 3) of a path at a given spacing."""
    lengths = lengths_along(way)
    return places_along(way, lengths, np.arange(0, lengths[-1] + 1e-9, step_m))


def driven(way: Floats, iterations: int) -> tuple[Floats, Floats]:
    """Return positions and directions (k, 3) along a path with rounded corners."""
    from scipy.ndimage import gaussian_filter1d

    fine = gaussian_filter1d(sampled(way, FINE_M), ROUNDING_M / FINE_M, axis=0, mode="nearest")
    ahead = np.gradient(fine, axis=0)
    at = np.linspace(0, len(fine) - 1, iterations)
    both = places_along(np.hstack([fine, ahead]), np.arange(len(fine)), at)
    return both[:, :3], both[:, 3:]


def _along(way: Floats, spacing_m: float, rng: np.random.Generator) -> Place:
    """Return a planar path with landmarks scattered uniformly on both sides of it."""
    low, high = way.min(axis=0) - ASIDE_M, way.max(axis=0) + ASIDE_M
    landmarks = _scattered(low[:2], high[:2], spacing_m, rng)
    middle = sampled(way, 1.0)[:, :2]
    apart = [np.hypot(*(middle - landmark[:2]).T).min() for landmark in landmarks]
    return Place(way, landmarks[np.array(apart) <= ASIDE_M], True)


def _scattered(low: Floats, high: Floats, spacing_m: float, rng: np.random.Generator) -> Floats:
    """Return landmarks (m, 3) in the rectangle from `low` to `high`, (2,) each, at z = 0."""
    landmarks = np.zeros((max(round(np.prod(high - low) / spacing_m**2), 1), 3))
    landmarks[:, :2] = rng.uniform(low, high, (len(landmarks), 2))
    return landmarks
