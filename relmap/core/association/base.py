"""The interface of all registrations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints

if TYPE_CHECKING:
    from relmap.core.association.metric import RayNoise

UNIDENTIFIED = -1
"""Marks an observation that belongs to no known landmark."""


class Registration:
    """Assigns observations to landmarks, which are numbered in the order of first observation.

    By default it knows nothing of motions and of the noise of observations, and rejects no scan.
    """

    def match(self, seen: Any, ids: Ints | None, /) -> Ints:
        """Return the landmark of each observation (n,), or `UNIDENTIFIED`."""
        raise NotImplementedError

    def labels_of(self, landmarks: Ints) -> Ints:
        """Return the public labels of landmarks (n,): by default, their numbers; -1 stays."""
        return landmarks

    def expect(self, landmarks: Ints, points_robot: Floats) -> None:
        """Expect landmarks (n,) at points (n, d) in the next scan, and no others."""

    def begin_log(self) -> None:
        """Note that a log begins: its first scan may be taken anywhere."""

    def inform(self, motion: Floats | None, covariances: Floats | None) -> None:
        """Use the odometry (4, 4) into the next scan and its covariances (n, d, d), if known."""

    @property
    def estimates_covariances(self) -> bool:
        """Whether the noise is unequal, and observations are weighted by its estimate."""
        return self.estimated is not None and bool(self.estimated.weighs)

    @property
    def estimated(self) -> RayNoise | None:
        """Noise of observations that come without covariances; None if it is not estimated."""
        return None

    @property
    def is_blurred(self) -> bool:
        """Whether the noise makes many single matches ambiguous."""
        return False

    @property
    def rejected(self) -> list[int]:
        """Scans, counted from 0, that match no other scan and do not enter the map."""
        return []

    @property
    def tied_share(self) -> float | None:
        """Fraction of scans matched to the tracks at once; None if not applicable."""
        return None

    @property
    def unique_share(self) -> float | None:
        """Fraction of scans whose matches exceed what chance produces; None if not applicable."""
        return None


class Numbered(Registration):
    """A registration that numbers landmarks without ids by first observation."""

    def __init__(self) -> None:
        self.n_landmarks = 0

    def number_new(self, landmarks: Ints) -> None:
        """Give every `UNIDENTIFIED` entry (n,) a new number, in place."""
        new = np.flatnonzero(landmarks == UNIDENTIFIED)
        landmarks[new] = self.n_landmarks + np.arange(len(new))
        self.n_landmarks += len(new)


def middle(values: Floats) -> float:
    """Return the upper median of values (n,), much faster than `numpy.median`."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])


def nearest(tree: cKDTree, points: Floats, rank: int = 1) -> tuple[Floats, Ints]:
    """Return distances and indices (n, rank) of the nearest points in the tree, nearest first.

    If the tree has fewer points, the distance is infinite and the index is the tree's size.
    """
    distance, index = tree.query(points, k=[*range(1, rank + 1)])
    return np.asarray(distance), np.asarray(index)


def median_apart(tree: cKDTree, rank: int = 1) -> float:
    """Return the median distance of the points of a tree to the neighbour of a rank, the nearest 1.

    Infinite if most have none.
    """
    return float(np.median(nearest(tree, tree.data, rank + 1)[0][:, -1]))


def mutual(points: Floats, among: Floats, most_m: float) -> tuple[Ints, Ints]:
    """Return the rows (k,) of points (n, d), and of others, that are nearest to each other.

    `most_m`: largest distance, metres.
    """
    if not (len(points) and len(among)):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    distance, there = nearest(cKDTree(among), points)
    back = nearest(cKDTree(points), among)[1][there[:, 0], 0]
    own = np.flatnonzero((back == np.arange(len(points))) & (distance[:, 0] <= most_m))
    return own, there[own, 0]


def one_to_one(pairs: Ints, distance: Floats) -> Ints:
    """Return the pairs (k, 2), nearest first, in which no number occurs twice."""
    unique: list[tuple[int, int]] = []
    taken: set[int] = set()
    for one, other in pairs[np.argsort(distance, kind="stable")].tolist():
        if taken.isdisjoint((one, other)):
            unique.append((one, other))
            taken.update((one, other))
    return np.array(unique, dtype=np.int64).reshape(-1, 2)
