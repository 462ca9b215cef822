"""Steps of refined maps that beams contradict, while the link between the two scans agrees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from relmap.core.arrays import Ints
from relmap.planes.linking.adjoining import RIVAL, Break
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.motions import from_matrices, others
from relmap.planes.submaps.submap import WallSubmap

OFF_M, OFF_RAD = 0.05, np.deg2rad(0.5)
"""Deviation of a step from its link above which the two are compared."""


def contradicted_steps(submaps: Sequence[WallSubmap], links: LinkRecord) -> Ints:
    """Return the scans (k,), ascending, into which the link fits better than the refined step.

    Walls that were taken for each other, or are not straight, turn or shift a refined step. The
    beams of up to four scans on either side, at their refined poses, decide.
    """
    if not len(links.beams):
        return np.empty(0, dtype=np.int64)
    scans, found = links.scans, list[int]()
    for submap in submaps:
        known = np.isfinite(submap.poses[:, 0, 0])
        rows = 1 + np.flatnonzero(known[1:] & known[:-1])
        steps, motions = submap.first_iteration + rows, scans.motions.copy()
        refined = np.linalg.inv(submap.poses[rows]) @ submap.poses[rows - 1]
        motions[steps] = from_matrices(refined)
        moved = replace(scans, motions=motions, firm=True)
        for scan in steps[links.submaps[steps] == links.submaps[steps - 1]].tolist():
            link, step = scans.motions[scan][None], motions[scan]
            if others(link, step, OFF_M, OFF_RAD)[0]:
                around = Break.before(scan, moved, links.submaps)
                if around.odds(link, step)[0] > RIVAL:
                    found.append(scan)
    return np.array(sorted(found), dtype=np.int64)
