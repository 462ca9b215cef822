"""Logs of clouds from a carried or tilted sensor, as the mapper of walls can use them."""

from __future__ import annotations

from dataclasses import replace

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.scans import ScanLog
from relmap.segmentation.segmenter import CHECKED
from relmap.segmentation.space import PatchSegmenter, level_scan
from relmap.segmentation.space.levelling import tilted_share

ON_FLOORS = 0.05
"""Fraction of points on planes that are not upright above which a cloud shows floors: it is 0 in
simulated clouds of walls, with up to 0.2 m of noise."""


def shows_floors(log: ScanLog) -> bool:
    """Return whether the first clouds of a log show floors, ceilings or tilted walls.

    Raises `RelmapError` if a scan of the log is damaged.
    """
    return log.dimension == 3 and any(tilted_share(cloud) > ON_FLOORS for cloud in _first(log))


def levelled(log: ScanLog) -> ScanLog:
    """Return a log of clouds as one of level 2-D scans of their walls; see `level_scan`.

    The vertical is estimated in each cloud on its own. Raises `RelmapError` if a scan of the log is
    damaged, or none of the first clouds has a vertical and walls.
    """
    segmenter = PatchSegmenter()
    if not any(len(level_scan(cloud, segmenter)) for cloud in _first(log)):
        raise RelmapError(
            "the clouds cannot be levelled: their planes have no common vertical within 40 degrees "
            "of the sensor's z axis, or no walls; map them with --variant planes3d (Plane3dMapper)"
        )
    read = log.points_of
    return replace(log, dimension=2, points_of=lambda index: level_scan(read(index), segmenter))


def _first(log: ScanLog) -> list[Floats]:
    """Return the first clouds that hold any points."""
    found: list[Floats] = []
    for scan in log.scans():
        points = scan.points_robot[scan.points_robot.any(axis=1)]  # others have no return
        if len(points):
            found.append(points)
        if len(found) == CHECKED:
            break
    return found
