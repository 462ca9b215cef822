"""Walls of a 2-D laser scan, whose points come in the order of the beams.

Broken where the range jumps (the adaptive distance of Borges and Aldon, "Line extraction in 2D
range images for mobile robotics", 2004), split where a line does not fit, joined again where it
does.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.em.mixture import WallMixture, scan_area
from relmap.segmentation.noise import FLOOR_M
from relmap.segmentation.wall import BEGIN, END

CHANCE = 1e-3
"""Points that form a line by chance with a greater probability are not a wall."""
MEDIAN = 0.6745
"""Median of the magnitude of normal noise, in standard deviations."""
INLIER = 5 / MEDIAN
"""Five standard deviations, in such medians: what lies farther off is not noise."""
ROUNDS = 10
NOISE_AT_LEAST_M = 0.005
"""Real walls are not flatter than this."""


def beam_noise(xy: Floats) -> float:
    """Return the noise (metres) from how far each point lies off the chord of its neighbours.

    Corners and ends of walls are left out; the fewer the beams, the more of them there are.
    """
    if len(xy) < 5:
        return FLOOR_M
    a, b, c = xy[:-2], xy[1:-1], xy[2:]
    chord = c - a
    length = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-12)
    off = np.abs(chord[:, 0] * (b - a)[:, 1] - chord[:, 1] * (b - a)[:, 0]) / length
    middle = np.median(off)
    for _ in range(ROUNDS):
        before, middle = middle, np.median(off[off <= INLIER * middle])
        if middle == before:
            break
    return max(float(middle) / (MEDIAN * math.sqrt(1.5)), FLOOR_M)


def scan_walls(xy: Floats, noise: float | None) -> tuple[WallMixture, Ints]:
    """Return the walls of points (n, 2) in the order of their beams, and the wall of each.

    Parameters
    ----------
    xy : (n, 2) float64, robot frame, metres
        Right to left or left to right.
    noise : float or None
        Metres; estimated where None.
    """
    from relmap.segmentation.scanline.beam_kernels import line_pieces, piece_walls

    sigma = beam_noise(xy) if noise is None else max(noise, FLOOR_M)
    pieces = line_pieces(np.ascontiguousarray(xy), max(sigma, NOISE_AT_LEAST_M), CHANCE)
    walls = piece_walls(xy, pieces)
    solid = walls[:, END] - walls[:, BEGIN] > NOISE_AT_LEAST_M
    walls, pieces = walls[solid], pieces[solid]
    labels = np.full(len(xy), -1)
    for k, (first, last) in enumerate(pieces):
        labels[first:last] = k
    beam = abs(_beam_step(np.unwrap(np.arctan2(xy[:, 1], xy[:, 0]))))
    return WallMixture(walls, sigma, 0.0, scan_area(xy, sigma), beam=beam), labels


def _beam_step(bearing: Floats) -> float:
    """Return the angle (radians) from one beam to the next, positive to the left."""
    return float(np.median(np.diff(bearing))) if len(bearing) > 1 else 0.0


def extend_to_beams(mixture: WallMixture, xy: Floats, labels: Ints) -> WallMixture:
    """Return walls with their ends half a beam farther out, but for the scan's own ends.

    An end lies anywhere between its last beam and the next one, which meets something else.
    """
    if len(mixture.walls) == 0:
        return mixture
    bearing = np.unwrap(np.arctan2(xy[:, 1], xy[:, 0]))
    step = 0.5 * _beam_step(bearing)
    walls = mixture.walls.copy()
    for k, wall in enumerate(walls):
        own = np.flatnonzero(labels == k)
        for end, i, side in ((BEGIN, own[0], -1), (END, own[-1], 1)):
            if 0 < i < len(xy) - 1:
                wall[end] = _where_met(wall, bearing[i] + side * step, wall[end])
    return mixture.with_walls(walls)


def hidden_ends(xy: Floats, labels: Ints) -> Bools:
    """Tell which ends (k, 2) of the walls of a scan have something nearer just beside them.

    However few beams meet it: a wall seen too steeply to be found hides others all the same.
    """
    from relmap.segmentation.scanline.beam_kernels import range_breaks

    broken = range_breaks(xy, max(beam_noise(xy), NOISE_AT_LEAST_M))
    radius = np.hypot(xy[:, 0], xy[:, 1])
    hidden = np.zeros((int(labels.max(initial=-1)) + 1, 2), dtype=np.bool_)
    for k in range(len(hidden)):
        own = np.flatnonzero(labels == k)
        i, j = own[0], own[-1]
        hidden[k, 0] = i > 0 and broken[i - 1] and radius[i - 1] < radius[i]
        hidden[k, 1] = j + 1 < len(xy) and broken[j] and radius[j + 1] < radius[j]
    return hidden


def _where_met(wall: Floats, bearing: float, otherwise: float) -> float:
    """Return how far along a wall a beam meets it, where that is near its end."""
    ray = np.array([np.cos(bearing), np.sin(bearing)])
    across = wall[2] * ray[1] - wall[3] * ray[0]
    if abs(across) < np.sin(np.deg2rad(3.0)):
        return otherwise
    return float((wall[1] * ray[0] - wall[0] * ray[1]) / across)
