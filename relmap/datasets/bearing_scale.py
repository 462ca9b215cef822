"""A wrong field of view: bearings that are wrong by a constant factor bend straight walls.

A straight wall has ``1 / range = a cos(bearing) + b sin(bearing)``. If the bearings are too wide by
a factor, this holds for the bearings divided by it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, evenly
from relmap.datasets.textfile import warn

SCANS = 300
"""Maximum number of scans that are examined, spread over the log."""
WINDOW_RAD, HOP_RAD, BEAM_RAD = np.deg2rad([60.0, 10.0, 1.0])
"""Angle of a stretch of wall, from one stretch to the next, and least angle between its beams."""
BEAMS = 15
"""Minimum number of beams of a stretch."""
SHARE, JUMP, NEAREST_M, OBLIQUE, NOISE_M = 0.9, 0.3, 0.3, 1.15, 0.02
"""A stretch has this fraction of its beams, ranges that change by less than this fraction from beam
to beam, are longer than this and, the longest, by this factor than the shortest, and fit."""
OFF, STEP = 0.16, 0.01
"""Largest error of the bearings that is looked for, and the step, as fractions of them."""
FEWEST, LEAST, SPREAD = 50, 0.015, 1.0
"""Number of stretches, and error, from which a log is warned of; largest difference between the
quartiles, as a fraction of the error: furniture bends either way. In ten real logs the quartiles
are more than four times as far apart, or the error is below 0.007."""
APART, FOLLOWS = 1.15, 0.45
"""In a round room, the error grows with the distance of the wall. So far walls must be farther by
this factor than near ones, and the logarithm of the ratio of their errors be at most this fraction
of that of the distances: 0.55 to 1.1 in seven round rooms."""


def warn_of_bearings(
    path: Path, ranges_m: Sequence[Floats], bearings_rad: Sequence[Floats]
) -> None:
    """Warn if straight walls look bent as if all bearings were wrong by one factor.

    `path`: the log, for the warning. `ranges_m`, `bearings_rad`, list of k (b,): beams of each
    scan; those of range 0 did not return.
    """
    some = evenly(len(ranges_m), SCANS).tolist()
    found = [each for i in some for each in _stretches(ranges_m[i], bearings_rad[i])]
    off, nearest_m = np.array(found).reshape(-1, 2).T
    if len(off) < FEWEST:
        return
    low, middle, high = np.quantile(off, (0.25, 0.5, 0.75))
    if abs(middle) < LEAST or high - low > SPREAD * abs(middle):
        return
    third, two_thirds = np.quantile(nearest_m, (1 / 3, 2 / 3))
    (near_m, near), (far_m, far) = (
        (np.median(nearest_m[part]), np.median(off[part]))
        for part in (nearest_m <= third, nearest_m >= two_thirds)
    )
    follows = abs(np.log(abs(far / near))) > FOLLOWS * np.log(far_m / near_m)
    if far_m > APART * near_m and not follows:
        kind = "wide" if middle > 0 else "narrow"
        bent = f"walls look bent as if all bearings were {100 * abs(middle):.2g} % too {kind}"
        warn(path, f"{bent}: check the field of view and the angle between beams")


def _stretches(ranges_m: Floats, bearings_rad: Floats) -> Iterator[tuple[float, float]]:
    """Yield the error of the bearings of each stretch of wall, a fraction, and its least range."""
    order = np.argsort(bearings_rad, kind="stable")
    order = order[ranges_m[order] > 0]
    if len(order) < 2:
        return
    step_rad = np.median(np.diff(bearings_rad[order]))
    if not 0 < step_rad < WINDOW_RAD / BEAMS:
        return
    stride = max(1, round(BEAM_RAD / step_rad))
    ranges, bearings = ranges_m[order[::stride]], bearings_rad[order[::stride]]
    fewest = max(SHARE * WINDOW_RAD / (stride * step_rad), BEAMS)
    begins_rad = np.arange(bearings[0], bearings[-1] - WINDOW_RAD + HOP_RAD / 2, HOP_RAD)
    for begin, end in np.searchsorted(bearings, [begins_rad, begins_rad + WINDOW_RAD]).T:
        r = ranges[begin:end]
        if len(r) < fewest or r.min() < NEAREST_M or r.max() < OBLIQUE * r.min():
            continue
        if (np.abs(np.diff(r)) < JUMP * r[1:]).all():
            off = _off(r, bearings[begin:end])
            if np.isfinite(off):
                yield off, float(r.min())


def _off(ranges_m: Floats, bearings_rad: Floats) -> float:
    """Return the error of bearings (b,) with which a wall is straight, a fraction; NaN if none."""
    off = np.arange(-OFF, OFF + STEP / 2, STEP)
    turned = (bearings_rad - bearings_rad.mean()) / (1 + off[:, None])
    basis = np.stack([np.cos(turned), np.sin(turned)], axis=1) * ranges_m**2  # errors in metres
    products = basis @ ranges_m
    solved = np.linalg.solve(basis @ basis.swapaxes(1, 2), products[..., None])[..., 0]
    squares = ranges_m @ ranges_m - (products * solved).sum(axis=1)
    best = int(np.argmin(squares))
    if not 0 < best < len(off) - 1 or squares[best] > NOISE_M**2 * len(ranges_m):
        return np.nan
    before, least, after = squares[best - 1 : best + 2]
    return float(off[best] + STEP / 2 * (before - after) / (before - 2 * least + after))
