"""The columns of the landmark table.

Each has the value of a new row and the rule applied when a landmark is merged into an older one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args, get_type_hints

import numpy as np
from numpy.typing import DTypeLike

from relmap.core.arrays import Bools, Bytes, Counts, Floats, Ints

NEVER = -(2**62)
"""Last iteration of a landmark that was never seen."""

NONE = -1
"""Value for a landmark without group, submap, moving bin or cell."""

Merge = Literal["old", "new", "least", "most", "sum"]


@dataclass(frozen=True)
class Column:
    """Description of a column.

    `fill`, scalar: value of a new row; `merged`: value of the older landmark after a merge: its
    own, the new one's, or the minimum, maximum or sum of both; `vector`: whether a row has one
    value for each coordinate; `dtype`: numpy dtype, that of the annotation.
    """

    fill: Any
    merged: Merge = "new"
    vector: bool = False
    dtype: DTypeLike | None = None


class Columns:
    """The columns: (n,), or (n, d) where a row has one value for each coordinate."""

    landmark_of: Annotated[Ints, Column(NONE, "old")]
    """The landmark that each row represents: itself, unless it was merged into an older one."""
    track_begin: Annotated[Ints, Column(0, "old")]
    track_end: Annotated[Ints, Column(NEVER, "old")]
    track_observations: Annotated[Ints, Column(0, "old")]
    """First and last iteration in which it was seen under its own number, merged or not, and the
    number of observations."""
    first: Annotated[Ints, Column(0, "least")]
    last: Annotated[Ints, Column(NEVER, "most")]
    """Iterations in which a landmark was first, in a new row now, and last seen; `NEVER`."""
    since: Annotated[Ints, Column(0, "old")]
    """First iteration since the last merge."""
    observations: Annotated[Ints, Column(0, "sum")]
    begin: Annotated[Counts, Column(0)]
    in_interval: Annotated[Counts, Column(0)]
    """First iteration of the current interval, and number of observations in it."""
    is_gone: Annotated[Bools, Column(False)]
    """Whether it has left the view and waits for its last group."""
    level: Annotated[Bytes, Column(0)]
    highest_level: Annotated[Bytes, Column(0, "most")]
    """Grouping level, 0 to 3, reached in the current interval, and in any."""
    averaged: Annotated[Counts, Column(0)]
    """Observations of the current interval averaged into the position."""
    group: Annotated[Counts, Column(NONE)]
    """Group that provides the position in the current interval, or `NONE`."""
    dynamic: Annotated[Bools, Column(False)]
    restless: Annotated[Bools, Column(False)]
    """Whether it is dynamic, and whether it moved in the last test."""
    strikes: Annotated[Counts, Column(0)]
    struck_until: Annotated[Counts, Column(-1)]
    moved_until: Annotated[Counts, Column(0)]
    tested_until: Annotated[Counts, Column(0)]
    """Number of consecutive groups that saw it move; and the last iterations of these groups, of
    any motion, and of any test."""
    moving_bin: Annotated[Counts, Column(NONE)]
    """Bin of a dynamic landmark that moves together with others, or `NONE`."""
    position: Annotated[Floats, Column(np.nan, "old", vector=True)]
    """Frame of the submap, metres; NaN if unmapped. `merge` averages positions."""
    weight: Annotated[Floats, Column(0.0, "old")]
    """Iterations averaged into the position; 0 if unmapped."""
    settled_position: Annotated[Floats, Column(0.0, "old", vector=True)]
    settled_weight: Annotated[Floats, Column(0.0, "old")]
    """The same for completed intervals."""
    submap: Annotated[Ints, Column(NONE, "old")]
    asked_level: Annotated[Bytes, Column(0)]
    """Level at which it was last compared with older landmarks."""
    cell: Annotated[Ints, Column(NONE, "old")]
    next_in_cell: Annotated[Counts, Column(NONE, "old")]
    """Place in the spatial index."""
    last_segment: Annotated[Counts, Column(NONE, "old")]
    """Condensed segment that saw it last, or `NONE`."""


def _described(hint: Any) -> Column:
    array, column = get_args(hint)
    found: Column = replace(column, dtype=get_args(get_args(array)[1])[0])
    return found


COLUMNS = {
    name: _described(hint) for name, hint in get_type_hints(Columns, include_extras=True).items()
}

MERGED: dict[str, Callable[[Any, Any], Any]] = {
    "new": lambda new, old: new,
    "least": np.minimum,
    "most": np.maximum,
    "sum": np.add,
}
