"""Alignment of the walls of one map to those of another.

Walls are sampled as points with the direction of their front. A histogram of directions gives
candidate rotations; for each of these, a correlation of the points in coarse cells gives candidate
translations. The best motions are fitted to the walls and compared by the length of overlapping
wall.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import rotations, transforms
from relmap.core.state.table import NONE

SAMPLE_M = 0.1
"""Spacing of the points along a wall."""
CELL_M = 0.2
DIRECTIONS = 8
"""Number of direction bins; walls match those in the same or an adjacent bin."""
TURNS, SHIFTS = 8, 6
"""Number of candidate rotations, and of translations for each."""
BIN_RAD, APART_RAD = np.deg2rad(1.0), np.deg2rad(4.0)
"""Bins of the histogram of rotations, and least distance between two peaks."""
NEAR_M, PARALLEL = 0.1, np.cos(np.deg2rad(5.0))
"""Largest distance of a point from the wall that it lies on, and rotation (cosine)."""
EXACTLY, LEAST_NEAR_M = 3.0, 0.005
"""Rivals are compared within this multiple of the best deviation, and at least this distance."""
ROUNDS, FIRST = 8, 4.0
"""Rounds of a fit, and initial tolerance, in units of `NEAR_M`."""
ALIKE_M = 0.5
"""Motions that place all walls within this distance of each other are the same."""
FAR_M = 400.0
"""Points farther than this from the middle of their map propose no translation: a sensor may report
a wall far away that is none, and all translations up to there would be tried."""
LEAST_M, ACROSS = 6.0, 0.1
"""Minimum length of wall that overlaps in an alignment of two maps, and minimum fraction of the
overlap that prevents them from sliding along the rest."""
COINCIDING = 0.5
"""Fraction of a wall that must lie on another one if both are the same."""
ENDS_M = 0.15
"""Largest distance between ends of walls that coincide; twice as far apart, they are two places."""


@dataclass(frozen=True, eq=False)
class WallPoints:
    """Points sampled along walls.

    `at`, `normal` (n, 2): positions, metres, and unit vectors to the front; `wall` (n,): row of the
    wall of each point.
    """

    at: Floats
    normal: Floats
    wall: Ints

    @classmethod
    def of(cls, ends: Floats) -> WallPoints:
        """Return points along walls, given their ends (w, 2, 2), right to left."""
        way = ends[:, 1] - ends[:, 0]
        length = np.hypot(*way.T)
        counts = np.maximum(np.rint(length / SAMPLE_M), 1).astype(np.int64)
        wall = np.repeat(np.arange(len(ends)), counts)
        rank = np.arange(len(wall)) - np.repeat(np.cumsum(counts) - counts, counts)
        at = ends[wall, 0] + ((rank + 0.5) / counts[wall])[:, None] * way[wall]
        along = (way / np.maximum(length, 1e-12)[:, None])[wall]
        return cls(at, np.column_stack([-along[:, 1], along[:, 0]]), wall)

    def central(self) -> WallPoints:
        """Return the points that are not far from the one in the middle; see `FAR_M`."""
        off = np.abs(self.at - np.median(self.at, axis=0)).sum(axis=1)
        near = (np.abs(self.at - self.at[np.argmin(off)]) <= FAR_M).all(axis=1)
        return self if near.all() else WallPoints(self.at[near], self.normal[near], self.wall[near])

    @property
    def angle(self) -> Floats:
        """Direction of the front of each, radians."""
        return np.arctan2(self.normal[:, 1], self.normal[:, 0])

    @cached_property
    def near(self) -> Any:
        """The points in a grid, as the kernels use them."""
        from relmap.core.geometry.spatialindex_kernels import enter

        n, cell_m = len(self.at), FIRST * NEAR_M + SAMPLE_M
        first = np.full(1 << (2 * n).bit_length(), NONE, np.int32)
        following, key = np.full(n, NONE, np.int32), np.full(n, NONE)
        enter(first, (following, key, self.at, np.ones(n)), np.arange(n), cell_m)
        return self.at, self.normal, first, following, key, cell_m


@dataclass(frozen=True, eq=False)
class WallTie:
    """A motion from one map to the frame of another.

    `R` (2, 2), `t` (2,); `length_m`: length of overlapping wall; `across`: fraction of this that
    prevents sliding: 0 if all walls are parallel; `rms_m`: deviation of these walls.
    """

    R: Floats
    t: Floats
    length_m: float
    across: float = 0.0
    rms_m: float = np.inf

    @property
    def motion(self) -> Floats:
        """Cosine and sine of the rotation, and the translation; (4,)."""
        return np.array([self.R[0, 0], self.R[1, 0], *self.t])

    @property
    def matrix(self) -> Floats:
        """The motion as a matrix (4, 4)."""
        return transforms(self.R, self.t)


def wall_ties(ends: Floats, others: Floats) -> list[WallTie]:
    """Return candidate alignments of walls (w, 2, 2) to others (v, 2, 2), by overlap."""
    points, among = WallPoints.of(ends), WallPoints.of(others)
    if not (len(points.at) and len(among.at)):
        return []
    found: list[WallTie] = []
    corners, moved = ends.reshape(-1, 2), np.empty((0, 2 * len(ends), 2))
    for guess in _guesses(points.central(), among.central()):
        fitted = _fitted(points, among, guess)
        there = corners @ fitted.R.T + fitted.t
        if not (np.hypot(*np.moveaxis(moved - there, 2, 0)).max(axis=1) <= ALIKE_M).any():
            found, moved = [*found, fitted], np.concatenate([moved, there[None]])
    best = max(found, key=lambda tie: tie.length_m)
    # Walls that only look alike coincide less exactly than identical ones.
    near_m = float(np.clip(EXACTLY * best.rms_m, LEAST_NEAR_M, NEAR_M))
    judged = [
        replace(
            tie, length_m=SAMPLE_M * np.count_nonzero(lying(points, among, tie, near_m)[0] >= 0)
        )
        for tie in found
    ]
    return sorted(judged, key=lambda tie: -tie.length_m)


def _turns(points: WallPoints, among: WallPoints) -> Floats:
    """Return the rotations (k, 2, 2) that align most fronts with the directions of others."""
    from scipy.ndimage import maximum_filter1d

    bins = round(2 * np.pi / BIN_RAD)
    counts = [
        np.bincount(np.floor(each.angle / BIN_RAD).astype(int) % bins, minlength=bins)
        for each in (points, among)
    ]
    spectra = [np.fft.rfft(count) for count in counts]
    score = np.fft.irfft(np.conj(spectra[0]) * spectra[1], bins)
    score = np.rint(score + np.roll(score, 1) + np.roll(score, -1))
    highest = maximum_filter1d(score, round(2 * APART_RAD / BIN_RAD) + 1, mode="wrap")
    R = rotations(BIN_RAD * _ordered(score, highest)[:, None])
    return R[_apart(R[:, :, 0], APART_RAD, TURNS)]


def _ordered(score: Floats | Ints, highest: Floats | Ints) -> Ints:
    """Return the flat indices of scores that are the highest around them, best first."""
    peaks = np.flatnonzero((score == highest) & (score > 0))
    return peaks[np.argsort(-score.ravel()[peaks], kind="stable")]


def _apart(at: Floats, least: float, most: int) -> list[int]:
    """Return the rows of at most `most` points (n, 2), the first first, `least` from each other.

    Scores count points, so that several neighbours are often equally high.
    """
    kept: list[int] = []
    for k in range(len(at)):
        if len(kept) == most:
            break
        if (np.hypot(*(at[kept] - at[k]).T) >= least).all():
            kept.append(k)
    return kept


def _guesses(points: WallPoints, among: WallPoints) -> Iterator[WallTie]:
    """Yield the motions that bring most points into cells of others with the same direction."""
    from scipy.ndimage import maximum_filter

    from relmap.planes.places.wall_tie_kernels import votes

    base = among.at.min(axis=0)
    there, _ = _cells(among, base, 1)
    begin = np.searchsorted(there[:, 0], np.arange(DIRECTIONS + 1))
    for R in _turns(points, among):
        turned = WallPoints(points.at @ R.T, points.normal @ R.T, points.wall)
        low = turned.at.min(axis=0)
        here, counts = _cells(turned, low, 0)
        last = here[:, 1:].max(axis=0)
        score = votes(here, counts, there, begin, there[:, 1:].max(axis=0) + last + 1)
        highest = maximum_filter(score, round(2 * ALIKE_M / CELL_M) + 1)
        peaks = np.unravel_index(_ordered(score, highest), score.shape)
        t = base - low + CELL_M * (np.column_stack(peaks) - last)
        for kept in _apart(t, ALIKE_M, SHIFTS):
            yield WallTie(R, t[kept], 0.0)


def _cells(points: WallPoints, low: Floats, beside: int) -> tuple[Ints, Ints]:
    """Return the direction, column and row of cells with points, and the number of points in each.

    From the lowest coordinates, in order; points count in so many adjacent directions and cells.
    """
    direction = np.round(points.angle / (2 * np.pi / DIRECTIONS))
    at = np.column_stack([direction, (points.at - low) // CELL_M]).astype(np.int64)
    around = np.indices((2 * beside + 1,) * 3).reshape(3, -1).T - beside
    at = (at[:, None] + around).reshape(-1, 3)
    at[:, 0] %= DIRECTIONS
    at = at[(at[:, 1:] >= 0).all(axis=1)]
    shape = (DIRECTIONS, *(at[:, 1:].max(axis=0) + 1))
    cells, counts = np.unique(np.ravel_multi_index(at.T, shape), return_counts=True)
    return np.column_stack(np.unravel_index(cells, shape)), counts


def _fitted(points: WallPoints, among: WallPoints, guess: WallTie) -> WallTie:
    """Fit a motion to the walls that coincide, alternating with matching."""
    from relmap.planes.places.wall_tie_kernels import fit

    motion = guess.motion
    near_m = NEAR_M * np.maximum(FIRST / 2.0 ** np.arange(ROUNDS), 1.0)
    n, across, rms_m = fit((points.at, points.normal), among.near, motion, near_m)
    c, s, *t = motion.tolist()
    return WallTie(np.array([[c, -s], [s, c]]), np.array(t), SAMPLE_M * n, across, rms_m)


def lying(
    points: WallPoints, among: WallPoints, tie: WallTie, near_m: float
) -> tuple[Ints, Floats]:
    """Return on which of other points each point lies after a motion.

    `near_m`: largest distance from a wall. Returns `other` (n,): row of the nearest of `among`; -1
    if it is not on the same wall. `off` (n,): distance of each point in front of it.
    """
    from relmap.planes.places import wall_tie_kernels

    return wall_tie_kernels.lying((points.at, points.normal), among.near, tie.motion, near_m)


def coinciding(ends: Floats, others: Floats, tie: WallTie) -> Ints:
    """Return pairs (k, 2) of walls (w, 2, 2) and others (v, 2, 2) on which they lie, moved."""
    points, among = WallPoints.of(ends), WallPoints.of(others)
    other, _ = lying(points, among, tie, NEAR_M)
    on = other >= 0
    pairs = np.column_stack([points.wall[on], among.wall[other[on]]])
    pairs, counts = np.unique(pairs, axis=0, return_counts=True)
    length = np.bincount(points.wall, minlength=len(ends))
    return np.asarray(pairs[counts >= COINCIDING * length[pairs[:, 0]]])


def coinciding_ends(ends: Floats, others: Floats, tie: WallTie) -> tuple[int, int]:
    """Return the numbers of walls that coincide, moved, and of places where their ends do too."""
    rows, columns = coinciding(ends, others, tie).T
    moved = ends[rows] @ tie.R.T + tie.t
    left, places = moved[np.hypot(*np.moveaxis(moved - others[columns], 2, 0)) < ENDS_M], 0
    while len(left):
        left, places = left[np.hypot(*(left - left[0]).T) > 2 * ENDS_M], places + 1
    return len(rows), places
