"""The columns of the landmark table.

Each has the value of a new row and the rule applied when a landmark is merged into an older one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

NEVER = -(2**62)
"""Last iteration of a landmark that was never seen."""
NONE = -1
"""Value for a landmark without group, submap, moving bin or cell."""

Merge = Literal["old", "new", "least", "most", "sum"]


class Column(NamedTuple):
    """Description of a column.

    `dtype`: numpy dtype; `fill`, scalar: value of a new row; `merged`: value of the older landmark
    after a merge: its own, the new one's, or the minimum, maximum or sum of both; `vector`: whether
    a row has one value for each coordinate.
    """

    dtype: DTypeLike
    fill: Any
    merged: Merge = "new"
    vector: bool = False


COLUMNS = {
    # identity: a new row is a separate landmark
    "landmark_of": Column(np.int64, NONE, "old"),
    # first and last iteration seen under its own number, and observation count
    "track_begin": Column(np.int64, 0, "old"),
    "track_end": Column(np.int64, NEVER, "old"),
    "track_observations": Column(np.int64, 0, "old"),
    # observations; `first` and `since` of a new row are the current iteration
    "first": Column(np.int64, 0, "least"),
    "last": Column(np.int64, NEVER, "most"),
    "since": Column(np.int64, 0, "old"),
    "observations": Column(np.int64, 0, "sum"),
    # the current interval, in which the landmark is in view
    "begin": Column(np.int64, 0, "new"),
    "in_interval": Column(np.int64, 0, "new"),
    "is_gone": Column(np.bool_, False, "new"),
    # the group that provides its position
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
    # re-observation: last comparison with older landmarks, and spatial index
    "asked_level": Column(np.int64, 0, "new"),
    "cell": Column(np.int64, NONE, "old"),
    "next_in_cell": Column(np.int64, NONE, "old"),
    # the condensed segment that saw it last
    "last_segment": Column(np.int64, NONE, "old"),
}

MERGED: dict[str, Callable[[Any, Any], Any]] = {
    "new": lambda new, old: new,
    "least": np.minimum,
    "most": np.maximum,
    "sum": np.add,
}
