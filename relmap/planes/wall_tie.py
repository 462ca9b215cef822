"""Alignment of the walls of one map to those of another.

Walls are sampled as points with the direction of their front. A histogram of directions gives
candidate rotations; for each of these, a correlation of the points in coarse cells gives candidate
translations. The best motions are fitted to the walls and compared by the length of overlapping
wall.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints

SAMPLE_M = 0.1
"""Spacing of the points along a wall."""
CELL_M = 0.2
DIRECTIONS = 8
"""Number of direction bins; walls match those in the same or an adjacent bin."""
TURNS, SHIFTS = 8, 6
"""Number of candidate rotations, and of translations for each."""
BIN_RAD, APART_RAD = np.deg2rad(1.0), np.deg2rad(4.0)
"""Bins of the histogram of rotations, and least distance between two peaks."""
NEAR_M, TURN = 0.1, np.cos(np.deg2rad(5.0))
"""Largest distance and rotation (cosine) of a point that lies on a wall."""
EXACTLY, LEAST_NEAR_M = 3.0, 0.005
"""Rivals are compared within this multiple of the best deviation, and at least this distance."""
ROUNDS, FIRST = 8, 4.0
"""Rounds of a fit, and initial tolerance, in units of `NEAR_M`."""
ALIKE_M = 0.5
"""Motions that place all walls within this distance of each other are the same."""
LEAST_M = 6.0
"""Length of wall that must overlap."""
RIVAL = 0.7
"""Fraction of it that may overlap elsewhere."""
COINCIDING = 0.5
"""Fraction of a wall that must lie on another one if both are the same."""
ENDS_M = 0.15
"""Largest distance between ends of walls that coincide; twice as far apart, they are two places."""
ACROSS = 0.1
"""Minimum fraction of it that must prevent the maps from sliding along the rest."""


@dataclass(frozen=True, eq=False)
class WallPoints:
    """Points sampled along walls.

    Attributes
    ----------
    at, normal : (n, 2) float64
        Positions, metres, and unit vectors to the front.
    wall : (n,) int64
        Row of the wall of each point.
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

    def moved(self, R: Floats, t: Floats) -> WallPoints:
        """Return the points rotated by R (2, 2) and shifted by t (2,)."""
        return WallPoints(self.at @ R.T + t, self.normal @ R.T, self.wall)

    @property
    def angle(self) -> Floats:
        """Direction of the front of each, radians."""
        return np.arctan2(self.normal[:, 1], self.normal[:, 0])


@dataclass(frozen=True, eq=False)
class WallTie:
    """A motion from one map to the frame of another.

    Attributes
    ----------
    R, t : (2, 2), (2,) float64
    length_m : float
        Length of overlapping wall.
    across : float
        Fraction of this that prevents sliding: 0 if all walls are parallel.
    rms_m : float
        Deviation of these walls.
    """

    R: Floats
    t: Floats
    length_m: float
    across: float = 0.0
    rms_m: float = np.inf


def wall_ties(ends: Floats, others: Floats) -> list[WallTie]:
    """Return candidate alignments of walls (w, 2, 2) to others (v, 2, 2), by overlap."""
    points, among = WallPoints.of(ends), WallPoints.of(others)
    if not (len(points.at) and len(among.at)):
        return []
    tree = cKDTree(among.at)
    found: list[WallTie] = []
    for turn in _turns(points, among):
        for guess in _shifts(points, among, turn):
            fitted = _fitted(points, among, tree, guess)
            if not any(_alike(points, fitted, other) for other in found):
                found.append(fitted)
    if not found:
        return []
    best = max(found, key=lambda tie: tie.length_m)
    # Walls that only look alike coincide less exactly than identical ones.
    near_m = float(np.clip(EXACTLY * best.rms_m, LEAST_NEAR_M, NEAR_M))
    judged = [
        replace(
            tie, length_m=SAMPLE_M * np.count_nonzero(lying(points, among, tree, tie, near_m)[0])
        )
        for tie in found
    ]
    return sorted(judged, key=lambda tie: -tie.length_m)


def _turns(points: WallPoints, among: WallPoints) -> list[float]:
    """Return the rotations that align most fronts with the directions of others."""
    from scipy.ndimage import maximum_filter

    bins = round(2 * np.pi / BIN_RAD)
    counts = [
        np.bincount(np.floor(each.angle / BIN_RAD).astype(int) % bins, minlength=bins)
        for each in (points, among)
    ]
    spectra = [np.fft.rfft(count) for count in counts]
    score = np.fft.irfft(np.conj(spectra[0]) * spectra[1], bins)
    score += np.roll(score, 1) + np.roll(score, -1)
    peaks = score == maximum_filter(score, round(2 * APART_RAD / BIN_RAD) + 1, mode="wrap")
    order = np.argsort(-np.where(peaks, score, -1.0), kind="stable")[:TURNS]
    return [float(k * BIN_RAD) for k in order if peaks[k]]


