"""The tracks that the next observations may continue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints

MEMORY = 8
"""Observations that the expected place of a track averages, about."""
CAREFUL = 5
"""A track seen moving counts as at rest again after so many iterations without moving."""


class Tracks:
    """What is known of some tracks: every attribute is an array with a row for each of them.

    Points and walls have tracks of their own kind, dataclasses of such arrays.
    """

    def __init__(self, *columns: NDArray[Any]) -> None: ...

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(next(iter(vars(self).values())))

    def kept(self, rows: Bools) -> Self:
        """Return some of the tracks."""
        if rows.all():
            return self
        return type(self)(*(column[rows] for column in vars(self).values()))

    def joined(self, other: Self) -> Self:
        """Return these tracks and others."""
        if not len(other):
            return self
        columns = zip(vars(self).values(), vars(other).values(), strict=True)
        return type(self)(*map(np.concatenate, columns))


@dataclass(eq=False)
class LiveTracks(Tracks):
    """Tracks in the robot frame of one iteration, carried along where they were not seen.

    Attributes
    ----------
    landmarks : (n,) int64
    expected : (n, d) float64, robot frame, metres
        Average of the last observations: where a landmark at rest is.
    latest : (n, d) float64, robot frame, metres
        The last observation: near where a moving landmark is.
    missed : (n,) int64
        Iterations since the track was last seen.
    seen : (n,) int64
        How often it was seen.
    restless : (n,) int64
        Above 0 where the track was seen moving against the others not long ago.
    """

    landmarks: Ints
    expected: Floats
    latest: Floats
    missed: Ints
    seen: Ints
    restless: Ints

    @classmethod
    def begun(cls, landmarks: Ints, points: Floats) -> LiveTracks:
        """Return tracks seen for the first time."""
        zeros = np.zeros(len(landmarks), dtype=np.int64)
        return cls(landmarks, points, points.copy(), zeros, zeros + 1, zeros.copy())

    def see(self, rows: Ints, points: Floats, strayed: Bools) -> None:
        """Note in place where some tracks were found, which strayed, and who was missed."""
        from relmap.core.association.matching_kernels import see_tracks

        counts = (self.missed, self.seen, self.restless)
        see_tracks(self.expected, self.latest, counts, rows, points, strayed, MEMORY, CAREFUL)

    def carried(self, expected: Floats, latest: Floats) -> LiveTracks:
        """Return the tracks with their places in the next iteration."""
        return LiveTracks(self.landmarks, expected, latest, self.missed, self.seen, self.restless)
