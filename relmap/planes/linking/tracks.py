"""Tracks of walls that the next scan may continue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.tracks import Tracks
from relmap.planes.motions import wrapped
from relmap.planes.scans.observation import PlaneObservation

MEMORY = 8
"""Approximate number of observations averaged in the prediction of a wall or corner."""
NO_CORNER = -1
"""Marks a side without a corner so far."""


@dataclass(eq=False)
class PlaneTracks(Tracks):
    """Tracked walls in the robot frame of one iteration, predicted if missed; n walls.

    `plane` (n,): number of the wall; `angle` (n,), radians, and `offset` (n,), metres: direction of
    the normal, and ``normal @ p`` of every point p, averages of the last observations; `ends`
    (n, 2, 2), metres, and `sd` (n,), metres: ends, and standard deviation of the offset, as last
    observed; `corner` (n, 2): number of the corner on either side, or `NO_CORNER`; `corner_at`
    (n, 2, 2), metres: its position, the average of the last observations, NaN if there is none;
    `corner_seen` (n, 2): how often it was seen; `missed` (n,): iterations since the wall was last
    observed; `seen` (n,): how often it was seen; `loose` (n,): whether it was on a small
    free-standing object when it was first seen.
    """

    plane: Ints
    angle: Floats
    offset: Floats
    ends: Floats
    sd: Floats
    corner: Ints
    corner_at: Floats
    corner_seen: Ints
    missed: Ints
    seen: Ints
    loose: Bools

    @classmethod
    def begun(cls, plane: Ints, seen: PlaneObservation) -> PlaneTracks:
        """Return tracks of walls seen for the first time, without their corners yet."""
        n, angle = len(seen), np.arctan2(seen.normal[:, 1], seen.normal[:, 0])
        line = angle, seen.offset.copy(), seen.ends.copy(), seen.sd.copy()
        corner, corner_at = np.full((n, 2), NO_CORNER), np.full((n, 2, 2), np.nan)
        corner_seen, missed = np.zeros((n, 2), dtype=np.int64), np.zeros(n, dtype=np.int64)
        return cls(plane, *line, corner, corner_at, corner_seen, missed, missed + 1, seen.loose)

    @classmethod
    def of_scan(cls, plane: Ints, seen: PlaneObservation) -> PlaneTracks:
        """Return the walls of one scan, with the places of their corners, as tracks."""
        tracks = cls.begun(plane, seen)
        tracks.corner_at = np.where(seen.static[..., None], seen.ends, np.nan)
        return tracks

    @property
    def normal(self) -> Floats:
        """Unit vectors (n, 2) towards where the robot was."""
        normal = np.empty((len(self.angle), 2))
        np.cos(self.angle, out=normal[:, 0])
        np.sin(self.angle, out=normal[:, 1])
        return normal

    @property
    def arrays(self) -> Any:
        """The tracks in the form used by the compiled matching."""
        return self.angle, self.offset, self.ends, self.sd, self.corner_at

    def carried(self, motion: Floats) -> PlaneTracks:
        """Return the tracks in another frame, given the motion (3,) to it: yaw, x, y."""
        from relmap.planes.linking.matching_kernels import carried

        angle, offset, ends, sd, corner_at = carried(self.arrays, motion)
        corner, corner_seen = self.corner.copy(), self.corner_seen.copy()
        moved = angle, offset, ends, sd, corner, corner_at, corner_seen
        return PlaneTracks(self.plane, *moved, self.missed.copy(), self.seen.copy(), self.loose)

    def see(self, rows: Ints, seen: PlaneObservation, at: Ints) -> None:
        """Record that walls `at` (k,) of a scan continue tracks `rows`; others were missed."""
        self.missed += 1
        self.missed[rows] = 0
        self.seen[rows] += 1
        share = 1 / np.minimum(self.seen[rows], MEMORY)
        angle = np.arctan2(seen.normal[at, 1], seen.normal[at, 0])
        ends = seen.ends[at]
        middle = (ends[:, 0] + ends[:, 1]) / 2
        across = (self.normal[rows] * middle).sum(axis=1) - self.offset[rows]
        self.angle[rows] += share * wrapped(angle - self.angle[rows])
        # The average is taken at the observed part of the wall, not where its line passes the
        # robot.
        now = (self.normal[rows] * middle).sum(axis=1)
        self.offset[rows] = now - (1 - share) * across
        self.ends[rows] = ends
        self.sd[rows] = seen.sd[at]