def _shifts(points: WallPoints, among: WallPoints, turn: float) -> list[WallTie]:
    """Return the translations, after a rotation, that bring most points into matching cells."""
    from scipy.ndimage import maximum_filter
    from scipy.signal import fftconvolve  # slow to load

    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    turned = points.moved(R, np.zeros(2))
    low, base = turned.at.min(axis=0), among.at.min(axis=0)
    score = np.zeros(1)
    for direction in range(DIRECTIONS):
        here = _cells(turned, low, direction, 0)
        there = maximum_filter(_cells(among, base, direction, 1) > 0, 3).astype(np.float64)
        score = score + fftconvolve(there, here[::-1, ::-1])
    size = round(2 * ALIKE_M / CELL_M) + 1
    peaks = np.flatnonzero(score == maximum_filter(score, size))
    peaks = peaks[np.argsort(-score.ravel()[peaks], kind="stable")][:SHIFTS]
    shape = _shape(turned, low)
    at = np.column_stack(np.unravel_index(peaks, score.shape)) - (np.array(shape) - 1)
    return [WallTie(R, base - low + CELL_M * cell, 0.0) for cell in at]


def _shape(points: WallPoints, low: Floats) -> tuple[int, int]:
    columns, rows = np.floor((points.at.max(axis=0) - low) / CELL_M).astype(int) + 1
    return int(columns), int(rows)


def _cells(points: WallPoints, low: Floats, direction: int, beside: int) -> Floats:
    """Return the number of points per cell whose fronts have a direction, or an adjacent one."""
    off = np.round(points.angle / (2 * np.pi / DIRECTIONS)).astype(int) - direction
    off = (off + DIRECTIONS // 2) % DIRECTIONS - DIRECTIONS // 2
    cells = np.zeros(_shape(points, low))
    at = np.floor((points.at[np.abs(off) <= beside] - low) / CELL_M).astype(int)
    np.add.at(cells, tuple(at.T), 1.0)
    return cells


def _fitted(points: WallPoints, among: WallPoints, tree: cKDTree, guess: WallTie) -> WallTie:
    """Fit a motion to the walls that coincide, alternating with matching."""
    tie = guess
    for k in range(ROUNDS):
        near_m = NEAR_M * max(FIRST / 2**k, 1.0)
        on, other, off = lying(points, among, tree, tie, near_m)
        if np.count_nonzero(on) < 3:
            return replace(tie, length_m=0.0, across=0.0)
        at = points.at[on] @ tie.R.T + tie.t
        tie = _stepped(tie, at, among.normal[other[on]], off[on])
    return tie


def lying(
    points: WallPoints, among: WallPoints, tree: cKDTree, tie: WallTie, near_m: float
) -> tuple[Bools, Ints, Floats]:
    """Return which points lie on walls after a motion.

    Parameters
    ----------
    points, among : WallPoints
    tree : cKDTree
        Tree of `among`.
    tie : WallTie
    near_m : float
        Largest distance.

    Returns
    -------
    on : (n,) bool
    other : (n,) int64
        Row of the nearest of `among`.
    off : (n,) float64
        Distance of each point in front of it.
    """
    moved = points.moved(tie.R, tie.t)
    distance, other = tree.query(moved.at)
    normal = among.normal[other]
    off = np.einsum("ni,ni->n", among.at[other] - moved.at, normal)
    on = (distance <= near_m + SAMPLE_M) & (np.abs(off) <= near_m)
    on &= np.einsum("ni,ni->n", normal, moved.normal) >= TURN
    return on, np.asarray(other, dtype=np.int64), off


def coinciding(ends: Floats, others: Floats, tie: WallTie) -> Ints:
    """Return pairs (k, 2) of walls (w, 2, 2) and others (v, 2, 2) on which they lie, moved."""
    points, among = WallPoints.of(ends), WallPoints.of(others)
    on, other, _ = lying(points, among, cKDTree(among.at), tie, NEAR_M)
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


def _stepped(tie: WallTie, at: Floats, normal: Floats, off: Floats) -> WallTie:
    """Return a motion after one least-squares step on point-to-line distances."""
    centre = at.mean(axis=0)
    arm = at - centre
    lever = arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0]
    reach = max(float(np.sqrt((arm**2).sum(axis=1).mean())), 1e-9)
    J = np.column_stack([normal, lever / reach])
    information = J.T @ J
    step = np.linalg.lstsq(information, J.T @ off, rcond=1e-9)[0]
    turn = step[2] / reach
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    across = float(np.linalg.eigvalsh(normal.T @ normal / len(normal))[0])
    t = R @ (tie.t - centre) + centre + step[:2]
    rms_m = float(np.sqrt((off**2).mean()))
    return WallTie(R @ tie.R, t, SAMPLE_M * len(at), across, rms_m)


def _alike(points: WallPoints, one: WallTie, other: WallTie) -> bool:
    apart = points.at @ (one.R - other.R).T + one.t - other.t
    return bool(np.hypot(*apart.T).max() <= ALIKE_M)
