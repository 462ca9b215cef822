"""The interface of all registrations."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints

UNIDENTIFIED = -1
"""Marks an observation that belongs to no known landmark."""


_RANKS = {rank: list(range(1, rank + 1)) for rank in range(1, 33)}


class Registration(Protocol):
    """Assigns observations to landmarks, which are numbered in the order of first observation."""

    def labels_of(self, landmarks: Ints) -> Ints:
        """Return the public labels of landmarks (n,)."""
        ...

    def match(self, seen: Any, ids: Ints | None, /) -> Ints:
        """Return the landmark of each observation (n,), or `UNIDENTIFIED`."""
        ...

    def expect(self, landmarks: Ints, points_robot: Floats) -> None:
        """Expect landmarks (n,) at points (n, d) in the next scan, and no others."""
        ...

    @property
    def rejected(self) -> list[int]:
        """Scans, counted from 0, that match no other scan and do not enter the map."""
        ...


class Numbered:
    """A registration that numbers landmarks by first observation and rejects no scan."""

    def __init__(self) -> None:
        self.n_landmarks = 0

    def labels_of(self, landmarks: Ints) -> Ints:
        """Return landmarks (n,) unchanged: their numbers are their labels."""
        return landmarks

    @property
    def rejected(self) -> list[int]:
        """No scan."""
        return []

    def number_new(self, landmarks: Ints) -> Bools:
        """Give every `UNIDENTIFIED` entry (n,) a new number, in place; return which ones."""
        new = landmarks == UNIDENTIFIED
        n_new = int(new.sum())
        landmarks[new] = self.n_landmarks + np.arange(n_new)
        self.n_landmarks += n_new
        return np.asarray(new)


def middle(values: Floats) -> float:
    """Return the upper median of values (n,), much faster than `numpy.median`."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])


def nearest(tree: cKDTree, points: Floats, rank: int = 1) -> tuple[Floats, Ints]:
    """Return distances and indices (n, rank) of the nearest points in the tree, nearest first.

    If the tree has fewer points, the distance is infinite and the index is the tree's size.
    """
    distance, index = tree.query(points, k=_RANKS[rank])
    return np.asarray(distance), np.asarray(index)
