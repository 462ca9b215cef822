"""Landmarks that move slowly, and together: the map bends to fit them and the others.

Neither are outliers then, and their distances to neighbours change by less than noise from one
group to the next. But where segments show them in the map, nearly all landmarks move gradually
while in view, along one direction. What sensors get systematically wrong depends on the viewpoint,
and so shows in all directions.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import extent_of, sums_each
from relmap.core.geometry.robust import EXACT
from relmap.core.refinement.condensing import LENGTH, SegmentRows
from relmap.core.refinement.joint import placed_segments

AWAY = 2
"""Segments without a landmark after which it is seen on another visit."""
FEWEST = 30
"""Visits from which motion is judged."""
MOST = 30.0
"""Largest squared ratio of a motion to its standard deviation that counts: a few landmarks may be
dynamic."""
SURELY, ONE_WAY = 2.5, 1.75
"""Smallest mean of these ratios along the direction of motion, 1 if landmarks rest; and least ratio
to that along any other. Of right maps at most 2.2 and 1.4 were found in simulation, 12 and 1.3 on
Victoria Park and the DLR circles, whose errors are not independent."""


def creep_of(rows: SegmentRows, positions: Floats, own: Bools, landmark: Ints) -> float:
    """Return how fast landmarks of a map move along one direction, metres per iteration.

    It is the root mean square over visits, beyond noise; 0 if noise explains the motion, or it has
    no direction.

    `rows`: of all iterations; `positions` (m, d), map frame, metres; `own` (m,): landmarks of the
    map; `landmark` (n,): landmark of each row.
    """
    if not rows.noise_m > EXACT * extent_of(positions[own]):
        return 0.0
    placed, fixed, _ = placed_segments(rows, positions, own[landmark], landmark)
    velocity, leverage = _visits(rows, placed, np.flatnonzero(own[landmark] & fixed), landmark)
    if len(velocity) < FEWEST:
        return 0.0
    information = leverage / rows.noise_m**2
    ratio = information * np.sum(velocity**2, axis=1)
    counted = information * np.minimum(1.0, MOST / np.maximum(ratio, MOST))
    scatter = (counted[:, None] * velocity).T @ velocity / len(velocity)
    values, vectors = np.linalg.eigh(scatter)
    if values[-1] < max(SURELY, ONE_WAY * values[-2]):
        return 0.0
    square = (velocity @ vectors[:, -1]) ** 2 - 1 / information
    return float(np.sqrt(max(np.average(square, weights=counted), 0.0)))


def _visits(rows: SegmentRows, placed: Floats, used: Ints, landmark: Ints) -> tuple[Floats, Floats]:
    """Return the velocity (v, d), metres per iteration, of landmarks on each visit.

    Also the sums (v,) of squared times around their means, over observations: the information on a
    velocity, relative to that of an observation on its position. Visits of a single segment are
    left out.
    """
    when = rows.first_iteration[rows.segment]
    used = used[np.lexsort((when[used], landmark[used]))]
    time, seen = when[used].astype(np.float64), rows.n_seen[used].astype(np.float64)
    again = (np.diff(landmark[used]) == 0) & (np.diff(time) <= AWAY * LENGTH)
    visit = np.cumsum(np.append(0, ~again)) if len(used) else used
    n = int(visit.max(initial=-1)) + 1
    total = np.bincount(visit, seen, n)
    away = time - (np.bincount(visit, seen * time, n) / total)[visit]
    leverage = np.asarray(np.bincount(visit, seen * away**2, n), dtype=np.float64)
    moved = sums_each((seen * away)[:, None] * placed[used], visit, n)
    several = leverage > 0
    return moved[several] / leverage[several, None], leverage[several]
