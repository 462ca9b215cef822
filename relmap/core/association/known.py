"""Registration with known ids."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints, entries
from relmap.core.association.base import UNIDENTIFIED, Registration
from relmap.core.association.metric import RayNoise
from relmap.core.association.rigidity import Rigidity
from relmap.core.state.growing import GrowingArray

LARGEST = 2**21
"""Ids below it are looked up in an array."""


class _Numbers:
    """The number of each id, in the order of first observation; `labels`: the ids so far."""

    def __init__(self, labels: GrowingArray[np.int64]) -> None:
        self._small = np.full(1, UNIDENTIFIED, np.int32)  # the last entry is of no id
        self._large: dict[int, int] = {}
        self._labels, before = labels, labels.values
        labels.hold(before[:0])
        self.of(before)

    def of(self, ids: Ints) -> Ints:
        """Return the numbers of ids (n,); `UNIDENTIFIED` stays."""
        numbers = self._small.take(np.minimum(ids, len(self._small) - 1)).astype(np.int64)
        unknown = (numbers < 0).nonzero()[0]
        if len(unknown):
            numbers[unknown] = [self._number(label) for label in ids[unknown].tolist()]
        return numbers

    def _number(self, label: int) -> int:
        """Return the number of an id, or a new one."""
        if label < 0:
            return UNIDENTIFIED
        number = len(self._labels)
        if label >= LARGEST:
            number = self._large.setdefault(label, number)
        elif label >= len(self._small) - 1 or self._small[label] < 0:
            self._enter(label, number)
        else:
            number = int(self._small[label])
        if number == len(self._labels):
            self._labels.append(label)
        return number

    def _enter(self, label: int, number: int) -> None:
        """Enter an id below the largest in the array."""
        if label >= len(self._small) - 1:
            more = np.full(max(label + 1, len(self._small)), UNIDENTIFIED, np.int32)
            self._small = np.concatenate([self._small, more])
        self._small[label] = number


class KnownAssociation(Registration):
    """Uses the given ids, except for geometrically impossible observations; see `Rigidity`.

    It rejects scans that are inconsistent with the others. `overruled_scans`, `overruled_rows`:
    scan and row of each observation that was not assigned to its given id.
    """

    _rejected: list[int]
    overruled_scans: list[int]
    overruled_rows: list[int]
    STATE = "_rejected overruled_scans overruled_rows _n_scans _rigidity _labels"

    def __init__(self) -> None:
        self._rejected, self.overruled_scans, self.overruled_rows = [], [], []
        self._n_scans = 0
        self._rigidity = Rigidity()
        self._labels: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._number = _Numbers(self._labels)

    def inform(self, motion: Floats | None, covariances: Floats | None) -> None:
        """Use the covariances (n, d, d) of the next scan, if known."""
        self._rigidity.rays.given = covariances

    @property
    def estimated(self) -> RayNoise:
        """Noise of observations that come without covariances."""
        return self._rigidity.rays

    @property
    def rejected(self) -> list[int]:
        """Scans, counted from 0, that are inconsistent with the others."""
        return self._rejected

    def restored(self) -> None:
        """Look up the current ids."""
        self._number = _Numbers(self._labels)

    def labels_of(self, landmarks: Ints) -> Ints:
        """Return the ids of landmarks (n,); `UNIDENTIFIED` stays."""
        if not len(self._labels):
            return landmarks.copy()
        return entries(self._labels.values, landmarks)

    def match(self, points_robot: Floats, ids: Ints | None) -> Ints:
        """Return the landmark of each id (n,).

        Observations with negative ids, and inconsistent ones, belong to none.
        """
        known = np.empty(0, dtype=np.int64) if ids is None else ids
        self._n_scans += 1
        return self._number.of(self._checked(known, points_robot))

    def _checked(self, ids: Ints, points_robot: Floats) -> Ints:
        """Return the ids (n,), replaced or `UNIDENTIFIED` for inconsistent observations.

        Record the rows that changed.
        """
        if len(ids) and ids[ids.argmin()] >= 0:
            good = self._rigidity.checked(ids, points_robot)
            if good is ids:
                return ids
            named = np.arange(len(ids))
        else:
            named = np.flatnonzero(ids >= 0)
            good = self._rigidity.checked(ids[named], points_robot[named])
        if good is None:
            self._rejected.append(self._n_scans - 1)
            return np.full(len(ids), UNIDENTIFIED)
        checked = np.full(len(ids), UNIDENTIFIED)
        checked[named] = good
        overruled = named[good != ids[named]]
        self.overruled_scans += [self._n_scans - 1] * len(overruled)
        self.overruled_rows += overruled.tolist()
        return checked
