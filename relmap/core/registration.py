"""Registration: which landmark each observation is of."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from relmap.core.growing import GrowingArray

UNIDENTIFIED = -1
"""In place of a landmark: the observation belongs to none that is known."""


class Registration(Protocol):
    """How observations find their landmarks, which are numbered in the order of first sight."""

    @property
    def labels(self) -> NDArray[np.int64]:
        """What each landmark is called outside; (n_landmarks,)."""
        ...

    def match(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Return the landmark of each observation (n,), or `UNIDENTIFIED`."""
        ...


class NearestPrevious:
    """The paper's registration: the nearest untransformed observation of the previous iteration.

    A pair is matched where each is the other's nearest and lies within the gate.

    Parameters
    ----------
    gate_m : float or None
        Largest displacement, metres; None takes half the median distance between neighbours in
        the previous scan.
    """

    def __init__(self, gate_m: float | None) -> None:
        self._gate_m = gate_m
        self._n_landmarks = 0
        self._previous: NDArray[np.float64] = np.empty((0, 0))
        self._landmarks = np.empty(0, dtype=np.int64)

    @property
    def labels(self) -> NDArray[np.int64]:
        """Landmarks go by their number; (n_landmarks,)."""
        return np.arange(self._n_landmarks)

    def match(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Match points (n, d) to the previous iteration's; the rest are new landmarks."""
        landmarks = np.full(len(points_robot), UNIDENTIFIED)
        now, before = self._mutual_pairs(points_robot)
        landmarks[now] = self._landmarks[before]
        new = np.flatnonzero(landmarks == UNIDENTIFIED)
        landmarks[new] = self._n_landmarks + np.arange(len(new))
        self._n_landmarks += len(new)
        self._landmarks, self._previous = landmarks, points_robot
        return landmarks

    def _mutual_pairs(
        self, points_robot: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        if not len(self._previous) or not len(points_robot):
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        previous = cKDTree(self._previous)
        distance, nearest = _nearest(previous, points_robot)
        _, back = _nearest(cKDTree(points_robot), self._previous)
        mutual = back[nearest] == np.arange(len(points_robot))
        now = np.flatnonzero(mutual & (distance <= self._gate(previous)))
        return now, nearest[now]

    def _gate(self, previous: cKDTree) -> float:
        if self._gate_m is not None:
            return self._gate_m
        if previous.n < 2:
            return np.inf
        spacing, _ = _nearest(previous, previous.data, rank=2)
        return float(np.median(spacing)) / 2


class KnownAssociation:
    """Registration where the ids of the landmarks come with the observations."""

    def __init__(self) -> None:
        self._landmark_of: dict[int, int] = {}
        self._labels: GrowingArray[np.int64] = GrowingArray(np.int64)

    @property
    def labels(self) -> NDArray[np.int64]:
        """Id of each landmark; (n_landmarks,)."""
        return self._labels.values

    def match(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Return the landmark of each id (n,); negative ids are of none."""
        known = np.empty(0, dtype=np.int64) if ids is None else ids
        new = [i for i in known.tolist() if i >= 0 and i not in self._landmark_of]
        for number, label in enumerate(new, start=len(self._labels)):
            self._landmark_of[label] = number
        self._labels.extend(np.array(new, dtype=np.int64))
        found = (self._landmark_of.get(i, UNIDENTIFIED) for i in known.tolist())
        return np.fromiter(found, dtype=np.int64, count=len(known))


def _nearest(
    tree: cKDTree, points: NDArray[np.float64], rank: int = 1
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return distance and index of each point's nearest, or rank-th nearest, in the tree."""
    distance, index = tree.query(points, k=[rank])
    return np.asarray(distance)[:, 0], np.asarray(index)[:, 0]
