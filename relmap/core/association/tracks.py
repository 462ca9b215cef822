"""The tracks that the next observations may continue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MEMORY = 8
"""Observations that the expected place of a track averages, about."""
CAREFUL = 5
"""A track seen moving counts as at rest again after so many iterations without moving."""


@dataclass(eq=False)
class LiveTracks:
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

    landmarks: NDArray[np.int64]
    expected: NDArray[np.float64]
    latest: NDArray[np.float64]
    missed: NDArray[np.int64]
    seen: NDArray[np.int64]
    restless: NDArray[np.int64]

    @classmethod
    def begun(cls, landmarks: NDArray[np.int64], points: NDArray[np.float64]) -> LiveTracks:
        """Return tracks seen for the first time."""
        zeros = np.zeros(len(landmarks), dtype=np.int64)
        return cls(landmarks, points, points.copy(), zeros, zeros + 1, zeros.copy())

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.landmarks)

    def see(
        self, rows: NDArray[np.int64], points: NDArray[np.float64], strayed: NDArray[np.bool_]
    ) -> None:
        """Note in place where some tracks were found, which strayed, and who was missed."""
        from relmap.core.association.matching_kernels import see_tracks

        counts = (self.missed, self.seen, self.restless)
        see_tracks(self.expected, self.latest, counts, rows, points, strayed, MEMORY, CAREFUL)

    def carried(self, expected: NDArray[np.float64], latest: NDArray[np.float64]) -> LiveTracks:
        """Return the tracks with their places in the next iteration."""
        return LiveTracks(self.landmarks, expected, latest, self.missed, self.seen, self.restless)

    def kept(self, rows: NDArray[np.bool_]) -> LiveTracks:
        """Return some of the tracks."""
        return LiveTracks(
            self.landmarks[rows],
            self.expected[rows],
            self.latest[rows],
            self.missed[rows],
            self.seen[rows],
            self.restless[rows],
        )

    def joined(self, other: LiveTracks) -> LiveTracks:
        """Return these tracks and others."""
        return LiveTracks(
            np.concatenate([self.landmarks, other.landmarks]),
            np.concatenate([self.expected, other.expected]),
            np.concatenate([self.latest, other.latest]),
            np.concatenate([self.missed, other.missed]),
            np.concatenate([self.seen, other.seen]),
            np.concatenate([self.restless, other.restless]),
        )
