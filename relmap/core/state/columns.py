"""What is known of each landmark: the columns of the table, one row a landmark.

Each with what a new row holds, and what becomes of it when a landmark turns out to be an older one
seen again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

NEVER = -(2**62)
"""Iteration in which a landmark not seen yet was last seen."""
NONE = -1
"""In place of a group, a submap, a moving bin or a cell: the landmark is in none."""

Merge = Literal["old", "new", "least", "most", "sum"]


class Column(NamedTuple):
    """What a column holds.

    Attributes
    ----------
    dtype : numpy dtype
    fill : scalar
        Value of a new row.
    merged : str
        What the old landmark has after a merge: its own value, the new one's, or the least, the
        most or the sum of both.
    vector : bool
        Whether a row has one value for each coordinate.
    """

    dtype: DTypeLike
    fill: Any
    merged: Merge = "new"
    vector: bool = False


COLUMNS = {
    # who it is: a new row is a landmark of its own
    "landmark_of": Column(np.int64, NONE, "old"),
    # first and last iteration in which it was seen under its own number, and how often
    "track_begin": Column(np.int64, 0, "old"),
    "track_end": Column(np.int64, NEVER, "old"),
    "track_observations": Column(np.int64, 0, "old"),
    # sightings; `first` and `since` of a new row are the present iteration
    "first": Column(np.int64, 0, "least"),
    "last": Column(np.int64, NEVER, "most"),
    "since": Column(np.int64, 0, "old"),
    "observations": Column(np.int64, 0, "sum"),
    # the present interval, in which the landmark is in view
    "begin": Column(np.int64, 0, "new"),
    "in_interval": Column(np.int64, 0, "new"),
    "is_gone": Column(np.bool_, False, "new"),
    # the group that its position comes from
    "level": Column(np.int64, 0, "new"),
    "highest_level": Column(np.int64, 0, "most"),
    "averaged": Column(np.int64, 0, "new"),
    "group": Column(np.int64, NONE, "new"),
    # motion
    "dynamic": Column(np.bool_, False, "new"),
    "restless": Column(np.bool_, False, "new"),
    "strikes": Column(np.int64, 0, "new"),
    "struck_until": Column(np.int64, -1, "new"),
    "moved_until": Column(np.int64, 0, "new"),
    "tested_until": Column(np.int64, 0, "new"),
    "moving_bin": Column(np.int64, NONE, "new"),
    # the map; `merge` averages the positions
    "position": Column(np.float64, np.nan, "old", vector=True),
    "weight": Column(np.float64, 0.0, "old"),
    "settled_position": Column(np.float64, 0.0, "old", vector=True),
    "settled_weight": Column(np.float64, 0.0, "old"),
    "submap": Column(np.int64, NONE, "old"),
    # looking for it among older ones, and where it is found
    "asked_level": Column(np.int64, 0, "new"),
    "cell": Column(np.int64, NONE, "old"),
    "next_in_cell": Column(np.int64, NONE, "old"),
    # the condensed segment in which it was seen last
    "last_segment": Column(np.int64, NONE, "old"),
}

MERGED: dict[str, Callable[[Any, Any], Any]] = {
    "new": lambda new, old: new,
    "least": lambda new, old: min(new, old),
    "most": lambda new, old: max(new, old),
    "sum": lambda new, old: new + old,
}
