"""The tracks that the next observations may continue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CAREFUL = 5
"""A track that was seen moving counts as static again after so many iterations at rest."""


@dataclass(eq=False)
class LiveTracks:
    """Tracks as seen, or carried along, in the robot frame of one iteration.

    Attributes
    ----------
    landmarks : (n,) int64
    points : (n, d) float64, robot frame, metres
    missed : (n,) int64
        Iterations since the track was last seen.
    seen : (n,) int64
        How often it was seen.
    restless : (n,) int64
        Above 0 where the track was seen moving against the others not long ago.
    """

    landmarks: NDArray[np.int64]
    points: NDArray[np.float64]
    missed: NDArray[np.int64]
    seen: NDArray[np.int64]
    restless: NDArray[np.int64]

    @classmethod
    def begun(cls, landmarks: NDArray[np.int64], points: NDArray[np.float64]) -> LiveTracks:
        """Return tracks seen for the first time."""
        zeros = np.zeros(len(landmarks), dtype=np.int64)
        return cls(landmarks, points, zeros, zeros + 1, zeros)

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.landmarks)

    def carried(self, points: NDArray[np.float64]) -> LiveTracks:
        """Return the tracks where they are expected in the next iteration."""
        return LiveTracks(
            self.landmarks, points, self.missed.copy(), self.seen.copy(), self.restless.copy()
        )

    def see(
        self, rows: NDArray[np.int64], points: NDArray[np.float64], strayed: NDArray[np.bool_]
    ) -> None:
        """Note where some tracks were found, and that the others were missed."""
        self.missed += 1
        self.missed[rows] = 0
        self.points[rows] = points
        self.restless[rows] = np.maximum(self.restless[rows] - 1, 0)
        self.restless[rows[strayed]] = CAREFUL
        self.seen[rows] += 1

    def kept(self, rows: NDArray[np.bool_]) -> LiveTracks:
        """Return some of the tracks."""
        return LiveTracks(
            self.landmarks[rows],
            self.points[rows],
            self.missed[rows],
            self.seen[rows],
            self.restless[rows],
        )

    def joined(self, other: LiveTracks) -> LiveTracks:
        """Return these tracks and others."""
        return LiveTracks(
            np.concatenate([self.landmarks, other.landmarks]),
            np.concatenate([self.points, other.points]),
            np.concatenate([self.missed, other.missed]),
            np.concatenate([self.seen, other.seen]),
            np.concatenate([self.restless, other.restless]),
        )
