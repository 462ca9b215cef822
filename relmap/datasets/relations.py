"""Manually checked relations between poses: the ground truth of real laser logs.

R. Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots 27, 2009.
Each line is ``t1 t2 x y z roll pitch yaw``: the pose at t2 in the frame of the pose at t1.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.number_rows import read_rows
from relmap.datasets.scans import poses_of

_COLUMNS = "t1 t2 x y z roll pitch yaw"
_LIMITS = (1e12, 1e12, *[MAX_COORDINATE_M] * 6)


@dataclass(frozen=True, eq=False)
class Relations:
    """True relative poses, as a structure of arrays.

    `begin_s`, `end_s` (r,): times of the two poses, seconds, by the log's clock; `T_begin_end`
    (r, 4, 4): the later pose in the frame of the earlier one, metres.
    """

    begin_s: Floats
    end_s: Floats
    T_begin_end: Floats


def read_relations(path: Path) -> Relations:
    """Read a ``.relations`` file.

    Raises `RelmapError` if it cannot be read, has no relation, or a line is not a relation.
    """
    table = read_rows(path, _LIMITS, "#", "relation", f"8 numbers: {_COLUMNS}").values
    T = poses_of(Rotation.from_euler("xyz", table[:, 5:]), table[:, 2:5])
    return Relations(table[:, 0], table[:, 1], T)
