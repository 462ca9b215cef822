"""Surfaces and outlines of planes: where two planes meet, both end in the same straight edge."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes3d.surfaces import Raster, raster
from relmap.segmentation.space import Patches

CROSS = np.sin(np.deg2rad(20.0))
"""Minimum sine of the angle between planes that meet in an edge."""
BAND = 1.2
"""A surface reaches a line that is at most this many squares from its nearest cell."""
BEYOND, FEW = 4.0, 0.2
"""A surface ends in a line if, within the first number of squares, at most this fraction of the
cells is on one side."""
HALF = 0.5
"""Cells nearer to the line than this are on no side of it."""
SHORTEST, LONGER = 2, 3
"""Minimum length of an edge, and by how much it may be longer than what both planes show of it,
squares."""
CORNER, CUT = 2.5, 2.0
"""Edges that end within the first number of squares from the crossing of their lines meet there;
the outline cuts such a corner by less than the second."""
LEVEL = 0.4
"""Value of a field at the outline."""
UNSEEN, ENDS = -1, -2
"""Pieces of an outline that meet no plane: nothing was seen beyond, or scans saw through there."""
RIM = 2.0
"""Largest distance of a piece of the outline from a point that a scan saw through, squares."""


@dataclass(frozen=True)
class Edge:
    """A stretch of a line in which a surface ends because another plane meets it; in squares.

    `plane`: index of the other plane; `normal` (2,): unit vector across the line, to the side of
    the surface; `offset`: of the line; `begin`, `end`: of the stretch along the line.
    """

    plane: int
    normal: Floats
    offset: float
    begin: float
    end: float

    def place(self, points: Floats) -> tuple[Floats, Floats]:
        """Return how far points (..., 2) are inside the line, and beyond the ends of the stretch.

        The second is negative within the stretch.
        """
        along = points @ np.array([-self.normal[1], self.normal[0]])
        beyond = np.maximum(self.begin - along, along - self.end)
        return np.asarray(points @ self.normal - self.offset), np.asarray(beyond)

    def crossing(self, other: Edge) -> Floats | None:
        """Return where the lines of two edges cross (2,); None if they are nearly parallel."""
        lines = np.stack([self.normal, other.normal])
        if abs(np.linalg.det(lines)) < CROSS:
            return None
        return np.asarray(np.linalg.solve(lines, [self.offset, other.offset]))

    def lengthened(self, point: Floats) -> Edge:
        """Return the edge with a stretch that reaches a point (2,) of the line."""
        along = float(point @ [-self.normal[1], self.normal[0]])
        return replace(self, begin=min(self.begin, along), end=max(self.end, along))


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of a plane, with straight edges where others meet it.

    `field` (a, b): at the middles of the squares of the raster; at least `LEVEL` on the surface.
    `rim` (r, 2), squares: points beyond it that scans saw through.
    """

    raster: Raster
    edges: list[Edge]
    field: Floats
    rim: Floats

    def outline(self) -> tuple[Floats, Ints]:
        """Return the outline (k, 3) of the largest part, anticlockwise as seen from its front.

        Returns also for each corner the plane (k,) that meets the surface between this corner
        and the next, `ENDS` if the surface ends there, `UNSEEN` if nothing was seen beyond.
        """
        from contourpy import contour_generator  # comes with matplotlib, as Pillow does

        lines = [np.asarray(line) for line in contour_generator(z=self.field.T).lines(LEVEL)]
        # Positive if anticlockwise.
        areas = [(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2 for x, y in (line.T for line in lines)]
        if not areas:
            return np.empty((0, 3)), np.empty(0, dtype=np.int64)
        largest = int(np.argmax(np.abs(areas)))
        line = lines[largest][:-1]
        line, of = self._straight((line if areas[largest] > 0 else line[::-1]) + 0.5)
        planes = np.array([*(edge.plane for edge in self.edges), UNSEEN], dtype=np.int64)
        middle = (line + np.roll(line, -1, axis=0)) / 2
        meets, near = planes[of], cKDTree(self.rim).query(middle)[0] < RIM
        return self.raster.in_space(line), np.where((meets == UNSEEN) & near, ENDS, meets)

    def _straight(self, line: Floats) -> tuple[Floats, Ints]:
        """Return the corners (k, 2) of a closed line, and the edge that follows each, or -1."""
        following, of = np.roll(line, -1, axis=0), np.full(len(line), -1)
        for k, edge in enumerate(self.edges):
            (here, beyond), (there, further) = edge.place(line), edge.place(following)
            on = (np.abs(here) < 1e-6) & (np.abs(there) < 1e-6)
            of[on & (np.minimum(beyond, further) < 1)] = k
        corner = (of != np.roll(of, 1)) | (of < 0)
        line, of = line[corner], of[corner]
        straight = np.flatnonzero(of >= 0)
        gone = np.zeros(len(line), dtype=bool)
        for k, after in zip(straight.tolist(), np.roll(straight, -1).tolist(), strict=True):
            # The field is linear within a square and so cuts corners.
            between = (k + 1 + np.arange((after - k - 1) % len(line) + 1)) % len(line)
            at = self.edges[of[k]].crossing(self.edges[of[after]])
            if at is not None and np.abs(line[between] - at).max() < CUT:
                gone[between[:-1]], line[after] = True, at
        return line[~gone], of[~gone]

    def polygons(self) -> list[Floats]:
        """Return convex polygons (k, 3) that cover the surface."""
        inside = self.field >= LEVEL
        corners = inside[:-1, :-1], inside[1:, :-1], inside[1:, 1:], inside[:-1, 1:]
        full, partly = np.logical_and.reduce(corners), np.logical_or.reduce(corners)
        found = list(_runs(full))
        for x, y in np.argwhere(partly & ~full).tolist():
            found.append(_cut(self.field, x, y))
        return [self.raster.in_space(polygon + 0.5) for polygon in found]


def surfaces_of(planes: Patches, chosen: Ints) -> list[Surface]:
    """Return the surfaces of planes; only the chosen ones (k,) meet each other."""
    met = np.isin(np.arange(len(planes)), chosen)
    found = []
    for k in range(len(planes)):
        surface = raster(planes, k)
        edges = _meeting(list(_edges(surface, planes, k, met))) if met[k] else []
        rim = surface.in_squares(planes.rim[planes.rim_patch == k])
        found.append(Surface(surface, edges, _field(surface, edges), rim))
    return found


def _edges(surface: Raster, planes: Patches, k: int, met: Bools) -> Iterator[Edge]:
    """Yield the edges of a plane: stretches where another one reaches it and it does not go on."""
    own = surface.in_squares(planes.cells[planes.cell_patch == k])
    across_m = planes.cells @ planes.normal[k] - planes.offset[k]
    near = (np.abs(across_m) < BAND * surface.size_m) & met[planes.cell_patch]
    for other in np.unique(planes.cell_patch[near]).tolist():
        slope = np.stack([surface.u, surface.v]) @ planes.normal[other]
        sine = float(np.linalg.norm(slope))
        if other == k or sine < CROSS:
            continue
        corner = surface.in_space(np.zeros((1, 2)))[0]
        offset = (planes.offset[other] - planes.normal[other] @ corner) / sine / surface.size_m
        line = Edge(other, slope / sine, float(offset), -np.inf, np.inf)
        cells = surface.in_squares(planes.cells[near & (planes.cell_patch == other)])
        yield from _stretches(line, own, cells)


def _stretches(line: Edge, own: Floats, cells: Floats) -> Iterator[Edge]:
    """Yield where cells of another plane (c, 2) are on a line in which a surface, (n, 2), ends."""
    way = np.array([-line.normal[1], line.normal[0]])
    off, along = own @ line.normal - line.offset, own @ way
    begin = np.floor(along.min(initial=0.0)) - 1
    count = int(along.max(initial=0.0) - begin) + 2
    on = np.abs(cells @ line.normal - line.offset) < BAND
    near = _reached(along[np.abs(off) < BAND] - begin, count)
    met = near & _reached(cells[on] @ way - begin, count)
    place = np.floor(along - begin).astype(np.int64)
    bounds = zip((-BEYOND, -HALF, HALF), (-HALF, HALF, BEYOND), strict=True)
    sides = [np.bincount(place[(off > low) & (off <= high)], minlength=count)
             for low, high in bounds]  # fmt: skip
    for first, last in _spans(met):
        if last - first < SHORTEST:
            continue
        left, middle, right = (on[first:last].sum() for on in sides)
        if min(left, right) > FEW * max(left, right) or max(left, right) < middle:
            continue
        sign = 1.0 if right > left else -1.0
        first, last = _lengthened(first, last, near & (sides[0 if sign > 0 else 2] == 0))
        shown = along[(np.abs(off) < BAND) & (place >= first) & (place < last)]
        if len(shown):
            ends = sorted((sign * float(shown.min()), sign * float(shown.max())))
            yield Edge(line.plane, sign * line.normal, sign * line.offset, *ends)


def _lengthened(first: int, last: int, free: Bools) -> tuple[int, int]:
    """Return a span that is longer where the surface ends too, and the other was not seen."""
    begin = next((k for k in range(first, first - LONGER, -1) if not free[k - 1]), first - LONGER)
    end = next((k for k in range(last, last + LONGER) if not free[k : k + 1].any()), last + LONGER)
    return begin, end


def _meeting(edges: list[Edge]) -> list[Edge]:
    """Return the edges; those that end near the crossing of their lines reach it."""
    found = list(edges)
    for a, b in itertools.combinations(range(len(edges)), 2):
        at = edges[a].crossing(edges[b])
        if at is not None and max(abs(edges[k].place(at)[1]) for k in (a, b)) < CORNER:
            found[a], found[b] = (found[k].lengthened(at) for k in (a, b))
    return found


def _reached(along: Floats, count: int) -> Bools:
    """Return which of `count` places hold a point, or lie between two that do."""
    from scipy.ndimage import binary_closing

    place = np.floor(along).astype(np.int64)
    held = np.zeros(count + 4, dtype=bool)
    held[2 + place[(place >= 0) & (place < count)]] = True
    return np.asarray(binary_closing(held, np.ones(5, dtype=np.bool_)))[2:-2]


def _spans(held: Bools) -> list[tuple[int, int]]:
    """Return the first and the end of each run of True."""
    change = np.diff(np.pad(held.astype(np.int8), 1))
    ends = np.flatnonzero(change == 1).tolist(), np.flatnonzero(change == -1).tolist()
    return list(zip(*ends, strict=True))


def _field(surface: Raster, edges: list[Edge]) -> Floats:
    """Return the field of a surface, whose outline is straight along the edges."""
    from scipy.ndimage import gaussian_filter

    middle = np.asarray(np.moveaxis(np.indices(surface.filled.shape), 0, -1) + 0.5, float)
    placed = [edge.place(middle) for edge in edges]
    filled = surface.filled.copy()
    for off, beyond in placed:
        filled |= (np.abs(off) < BAND) & (beyond < 0.5)
    field = gaussian_filter(filled.astype(np.float64), 0.6)
    for off, beyond in placed:
        # Squares beyond the line are cut where the surface only sticks out.
        ends = (beyond < 1) & ((off > -BAND) | ~surface.filled)
        field = np.where(ends, np.minimum(field, LEVEL + off / 2), field)
    return np.asarray(field)


def _runs(full: Bools) -> Iterator[Floats]:
    """Yield the corners (4, 2) of rectangles that cover squares (a, b), one per run of a row."""
    for row in range(len(full)):
        for begin, end in _spans(full[row]):
            yield np.array([(row, begin), (row + 1, begin), (row + 1, end), (row, end)], float)


def _cut(field: Floats, x: int, y: int) -> Floats:
    """Return the part (k, 2) of a square, by its first corner, in which the field is high."""
    ring = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)]
    found: list[tuple[float, float]] = []
    for at, to in zip(ring, ring[1:] + ring[:1], strict=True):
        low, high = field[at] - LEVEL, field[to] - LEVEL
        if low >= 0:
            found.append(at)
        if (low >= 0) != (high >= 0):
            share = low / (low - high)
            found.append((at[0] + share * (to[0] - at[0]), at[1] + share * (to[1] - at[1])))
    return np.array(found, dtype=np.float64)
