"""The paper's registration (sections II and III)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import UNIDENTIFIED, Numbered, median_apart, mutual


class NearestPrevious(Numbered):
    """Matches to the nearest untransformed observation of the previous iteration.

    A pair matches if both are mutual nearest neighbours within the gate.

    `gate_m`: largest displacement, metres; None uses half the median distance between neighbours in
    the previous scan.
    """

    STATE = "n_landmarks _previous _landmarks"

    def __init__(self, gate_m: float | None) -> None:
        super().__init__()
        self._gate_m = gate_m
        self._previous: Floats = np.empty((0, 0))
        self._landmarks = np.empty(0, dtype=np.int64)

    def expect(self, landmarks: Ints, points_robot: Floats) -> None:
        """Expect landmarks (n,) at points (n, d) in the next scan, and no others."""
        self._landmarks, self._previous = landmarks, points_robot

    def match(self, points_robot: Floats, ids: Ints | None) -> Ints:
        """Match points (n, d) to the previous iteration; unmatched points are new landmarks."""
        landmarks = np.full(len(points_robot), UNIDENTIFIED)
        now, before = mutual(points_robot, self._previous, self._gate())
        landmarks[now] = self._landmarks[before]
        self.number_new(landmarks)
        self._landmarks, self._previous = landmarks, points_robot
        return landmarks

    def _gate(self) -> float:
        if self._gate_m is not None:
            return self._gate_m
        places = np.unique(self._previous, axis=0)  # Most may coincide with others.
        if len(places) < 2:
            return np.inf
        return median_apart(cKDTree(places)) / 2
