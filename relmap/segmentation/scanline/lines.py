"""Walls of a 2-D laser scan, whose points are ordered by beam.

The scan is broken where the range jumps (the adaptive distance of Borges and Aldon, "Line
extraction in 2D range images for mobile robotics", 2004), split where a line does not fit, and
joined again where it does.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.em.mixture import WallMixture, scan_area
from relmap.segmentation.noise import FLOOR_M
from relmap.segmentation.wall import BEGIN, END, PX, PY, UX, UY

CHANCE = 1e-3
"""Largest probability that the points of a wall form a line by chance."""
MEDIAN = 0.6745
"""Median of the magnitude of normal noise, in standard deviations."""
INLIER = 5 / MEDIAN
"""Five standard deviations, in such medians: larger deviations are not noise."""
ROUNDS = 10
MANY = 1 / 12
"""Fraction of beams on small isolated objects above which the scan shows clutter."""
BOWED, EXPLAINED = 2.0, 0.4
"""Bow of the pieces of a curve, in standard deviations, and allowed difference between turn and
bow."""
NEXT = 2
"""Largest difference of point numbers between the end of a piece and the start of the next."""
NOISE_AT_LEAST_M = 0.005
"""Minimum deviation of real walls from flatness."""


def beam_noise(xy: Floats) -> float:
    """Return the noise (metres) from the distance of each point from the chord of its neighbours.

    Corners and ends of walls are excluded; with fewer beams they are more frequent.
    """
    from relmap.segmentation.scanline.beam_kernels import off_chords

    if len(xy) < 5:
        return FLOOR_M
    middle = off_chords(np.ascontiguousarray(xy), INLIER, ROUNDS)
    return max(middle / (MEDIAN * math.sqrt(1.5)), FLOOR_M)


def scan_walls(xy: Floats, noise: float | None) -> tuple[WallMixture, Ints]:
    """Return the walls of points (n, 2) in the order of their beams, and the wall of each.

    `xy` (n, 2), robot frame, metres: right to left or left to right. `noise`: metres; None:
    estimated.
    """
    from relmap.segmentation.scanline.beam_kernels import line_pieces, piece_walls

    sigma = beam_noise(xy) if noise is None else max(noise, FLOOR_M)
    solid = _beyond_clutter(xy, max(sigma, NOISE_AT_LEAST_M))
    own = np.ascontiguousarray(xy[solid])
    if noise is None and len(own) < len(xy):
        sigma = beam_noise(own)
    pieces = line_pieces(own, solid, max(sigma, NOISE_AT_LEAST_M), CHANCE)
    walls = piece_walls(own, pieces)
    kept = walls[:, END] - walls[:, BEGIN] > NOISE_AT_LEAST_M
    walls, pieces = walls[kept], pieces[kept]
    labels = np.full(len(xy), -1)
    for k, (first, last) in enumerate(pieces):
        labels[solid[first:last]] = k
    beam = abs(_beam_step(_bearings(xy)))
    return WallMixture(walls, sigma, 0.0, scan_area(xy, sigma), beam=beam), labels


def _beyond_clutter(xy: Floats, sigma: float) -> Ints:
    """Return the remaining points (k,) without specks; all points if specks are few.

    Otherwise an object in front of a wall, such as a door jamb, is a valid landmark.
    """
    from relmap.segmentation.scanline.speck_kernels import specks

    speck = specks(np.ascontiguousarray(xy), sigma)
    alone = speck[1:-1] & ~speck[:-2] & ~speck[2:]
    return np.flatnonzero(~speck | (alone.sum() < MANY * len(xy)))


def _bearings(xy: Floats) -> Floats:
    """Return the bearings (n,) of points, radians, without jumps."""
    bearing = np.arctan2(xy[:, 1], xy[:, 0])
    turns = np.cumsum(np.rint(np.diff(bearing) / (2 * np.pi)))
    bearing[1:] -= 2 * np.pi * turns
    return np.asarray(bearing)


def _beam_step(bearing: Floats) -> float:
    """Return the angle (radians) from one beam to the next, positive to the left."""
    step = np.sort(np.diff(bearing))
    return float(step[(len(step) - 1) // 2] + step[len(step) // 2]) / 2 if len(step) else 0.0


def _first_and_last(labels: Ints) -> tuple[Ints, Ints]:
    """Return the first and the last point of each wall; labels (n,) ascend, except -1."""
    rows = np.flatnonzero(labels >= 0)
    bounds = np.arange(int(labels.max(initial=-1)) + 2)
    begin = np.searchsorted(labels[rows], bounds)
    return rows[begin[:-1]], rows[begin[1:] - 1]


def extend_to_beams(mixture: WallMixture, xy: Floats, labels: Ints) -> WallMixture:
    """Return walls extended by half a beam at each end, except at the ends of the scan.

    An end is uniform between its last beam and the next one, which hits something else.
    """
    if len(mixture.walls) == 0:
        return mixture
    bearing, walls = _bearings(xy), mixture.walls.copy()
    step = 0.5 * _beam_step(bearing)
    for end, rows, side in zip((BEGIN, END), _first_and_last(labels), (-1, 1), strict=True):
        met = _where_met(walls, bearing[rows] + side * step, walls[:, end])
        inside = (rows > 0) & (rows < len(xy) - 1)
        walls[:, end] = np.where(inside, met, walls[:, end])
    return mixture.with_walls(walls)


def hidden_ends(xy: Floats, labels: Ints) -> Bools:
    """Return which ends (k, 2) of walls have something nearer right next to them.

    A few beams suffice: a wall at a grazing angle may be undetected but still hides others.
    """
    from relmap.segmentation.scanline.beam_kernels import range_breaks

    broken = range_breaks(xy, max(beam_noise(xy), NOISE_AT_LEAST_M))
    radius = np.hypot(xy[:, 0], xy[:, 1])
    first, last = _first_and_last(labels)
    right, left = np.maximum(first - 1, 0), np.minimum(last + 1, len(xy) - 1)
    hidden = [
        (broken[right] > 0) & (radius[right] < radius[first]) & (first > 0),
        (broken[last] > 0) & (radius[left] < radius[last]),
    ]
    return np.column_stack(hidden)


def on_curves(mixture: WallMixture, xy: Floats, labels: Ints) -> Bools:
    """Return which ends (k, 2) of walls are not corners because the surface continues as a curve.

    Where a curve is cut into straight pieces depends on the point of view.
    """
    along, swing = mixture.walls[:, UX : UY + 1], _swings(mixture, xy, labels)
    x, y = (along[:-1] * along[1:]).sum(axis=1), along[:-1, 0] * along[1:, 1]
    turn = np.arctan2(y - along[:-1, 1] * along[1:, 0], x)
    first, last = _first_and_last(labels)
    goes_on = (first[1:] - last[:-1] <= NEXT) & (swing[:-1] * turn > 0) & (swing[1:] * turn > 0)
    goes_on &= np.abs(turn - swing[:-1] - swing[1:]) < EXPLAINED * np.abs(turn)
    return np.column_stack([np.append(False, goes_on), np.append(goes_on, False)])


def _swings(mixture: WallMixture, xy: Floats, labels: Ints) -> Floats:
    """Return the turn of each wall (k,) from its middle to its end, radians; 0 if uncertain."""
    walls, own = mixture.walls, np.flatnonzero(labels >= 0)
    of, n = labels[own], len(walls)
    x, y = (xy[own] - walls[of, :2]).T
    place = x * walls[of, UX] + y * walls[of, UY]
    off = y * walls[of, UX] - x * walls[of, UY]

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(of, values, minlength=n), dtype=np.float64)

    count = np.bincount(of, minlength=n)
    place -= (total(place) / count)[of]
    # Difference between a parabola and its line, and the part of it in the residuals.
    slope, level = total(place**3) / total(place**2), total(place**2) / count
    bend = place**2 - slope[of] * place - level[of]
    weight = np.maximum(total(bend**2), 1e-12)
    bow, sd = total(off * bend) / weight, max(mixture.sigma, NOISE_AT_LEAST_M) / np.sqrt(weight)
    sure = (np.abs(bow) > BOWED * sd) & (count > 3)
    return np.asarray(np.where(sure, bow * (walls[:, END] - walls[:, BEGIN]), 0.0))


def _where_met(walls: Floats, bearing: Floats, otherwise: Floats) -> Floats:
    """Return the spacing of beams along walls (k,), near their ends."""
    c, s = np.cos(bearing), np.sin(bearing)
    across = walls[:, UX] * s - walls[:, UY] * c
    steep = np.abs(across) >= np.sin(np.deg2rad(3.0))
    met = (walls[:, PY] * c - walls[:, PX] * s) / np.where(steep, across, 1.0)
    return np.where(steep, met, otherwise)
