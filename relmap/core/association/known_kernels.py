"""The numbers of landmarks with given ids, compiled; see `known`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Ints
from relmap.core.linalg.compiling import compiled, helper

MIX = 0x1E3779B97F4A7C15
"""Spreads the ids over the slots (Knuth, "The Art of Computer Programming", 6.4)."""


@helper
def _slot(slots: Ints, labels: Ints, label: int) -> int:
    """Return the slot of an id, or the free one where it belongs, by linear probing."""
    at = (((label ^ (label >> 32)) * MIX) >> 32) & (len(slots) - 1)
    while slots[at] >= 0 and labels[slots[at]] != label:
        at = (at + 1) & (len(slots) - 1)
    return at


@compiled
def numbers_of(slots: Ints, labels: Ints, ids: Ints) -> Ints:
    """Return the landmark of each id (n,); -1 for those not entered, and for negative ids.

    `labels` (m,): the id of each landmark; `slots` (k,), k a power of two: a hash table of the
    landmarks by their ids, -1 where free.
    """
    numbers = np.empty(len(ids), dtype=np.int64)
    for k in range(len(ids)):
        numbers[k] = slots[_slot(slots, labels, ids[k])] if ids[k] >= 0 else -1
    return numbers


@compiled
def enter(slots: Ints, labels: Ints, first: int) -> None:
    """Add the landmarks from the first one on to the slots."""
    for number in range(first, len(labels)):
        slots[_slot(slots, labels, labels[number])] = number
