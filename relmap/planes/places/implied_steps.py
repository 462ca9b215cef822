"""Steps from scan to scan that alignments of submaps imply, compared with what their scans show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relmap.core.arrays import Floats
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.linking.placement import STILL
from relmap.planes.linking.tying import Scans
from relmap.planes.motions import from_matrices, inverse, others
from relmap.planes.places.map_part import MapPart
from relmap.planes.places.wall_tie import WallTie
from relmap.planes.scans.beams import odds_over
from relmap.planes.submaps.doubtful import EXCLUDED, GAP
from relmap.planes.submaps.submap import WallSubmap, among_all
from relmap.planes.walls.history import PlaneHistory

BENT_M, BENT_RAD = 0.6, np.deg2rad(15.0)
"""Largest deviation of an implied step from one that walls and beams show: submaps are bent."""


@dataclass(frozen=True, eq=False)
class ImpliedSteps:
    """The steps between submaps that alignments imply."""

    submaps: Sequence[WallSubmap]
    history: PlaneHistory
    links: LinkRecord

    def poses(self, part: MapPart) -> Floats:
        """Return the poses of all iterations (i, 4, 4) in the frame of a part, NaN elsewhere."""
        path = np.full((self.history.n_iterations, 4, 4), np.nan)
        for number, motion in part.members:
            own = among_all(self.submaps[number].poses, self.submaps[number].span, self.history)
            path = np.where(np.isfinite(own), motion @ own, path)
        return path

    def refute(self, part: MapPart, other: MapPart, tie: WallTie) -> bool:
        """Return whether scans that follow each other refute an alignment of two parts.

        Of places that look alike, one may be a room or a period away from where they place it.
        """
        first, second = self.poses(part), tie.matrix @ self.poses(other)
        of_first = np.isfinite(first[:, 0, 0])
        poses = np.where(of_first[:, None, None], first, second)
        known = np.flatnonzero(np.isfinite(poses[:, 0, 0]))
        between = np.diff(of_first[known]) & (np.diff(known) <= GAP)
        pairs = zip(known[:-1][between].tolist(), known[1:][between].tolist(), strict=True)
        steps = ((i, j, np.linalg.inv(poses[i]) @ poses[j]) for i, j in pairs)
        return any(
            self._scans.of_one_run(i, j) and self._is_refuted(i, j, from_matrices(step))
            for i, j, step in steps
        )

    @cached_property
    def _scans(self) -> Scans:
        return self.links.scans

    def _is_refuted(self, earlier: int, later: int, step: Floats) -> bool:
        """Return whether two scans show other motions than a step (3,), which beams exclude."""
        search = self._scans.search(earlier, later, STILL)
        if search is None:
            return False
        found = search.candidates()
        motions = inverse(found.motions)
        if not others(motions, step, BENT_M, BENT_RAD).all() or found.doubtful.all():
            return False
        before, after = (self._scans.beams_of(i) for i in (earlier, later))
        odds, _ = odds_over([(after, before, np.vstack([step, motions[~found.doubtful]]))])
        return bool(odds.max() > EXCLUDED)
