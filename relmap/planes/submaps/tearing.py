"""Where refinement tears a map: its steps deviate from links between scans."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes.linking.placement import LEVER_M
from relmap.planes.motions import APART_M, APART_RAD

TORN_M = 1.0
"""Disagreement of a map with a link above which the map is torn."""


def disagreement(poses: Floats, motions: Floats) -> tuple[int, float]:
    """Return the number of links at which a path is torn, and the mean error at the others.

    Compared with the motions measured from scan to scan; metres.

    `poses` (k, 4, 4); `motions` (k, 3): yaw, x, y from the previous robot frame to that of each
    iteration.
    """
    off_m = _off_m(poses, motions)
    off_m = off_m[np.isfinite(off_m)]
    torn = off_m > TORN_M
    n_torn = int(torn.sum())
    return n_torn, float(off_m[~torn].sum() / max(len(off_m) - n_torn, 1))


def torn_links(poses: Floats, motions: Floats) -> Ints:
    """Return the scans (t,) before which a path deviates from its links.

    `poses` (k, 4, 4); `motions` (k, 3): yaw, x, y from the previous robot frame to that of each
    iteration.
    """
    way_m, turn = deviations(poses, motions)
    return 1 + np.flatnonzero((way_m > APART_M) | (turn > APART_RAD))


def _off_m(poses: Floats, motions: Floats) -> Floats:
    """Return the disagreement of a path with each of its links, NaN where unknown."""
    way_m, turn = deviations(poses, motions)
    return np.asarray(way_m + LEVER_M * turn)


def deviations(poses: Floats, motions: Floats) -> tuple[Floats, Floats]:
    """Return how far the steps of a path are off its links (k - 1,), metres and radians.

    NaN where unknown; the arguments are those of `torn_links`.
    """
    relative = np.linalg.inv(poses[1:]) @ poses[:-1]
    turn = np.arctan2(relative[:, 1, 0], relative[:, 0, 0]) - motions[1:, 0]
    way_m = np.hypot(*(relative[:, :2, 3] - motions[1:, 1:]).T)
    return way_m, np.abs((turn + np.pi) % (2 * np.pi) - np.pi)
