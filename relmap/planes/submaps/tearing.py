"""Where refinement tears a map: its steps deviate from links between scans, or from beams."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.placement import LEVER_M
from relmap.planes.motions import APART_M, APART_RAD, from_matrices
from relmap.planes.scans.beams import NEAR_M, BeamStore, leads, log_odds
from relmap.planes.walls.history import PlaneHistory

TORN_M = 1.0
"""Disagreement of a map with a link above which the map is torn."""
CHANGED_M, CHANGED_RAD = 0.2, np.deg2rad(3.0)
"""Change of a step by refinement above which the beams evaluate it."""
BESIDE = 10
"""Number of scans before and after over which it must persist: else one scan is misplaced."""
AGAINST, SHARE = 30.0, 0.3
"""Log odds by which the beams prefer the step as it was, and by what fraction of them. In ten logs
and six simulated worlds, nearly all changes with log odds above 5 were for the worse."""


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
    way_m, turn = _off(poses, motions)
    return 1 + np.flatnonzero((way_m > APART_M) | (turn > APART_RAD))


def _off_m(poses: Floats, motions: Floats) -> Floats:
    """Return the disagreement of a path with each of its links, NaN where unknown."""
    way_m, turn = _off(poses, motions)
    return np.asarray(way_m + LEVER_M * turn)


def _off(poses: Floats, motions: Floats) -> tuple[Floats, Floats]:
    """Return the same for translation, metres, and rotation, radians."""
    relative = np.linalg.inv(poses[1:]) @ poses[:-1]
    turn = np.arctan2(relative[:, 1, 0], relative[:, 0, 0]) - motions[1:, 0]
    way_m = np.hypot(*(relative[:, :2, 3] - motions[1:, 1:]).T)
    return way_m, np.abs((turn + np.pi) % (2 * np.pi) - np.pi)


def contradicted_steps(
    before: Floats, now: Floats, first: int, history: PlaneHistory, beams: BeamStore
) -> Ints:
    """Return the scans (t,) into which beams contradict the change of a step.

    Then different walls were joined, and the map is torn where least holds it together.

    `before`, `now` (k, 4, 4): poses of consecutive scans before and after walls were joined, NaN
    where unknown; `first`: the first of the scans.
    """
    known = np.flatnonzero(np.isfinite(before[:, 0, 0]) & np.isfinite(now[:, 0, 0]))
    before, now = before[known], now[known]
    rows = np.arange(len(known))
    wide = rows[:-1] - BESIDE, rows[1:] + BESIDE
    lasting = _changed(before, now, *(each.clip(0, max(len(known) - 1, 0)) for each in wide))
    changed = _changed(before, now, rows[:-1], rows[1:]) & lasting & (np.diff(known) == 1)
    torn = [
        first + known[k + 1]
        for k in np.flatnonzero(changed)
        if _is_contradicted(before[k : k + 2], now[k : k + 2], first + known[k], history, beams)
    ]
    return np.array(torn, dtype=np.int64)


def _changed(before: Floats, now: Floats, begin: Ints, end: Ints) -> Bools:
    """Return which motions (k,), between poses by their rows, differ after refinement."""
    steps = [np.linalg.inv(poses[end]) @ poses[begin] for poses in (before, now)]
    off = from_matrices(np.linalg.inv(steps[0]) @ steps[1])
    return np.asarray((np.hypot(*off[:, 1:].T) > CHANGED_M) | (np.abs(off[:, 0]) > CHANGED_RAD))


def _is_contradicted(
    before: Floats, now: Floats, scan: int, history: PlaneHistory, beams: BeamStore
) -> bool:
    """Return whether the beams of a scan and the next prefer their poses (2, 4, 4) before."""
    own = np.searchsorted(history.iteration, scan + np.arange(3))
    earlier, later = (beams.of(scan + k, history.ends[own[k] : own[k + 1]]) for k in range(2))
    if not min(len(earlier), len(later)):
        return False
    was, is_now = from_matrices(np.linalg.inv([before[1], now[1]]) @ [before[0], now[0]])
    lead, sd = leads(earlier, later, is_now[None], was, NEAR_M)
    return bool(log_odds(lead, sd**2)[0] < -AGAINST and lead[0] < -SHARE * len(later))
