"""The tracks that the next observations may continue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints

SEARCH = 30
"""Maximum number of tracks used by a search that is independent of the motion, see `sampled`."""
CROWD = 60
"""Maximum number of points of a scan used by it, the nearest."""


def sampled(n: int, most: int) -> Ints:
    """Return at most `most` of n rows in order of rank: the first, and as many of all others.

    If these are tracks, those seen longest are the most certain, but may all have left the view.
    """
    if n <= most:
        return np.arange(n)
    half = most // 2
    return np.append(np.arange(half), np.linspace(half, n - 1, most - half).astype(np.int64))


class Tracks:
    """Per-track data: every attribute is an array with a row for each track.

    Points and walls each define a dataclass of such arrays.
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
        """Return these tracks and others, concatenated."""
        if not len(other):
            return self
        columns = zip(vars(self).values(), vars(other).values(), strict=True)
        return type(self)(*map(np.concatenate, columns))


@dataclass(eq=False)
class LiveTracks(Tracks):
    """Tracks in the robot frame of one iteration; missed ones are predicted.

    `landmarks` (n,); `expected` (n, d), robot frame, metres: average of the last observations: the
    position of a static landmark; `latest` (n, d), robot frame, metres: the last observation: close
    to the position of a moving landmark; `missed` (n,): iterations since the track was last seen;
    `seen` (n,): number of observations; `restless` (n,): positive if the track was recently seen
    moving relative to the others.
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

    @property
    def columns(self) -> tuple[Ints, Floats, Floats, Ints, Ints, Ints]:
        """All columns, in the order in which the compiled functions take them."""
        return self.landmarks, self.expected, self.latest, self.missed, self.seen, self.restless

    def crowd(self, points: Floats, most: int = SEARCH) -> tuple[Ints, Ints]:
        """Return the tracks (k,) and which of points (n, d), (l,), a search uses."""
        away = np.linalg.norm(points, axis=1)
        within_m = np.partition(away, CROWD - 1)[CROWD - 1] if len(away) > CROWD else np.inf
        recent = self.missed <= int(self.missed.min()) + 1
        recent &= np.linalg.norm(self.expected, axis=1) <= within_m
        known = np.flatnonzero(recent)
        known = known[np.argsort(-self.seen[known], kind="stable")]
        return known[sampled(len(known), most)], np.flatnonzero(away <= within_m)
