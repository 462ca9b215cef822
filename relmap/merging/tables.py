"""Merging two tables of landmarks in one frame."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import LandmarkTable

COMBINED = {
    "observations": np.add,
    "first_iteration": np.minimum,
    "last_iteration": np.maximum,
    "level": np.maximum,
}
"""How columns of merged landmarks are combined."""


def joined(one: LandmarkTable, other: LandmarkTable, pairs: Ints) -> LandmarkTable:
    """Merge two tables with positions in one frame and distinct labels.

    Parameters
    ----------
    one, other : LandmarkTable
    pairs : (k, 2) int64
        Rows of `other` and of `one` that are one landmark, which keeps the label from `one`.
        Positions are averaged, weighted by their variances if both are known, otherwise by the
        number of observations.
    """
    theirs, mine = pairs.T
    share = _share(one, other, mine, theirs)
    position, sd = one.position.copy(), one.sd.copy()
    position[mine] += share[:, None] * (other.position[theirs] - position[mine])
    sd[mine] = np.hypot((1 - share) * one.sd[mine], share * other.sd[theirs])
    columns = {field.name: getattr(one, field.name).copy() for field in fields(LandmarkTable)}
    columns |= {"position": position, "sd": sd}
    for name, of in COMBINED.items():
        columns[name][mine] = of(columns[name][mine], getattr(other, name)[theirs])
    rest = np.setdiff1d(np.arange(len(other.landmark)), theirs)
    for name, column in columns.items():
        columns[name] = np.concatenate([column, getattr(other, name)[rest]])
    return LandmarkTable(**columns)


def _share(one: LandmarkTable, other: LandmarkTable, mine: Ints, theirs: Ints) -> Floats:
    """Return the weight of the second position of each pair in the average."""
    a, b = one.sd[mine] ** 2, other.sd[theirs] ** 2
    seen = one.observations[mine], other.observations[theirs]
    by_count = seen[1] / np.maximum(seen[0] + seen[1], 1)
    known = (a > 0) & (b > 0)
    return np.where(known, a / np.where(known, a + b, 1.0), by_count)
