"""Where a scan is if the sensor moves on as before."""

from __future__ import annotations

import itertools

import numpy as np

from relmap.core.arrays import Floats
from relmap.planes3d.hypotheses import Held
from relmap.planes3d.submap import Submap

STEADY, LATELY = (5, 3, 2, 1), 8
"""Numbers of last steps whose mean may predict the next one, and number of the last scans by which
one of these is chosen."""


def predicted(part: Submap) -> Held:
    """Return the position of the next scan of a submap if the sensor moves on as before.

    Its step is the mean of some of the last ones, along the axes of the submap, or along those of
    the sensor before each, as where it turns: that which would have predicted the last scans best.
    `off_m` is the root mean square of the last steps that planes determined, infinite if none did.
    """
    most = max(STEADY)
    number, poses = (each[-(LATELY + most + 1) :] for each in (part.iteration, part.poses))
    R, t = (np.array(each) for each in zip(*poses, strict=True))
    steps, known = np.diff(t, axis=0), np.array([k not in part.held for k in number])[1:]
    if not len(steps):
        return Held(t[-1], np.inf)

    own = np.einsum("nji,nj->ni", R[:-1], steps)

    def place(k: int, count: int, turns: bool) -> Floats:
        rows = slice(max(k - 1 - count, 0), k - 1)
        step = R[k - 1] @ own[rows].mean(axis=0) if turns else steps[rows].mean(axis=0)
        return np.asarray(t[k - 1] + step)

    compared = [k for k in range(2, len(t)) if known[k - 1]][-LATELY:]
    ways = list(itertools.product(STEADY, (False, True)))
    off_m2 = [sum(((place(k, *way) - t[k]) ** 2).sum() for k in compared) for way in ways]
    usual_m2 = (steps[-most:][known[-most:]] ** 2).sum(axis=1)
    off_m = float(np.sqrt(usual_m2.mean())) if len(usual_m2) else np.inf
    return Held(place(len(t), *ways[int(np.argmin(off_m2))]), off_m)
