"""The beams of every scan of a run, and their places in a map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.state.growing import GrowingArray
from relmap.planes.scans.beams import Beams, GivenBeams

RECENT = 16
"""Number of scans whose beams are kept in order: neighbouring scans are compared repeatedly."""
FIRST = 20
"""Number of scans by which the angle between beams is estimated."""


class PlacedBeams(NamedTuple):
    """Beams in the frame of a map.

    `begins`, `ends` (n, 2), metres; `scan` (n,), ascending: index of the pose of each beam.
    """

    begins: Floats
    ends: Floats
    scan: Ints


class BeamStore:
    """The end points of the beams of every scan, 8 bytes each (10 for a laser, unless restored)."""

    _points: GrowingArray[np.float32]
    STATE = "_points _offsets _origins _in_order"

    def __init__(self) -> None:
        self._points = GrowingArray(np.float32, (2,))
        self._offsets: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._offsets.extend(np.zeros(1, dtype=np.int64))
        self._origins: GrowingArray[np.float64] = GrowingArray(np.float64, (2,))
        self._in_order: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        self._recent: dict[int, tuple[bytes, Beams]] = {}  # by scan, with the ends of its walls
        # Of each scan of a laser, what `GivenBeams` would search for; not of a restored state.
        self._loose: dict[int, dict[str, Bools]] = {}

    def append(self, given: GivenBeams) -> None:
        """Add the beams of a scan."""
        if given.in_order:
            self._loose[len(self._in_order)] = {"clutter": given.clutter, "loose": given.loose}
        self._points.extend(given.points)
        self._offsets.append(len(self._points))
        self._origins.append(given.origin)
        self._in_order.append(given.in_order)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self._points)

    @property
    def spacing_rad(self) -> float:
        """Angle between the beams of the laser, by the first scans; 0 without a laser."""
        offsets = self._offsets.values[: FIRST + 1]
        scan = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
        x, y = (self._points.values[: offsets[-1]] - self._origins.values[scan]).T
        bearing = np.arctan2(y, x)
        order = np.lexsort((bearing, scan))
        same = (np.diff(scan[order]) == 0) & self._in_order.values[scan[order][1:]]
        return float(np.median(np.diff(bearing[order])[same])) if same.any() else 0.0

    def of(self, scan: int, ends: Floats, given: GivenBeams | None = None) -> Beams:
        """Return the beams of a laser scan, by the ends of its walls (m, 2, 2).

        None of them if they are not ordered, as for a cloud. `given`: of a scan not yet added.
        """
        known = self._recent.get(scan)
        if known is not None and known[0] == ends.tobytes() and given is None:
            return known[1]
        found = Beams.of(given or self.given(scan), ends)
        self._recent[scan] = ends.tobytes(), found
        if len(self._recent) > RECENT:
            del self._recent[next(iter(self._recent))]
        return found

    def given(self, scan: int) -> GivenBeams:
        """Return the beams of a laser scan as given; none if they are not ordered."""
        begin, end = self._offsets.values[scan : scan + 2].tolist()
        end = end if self._in_order.values[scan] else begin
        found = GivenBeams(self._points.values[begin:end], self._origins.values[scan], True)
        vars(found).update(self._loose.get(scan, {}))
        return found

    def placed(self, poses: Floats, span: tuple[int, int], most: int) -> PlacedBeams:
        """Return start and end points of the beams of some scans, by their poses.

        `poses` (k, 4, 4): ``T_map_robot`` of the scans of the span; scans with NaN are left out.
        `span` (int, int): the first scan, and one after the last. `most`: maximum number of beams,
        by subsampling.
        """
        offsets = self._offsets.values[span[0] : span[1] + 1]
        every = max(int(-(-(offsets[-1] - offsets[0]) // most)), 1)
        scan = np.repeat(np.arange(len(poses)), np.diff(offsets))[::every]
        ends = self._points.values[offsets[0] : offsets[-1] : every].astype(np.float64)
        known = np.isfinite(poses[scan, 0, 0])
        scan, ends = scan[known], ends[known]
        R, t = poses[scan, :2, :2], poses[scan, :2, 3]
        origins = self._origins.values[span[0] + scan]
        begins = np.einsum("nij,nj->ni", R, origins) + t
        return PlacedBeams(begins, np.einsum("nij,nj->ni", R, ends) + t, scan)
