"""What every registration offers."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints

UNIDENTIFIED = -1
"""In place of a landmark: the observation belongs to none that is known."""


_RANKS = {rank: list(range(1, rank + 1)) for rank in range(1, 33)}


class Registration(Protocol):
    """How observations find their landmarks, which are numbered in the order of first sight."""

    def labels_of(self, landmarks: Ints) -> Ints:
        """Return what landmarks (n,) are called outside."""
        ...

    def match(self, seen: Any, ids: Ints | None, /) -> Ints:
        """Return whom each observation (n,) is of, or `UNIDENTIFIED`."""
        ...

    def expect(self, landmarks: Ints, points_robot: Floats) -> None:
        """Expect landmarks (n,) at points (n, d) in the next scan, and nothing else."""
        ...

    @property
    def rejected(self) -> list[int]:
        """Scans, counted from 0, that fit no other and so add nothing to the map."""
        ...


class Numbered:
    """A registration that numbers landmarks in the order of first sight, and judges no scan."""

    def __init__(self) -> None:
        self.n_landmarks = 0

    def labels_of(self, landmarks: Ints) -> Ints:
        """Return landmarks (n,) as they are: they go by their number."""
        return landmarks

    @property
    def rejected(self) -> list[int]:
        """No scan."""
        return []

    def number_new(self, landmarks: Ints) -> Bools:
        """Give every `UNIDENTIFIED` entry (n,) a number of its own, in place; return which."""
        new = landmarks == UNIDENTIFIED
        n_new = int(new.sum())
        landmarks[new] = self.n_landmarks + np.arange(n_new)
        self.n_landmarks += n_new
        return np.asarray(new)


def middle(values: Floats) -> float:
    """Return the upper median of values (n,): a fraction of the cost of `numpy.median`."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])


def nearest(tree: cKDTree, points: Floats, rank: int = 1) -> tuple[Floats, Ints]:
    """Return distances and indices (n, rank) of the points' nearest in the tree, nearest first.

    Where the tree holds fewer, the distance is infinite and the index the tree's size.
    """
    distance, index = tree.query(points, k=_RANKS[rank])
    return np.asarray(distance), np.asarray(index)
