"""Walls of a 2-D laser scan, whose points are ordered by beam.

The scan is broken where the range jumps (the adaptive distance of Borges and Aldon, "Line
extraction in 2D range images for mobile robotics", 2004), split where a line does not fit, and
joined again where it does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.em.mixture import WallMixture, scan_area
from relmap.segmentation.noise import FLOOR_M
from relmap.segmentation.wall import BEGIN, END, PX, PY, UX, UY

MEDIAN = 0.6745
"""Median of the magnitude of normal noise, in standard deviations."""
MANY = 1 / 12
"""Fraction of beams on small isolated objects above which the scan shows clutter."""
BOWED, EXPLAINED = 2.0, 0.4
"""Bow of the pieces of a curve, in standard deviations, and allowed difference between turn and
bow."""
NEXT = 2
"""Largest difference of point numbers between the end of a piece and the start of the next."""
CLOSE, CHORD = 1.5, 3.0
"""Length of the chords from which the noise is estimated, in standard deviations, below which they
are made longer, and up to which."""
NOISE_AT_LEAST_M = 0.005
"""Minimum deviation of real walls from flatness."""
APART = 0.5
"""Largest distance of successive points, as a fraction of that of points half the scan apart,
medians. In random order it is about 1; where half of the beams hit clutter it is 0.3."""
ONWARD = 0.75
"""Fraction of the beams that turn the same way about the robot; half of them in random order."""
LEAST = 50
"""Minimum number of points to judge the order by."""


@dataclass(frozen=True, eq=False)
class LaserScan:
    """The points of a 2-D laser scan and what several steps need to know of them.

    `xy` (n, 2), robot frame, metres: in the order of their beams, right to left or left to right.
    """

    xy: Floats

    @cached_property
    def bearing(self) -> Floats:
        """The bearings (n,) of the points, radians, without jumps."""
        bearing = np.arctan2(self.xy[:, 1], self.xy[:, 0])
        jumps = np.rint((bearing[1:] - bearing[:-1]) / (2 * np.pi))
        if jumps.any():
            bearing[1:] -= 2 * np.pi * np.cumsum(jumps)
        return np.asarray(bearing)

    @cached_property
    def step_rad(self) -> float:
        """The angle from one beam to the next, positive to the left."""
        step = np.sort(self.bearing[1:] - self.bearing[:-1])
        return float(step[(len(step) - 1) // 2] + step[len(step) // 2]) / 2 if len(step) else 0.0

    @cached_property
    def noise_m(self) -> float:
        """The noise; see `beam_noise`."""
        return beam_noise(self.xy)


def is_ordered(xy: Floats) -> bool:
    """Return whether points (n, 2), metres, may be in the order of beams, in either direction."""
    half = len(xy) // 2
    if len(xy) < LEAST:
        return True
    next_m, far_m = (
        float(np.median(np.linalg.norm(xy[step:] - xy[:-step], axis=1))) for step in (1, half)
    )
    turn = np.diff(np.unwrap(np.arctan2(xy[:, 1], xy[:, 0])))
    onward = max(float((turn > 0).mean()), float((turn < 0).mean()))
    return next_m <= APART * far_m or onward >= ONWARD


def beam_noise(xy: Floats) -> float:
    """Return the noise (metres) from the distance of each point from the chord of its neighbours.

    Corners and ends of walls are excluded; with fewer beams they are more frequent. Where
    neighbours are closer than the noise their chords do not lie along the wall: every second point
    is used then, every fourth, and so on.
    """
    from relmap.segmentation.scanline.beam_kernels import off_chords

    if len(xy) < 5:
        return FLOOR_M
    turn = np.abs(np.diff(np.arctan2(xy[:, 1], xy[:, 0])))
    apart_m, every = float(np.median(np.hypot(*xy.T)) * np.median(turn)), 1
    sigma, chord = _noise_of(off_chords(np.ascontiguousarray(xy))), CLOSE
    while len(xy) >= 2 * every * LEAST and 2 * every * apart_m < chord * sigma:
        every, chord = 2 * every, CHORD
        parts = [np.ascontiguousarray(xy[first::every]) for first in range(every)]
        found = _noise_of(float(np.median([off_chords(part) for part in parts])))
        if found <= sigma:  # many corners and edges, not noise
            break
        sigma = found
    return sigma


def _noise_of(off_m: float) -> float:
    """Return the noise from the median distance of points from the chords of their neighbours."""
    return max(off_m / (MEDIAN * math.sqrt(1.5)), FLOOR_M)


def scan_walls(scan: LaserScan, noise: float | None) -> tuple[WallMixture, Ints]:
    """Return the walls of a scan of n points, and the wall of each point (n,), -1 for none.

    `noise`: metres; None: estimated.
    """
    from relmap.segmentation.scanline.beam_kernels import line_pieces, piece_walls

    xy = scan.xy
    sigma = scan.noise_m if noise is None else max(noise, FLOOR_M)
    solid = _beyond_clutter(xy, max(sigma, NOISE_AT_LEAST_M))
    own = np.ascontiguousarray(xy[solid])
    if noise is None and len(own) < len(xy):
        sigma = beam_noise(own)
    pieces = line_pieces(own, solid, max(sigma, NOISE_AT_LEAST_M))
    walls = piece_walls(own, pieces)
    kept = walls[:, END] - walls[:, BEGIN] > NOISE_AT_LEAST_M
    walls, pieces = walls[kept], pieces[kept]
    labels = np.full(len(xy), -1)
    for k, (first, last) in enumerate(pieces.tolist()):
        labels[solid[first:last]] = k
    area, beam = scan_area(xy, sigma), abs(scan.step_rad)
    return WallMixture(walls, sigma, 0.0, area, beam=beam), labels


def _beyond_clutter(xy: Floats, sigma: float) -> Ints:
    """Return the remaining points (k,) without specks; all points if specks are few.

    Otherwise an object in front of a wall, such as a door jamb, is a valid landmark.
    """
    from relmap.segmentation.scanline.speck_kernels import specks

    speck = specks(np.ascontiguousarray(xy), sigma)
    alone = speck[1:-1] & ~speck[:-2] & ~speck[2:]
    return (~speck | (np.count_nonzero(alone) < MANY * len(xy))).nonzero()[0]


def first_and_last(labels: Ints) -> tuple[Ints, Ints]:
    """Return the first and the last point of each wall; labels (n,) ascend, except -1."""
    rows = (labels >= 0).nonzero()[0]
    bounds = np.arange(int(labels.max(initial=-1)) + 2)
    begin = np.searchsorted(labels[rows], bounds)
    return rows[begin[:-1]], rows[begin[1:] - 1]


def extend_to_beams(
    mixture: WallMixture, scan: LaserScan, bounds: tuple[Ints, Ints]
) -> WallMixture:
    """Return walls extended by half a beam at each end, except at the ends of the scan.

    An end is uniform between its last beam and the next one, which hits something else. `bounds`:
    see `first_and_last`.
    """
    if len(mixture.walls) == 0:
        return mixture
    walls, step = mixture.walls.copy(), 0.5 * scan.step_rad
    for end, rows, side in zip((BEGIN, END), bounds, (-1, 1), strict=True):
        bearing = scan.bearing[rows] + side * step
        c, s = np.cos(bearing), np.sin(bearing)
        across = walls[:, UX] * s - walls[:, UY] * c
        steep = np.abs(across) >= np.sin(np.deg2rad(3.0))
        met = (walls[:, PY] * c - walls[:, PX] * s) / np.where(steep, across, 1.0)
        inside = (rows > 0) & (rows < len(scan.xy) - 1)
        walls[:, end] = np.where(inside & steep, met, walls[:, end])
    return mixture.with_walls(walls)


def hidden_ends(scan: LaserScan, bounds: tuple[Ints, Ints]) -> Bools:
    """Return which ends (k, 2) of walls have something nearer right next to them.

    A few beams suffice: a wall at a grazing angle may be undetected but still hides others.
    """
    from relmap.segmentation.scanline.beam_kernels import range_breaks

    xy, (first, last) = scan.xy, bounds
    broken = range_breaks(xy, max(scan.noise_m, NOISE_AT_LEAST_M))
    radius = np.hypot(xy[:, 0], xy[:, 1])
    right, left = np.maximum(first - 1, 0), np.minimum(last + 1, len(xy) - 1)
    hidden = [
        (broken[right] > 0) & (radius[right] < radius[first]) & (first > 0),
        (broken[last] > 0) & (radius[left] < radius[last]),
    ]
    return np.array(hidden).T


def on_curves(mixture: WallMixture, xy: Floats, labels: Ints, bounds: tuple[Ints, Ints]) -> Bools:
    """Return which ends (k, 2) of walls are not corners because the surface continues as a curve.

    Where a curve is cut into straight pieces depends on the point of view.
    """
    (ux, uy), swing = mixture.walls[:, UX : UY + 1].T, _swings(mixture, xy, labels)
    x, y = ux[:-1] * ux[1:] + uy[:-1] * uy[1:], ux[:-1] * uy[1:]
    turn = np.arctan2(y - uy[:-1] * ux[1:], x)
    first, last = bounds
    goes_on = (first[1:] - last[:-1] <= NEXT) & (swing[:-1] * turn > 0) & (swing[1:] * turn > 0)
    goes_on &= np.abs(turn - swing[:-1] - swing[1:]) < EXPLAINED * np.abs(turn)
    curved = np.zeros((len(swing), 2), dtype=np.bool_)
    curved[1:, 0] = curved[:-1, 1] = goes_on
    return curved


def _swings(mixture: WallMixture, xy: Floats, labels: Ints) -> Floats:
    """Return the turn of each wall (k,) from its middle to its end, radians; 0 if uncertain."""
    walls, own = mixture.walls, (labels >= 0).nonzero()[0]
    of, n = labels[own], len(walls)
    x, y = (xy[own] - walls[of, :2]).T
    place = x * walls[of, UX] + y * walls[of, UY]
    off = y * walls[of, UX] - x * walls[of, UY]

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(of, values, minlength=n), dtype=np.float64)

    count = np.bincount(of, minlength=n)
    place -= (total(place) / count)[of]
    # Difference between a parabola and its line, and the part of it in the residuals.
    squares = place**2
    total_squares = total(squares)
    slope, level = total(place**3) / total_squares, total_squares / count
    bend = squares - slope[of] * place - level[of]
    weight = np.maximum(total(bend**2), 1e-12)
    bow, sd = total(off * bend) / weight, max(mixture.sigma, NOISE_AT_LEAST_M) / np.sqrt(weight)
    sure = (np.abs(bow) > BOWED * sd) & (count > 3)
    return np.asarray(np.where(sure, bow * (walls[:, END] - walls[:, BEGIN]), 0.0))
