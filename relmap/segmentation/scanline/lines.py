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
from relmap.core.geometry.robust import median
from relmap.segmentation.em.mixture import WallMixture
from relmap.segmentation.noise import FLOOR_M
from relmap.segmentation.wall import BEGIN, END, PX, PY, UX, UY

MEDIAN = 0.6745
"""Median of the magnitude of normal noise, in standard deviations."""
MANY = 1 / 12
"""Fraction of beams on small isolated objects above which the scan shows clutter."""
CHORD = 3.0
"""Minimum length of the chords from which the noise is estimated, in standard deviations."""
GROWS = 1.6
"""Growth of the distance of points with twice as many beams between, below which it is mostly
noise: for chords of three standard deviations of range noise, ((9 + 2) / (9 / 4 + 2)) ** 0.5."""
NOISE_AT_LEAST_M = 0.005
"""Minimum deviation of real walls from flatness."""
APART = 0.5
"""Largest distance of successive points, as a fraction of that of points half the scan apart,
medians. In random order it is about 1; where half of the beams hit clutter it is 0.3."""
ONWARD = 0.75
"""Fraction of the beams that turn the same way about the robot; half of them in random order."""
STEEP = np.sin(np.deg2rad(3.0))
"""Beams that meet a wall at a smaller angle (sine) do not extend it."""
BESIDE = 2.5
"""Largest angle between beams that are beside each other, in usual angles."""
LEAST = 50
"""Minimum number of points to judge the order by."""


@dataclass(frozen=True, eq=False)
class LaserScan:
    """The points of a 2-D laser scan and what several steps need to know of them.

    `xy` (n, 2), robot frame, metres: in the order of their beams, right to left or left to right;
    `noise`: metres; None: estimated.
    """

    xy: Floats
    noise: float | None = None

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
        return median(self.bearing[1:] - self.bearing[:-1]) if len(self.xy) > 1 else 0.0

    @cached_property
    def is_all_round(self) -> bool:
        """Whether the last beam is beside the first one."""
        step = abs(self.step_rad)
        unseen = 2 * np.pi - abs(self.bearing[-1] - self.bearing[0])
        return bool(-BESIDE * step <= unseen <= BESIDE * step)

    @cached_property
    def noise_m(self) -> float:
        """The noise, as given or as `beam_noise` estimates it."""
        return beam_noise(self.xy) if self.noise is None else max(self.noise, FLOOR_M)

    @cached_property
    def marks(self) -> tuple[Bools, Bools]:
        """Which points are specks, and after which ones the next beam hits something else; (n,)."""
        from relmap.segmentation.scanline.mark_kernels import specks_and_breaks

        return specks_and_breaks(self.xy, max(self.noise_m, NOISE_AT_LEAST_M))


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
    neighbours are closer than the noise their chords do not lie along the wall: those of points
    two beams before and after are used instead, four beams, and so on. Their distances then grow
    little with the number of beams between, unlike in clutter, which is not noise.
    """
    from relmap.segmentation.scanline.beam_kernels import off_chords

    if len(xy) < 5:
        return FLOOR_M
    xy, reach = np.ascontiguousarray(xy), 1
    turn = np.abs(np.diff(np.arctan2(xy[:, 1], xy[:, 0])))
    apart_m = median(np.hypot(xy[:, 0], xy[:, 1])) * median(turn)
    sigma = _noise_of(off_chords(xy, reach))
    while (
        len(xy) >= 2 * reach * LEAST
        and 2 * reach * apart_m < CHORD * sigma
        and _distance_m(xy, 2 * reach) < GROWS * _distance_m(xy, reach)
    ):
        reach *= 2
        sigma = max(_noise_of(off_chords(xy, reach)), sigma)
    return sigma


def _distance_m(xy: Floats, beams: int) -> float:
    """Return the median distance of points so many beams apart."""
    step = xy[beams:] - xy[:-beams]
    return median(np.hypot(step[:, 0], step[:, 1]))


def _noise_of(off_m: float) -> float:
    """Return the noise from the median distance of points from the chords of their neighbours."""
    return max(off_m / (MEDIAN * math.sqrt(1.5)), FLOOR_M)


def scan_walls(scan: LaserScan) -> tuple[WallMixture, Ints]:
    """Return the walls of a scan of n points, and the wall of each point (n,), -1 for none."""
    from relmap.segmentation.scanline.beam_kernels import line_pieces

    xy, sigma, solid = scan.xy, scan.noise_m, _beyond_clutter(scan.marks[0])
    own = xy.take(solid, axis=0)  # a tenth of the time of `xy[solid]`
    if scan.noise is None and len(own) < len(xy):
        sigma = beam_noise(own)
    pieces, walls = line_pieces(own, solid, max(sigma, NOISE_AT_LEAST_M))
    labels = np.full(len(xy), -1)
    for k, (first, last) in enumerate(pieces.tolist()):
        labels[solid[first:last]] = k
    # Without stray points the area over which they would lie does not matter.
    return WallMixture(walls, sigma, stray=0.0, area=1.0, beam=abs(scan.step_rad)), labels


def _beyond_clutter(speck: Bools) -> Ints:
    """Return the remaining points (k,) without specks (n,); all points if specks are few.

    Otherwise an object in front of a wall, such as a door jamb, is a valid landmark.
    """
    alone = speck[1:-1] & ~speck[:-2] & ~speck[2:]
    return (~speck | (np.count_nonzero(alone) < MANY * len(speck))).nonzero()[0]


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
        steep = np.abs(across) >= STEEP
        met = (walls[:, PY] * c - walls[:, PX] * s) / np.where(steep, across, 1.0)
        inside = (rows > 0) & (rows < len(scan.xy) - 1)
        walls[:, end] = np.where(inside & steep, met, walls[:, end])
    return mixture.with_walls(walls)


def hidden_ends(scan: LaserScan, bounds: tuple[Ints, Ints]) -> Bools:
    """Return which ends (k, 2) of walls have something nearer right next to them.

    A few beams suffice: a wall at a grazing angle may be undetected but still hides others. Where a
    scan all round begins and ends, the wall may go on, too.
    """
    xy, (first, last), broken = scan.xy, bounds, scan.marks[1]
    radius = np.hypot(xy[:, 0], xy[:, 1])
    right, left = np.maximum(first - 1, 0), np.minimum(last + 1, len(xy) - 1)
    hidden = [
        broken[right] & (radius[right] < radius[first]) & (first > 0),
        broken[last] & (radius[left] < radius[last]),
    ]
    if scan.is_all_round:
        hidden[0] |= first == 0
        hidden[1] |= last == len(xy) - 1
    return np.array(hidden).T


def on_curves(mixture: WallMixture, xy: Floats, labels: Ints, bounds: tuple[Ints, Ints]) -> Bools:
    """Return which ends (k, 2) of walls are not corners because the surface continues as a curve.

    Where a curve is cut into straight pieces depends on the point of view.
    """
    from relmap.segmentation.scanline.mark_kernels import curved_ends

    sigma = max(mixture.sigma, NOISE_AT_LEAST_M)
    return curved_ends(mixture.walls, xy, labels, np.array(bounds), sigma)
