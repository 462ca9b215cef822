"""How far the segments of a run disagree with the map they are part of.

Where errors are independent, segments agree with the map as closely as noise allows. In real logs
they are not: what is seen of a tree, or how a bearing is biased, changes with the viewpoint.
"""

from __future__ import annotations

import numpy as np

from relmap.core.association.reobservation.evidence import LOCAL_DRIFT
from relmap.core.association.scale import CHI2_MEDIAN
from relmap.core.geometry.alignment import place_each
from relmap.core.geometry.robust import fit_robust_each
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.state.table import NONE, LandmarkState

FEWEST = 5
"""Landmarks of one submap in a segment from which a disagreement can be estimated."""


def local_drift(table: LandmarkState, rows: SegmentRows, noise_m: float) -> float:
    """Return the variance by which segments of a submap deviate from it, beyond their noise.

    It is relative to the variance of an observation, and at least `LOCAL_DRIFT`. `noise_m`:
    standard deviation of an observed coordinate.
    """
    landmark, d = table.now(rows.landmark), table.dimension
    on_map = (landmark != NONE) & ~table.dynamic[landmark]
    on_map[on_map] = table.submap[landmark[on_map]] != NONE
    # Landmarks of one segment may be of several submaps, each in its own frame.
    part = rows.segment * (table.submap.max(initial=0) + 1) + table.submap[landmark]
    _, at, n_rows = np.unique(part[on_map], return_inverse=True, return_counts=True)
    enough = n_rows[at] >= FEWEST
    kept, at, n = np.flatnonzero(on_map)[enough], at[enough], len(n_rows)
    here, there = rows.points[kept], table.position[landmark[kept]]
    n_seen = rows.n_seen[kept].astype(np.float64)
    R, t, fixed, _ = fit_robust_each(here, there, n_seen, at, n)
    square = np.sum((place_each(R, t, at, here) - there) ** 2, axis=1)[fixed[at]]
    if not noise_m > 0 or not len(square):
        return LOCAL_DRIFT
    used = 1 - (d + 1) / (2 * n_rows[at][fixed[at]])
    variance = float(np.median(square / used)) / CHI2_MEDIAN[d]
    averaged = 1 / n_seen + 1 / np.maximum(table.weight[landmark[kept]], 1)
    return max(LOCAL_DRIFT, variance / noise_m**2 - float(np.median(averaged[fixed[at]])))
