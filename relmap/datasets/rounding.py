"""Ranges rounded so coarsely that walls look like steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, evenly
from relmap.datasets.textfile import warn

COARSE_M, COARSEST_M = 0.06, 0.25
"""Steps of ranges that are spread; at 0.05 m noise makes some logs better and others worse."""
SCANS, FEWEST = 200, 20
"""Maximum number of scans that are examined, and least number of different ranges."""
SAME_M, MOSTLY = 6e-4, 0.99
"""Largest deviation of a multiple of the step, as ranges may be given in millimetres, and fraction
of the ranges that are multiples."""


def spread_rounded(path: Path, ranges_m: list[Floats]) -> list[Floats]:
    """Return the ranges of each scan, list of k (b,), spread over the step of their rounding.

    A wall seen in rounded ranges is a row of arcs around the sensor; noise of the size of a step
    makes it a wall again. It is the same in each call. Finer ranges are returned as they are.
    `path`: the log, for the warning.
    """
    step_m = _step_m(ranges_m)
    if not COARSE_M <= step_m <= COARSEST_M:
        return ranges_m
    warn(path, f"ranges are rounded to {step_m:.3g} m: evenly distributed noise is added")
    noise = [np.random.default_rng(k).uniform(-0.5, 0.5, len(r)) for k, r in enumerate(ranges_m)]
    return [
        np.maximum(r + step_m * each, step_m / 2) for r, each in zip(ranges_m, noise, strict=True)
    ]


def _step_m(ranges_m: list[Floats]) -> float:
    """Return the step of which most ranges are multiples, 0 if there is none."""
    some = evenly(len(ranges_m), SCANS).tolist()
    every = np.concatenate([np.empty(0), *(ranges_m[scan] for scan in some)])
    values_m = np.unique(np.round(every, 4))
    gaps_m = np.diff(values_m, prepend=0.0)
    steps_m = gaps_m[gaps_m > 2 * SAME_M]
    if len(steps_m) < FEWEST:
        return 0.0
    # Single differences are rounded, too: all multiples together are far more exact.
    multiple = np.cumsum(np.rint(gaps_m / np.median(steps_m)))
    step_m = round(float(values_m @ multiple / (multiple @ multiple)), 9)
    off_m = np.abs(every - step_m * np.rint(every / step_m))
    return step_m if np.mean(off_m <= SAME_M) >= MOSTLY else 0.0
