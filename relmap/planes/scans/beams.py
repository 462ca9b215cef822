"""Beams of a laser: the ordered points of a scan, used to verify motions.

A motion is computed from walls and verified by beams. They agree where the points of one scan lie
on surfaces of the other, and contradict where a beam passed through such a surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.scan import FARTHEST_M, numbers
from relmap.core.state.growing import GrowingArray

NEAR_M = 0.12
"""A point nearer to a surface agrees with it; one twice as far in front of it contradicts it."""
RECENT = 16
"""Number of scans whose beams are kept in order: neighbouring scans are compared repeatedly."""
PER_SCAN = 2000
"""Maximum number of beams kept per scan, by subsampling: a cloud has a hundred thousand."""
CLUTTER = 1 / 24
"""Fraction of isolated points of a scan from which they are clutter: in other scans, an isolated
one is more likely an object at rest."""
ONE_WALL_M = 0.2
"""Standard deviation of the points of a scan across their main direction below which it shows one
wall only: the motion along it is not determined by bends of decimetres."""
FIRST = 20
"""Number of scans by which the angle between beams is estimated."""


@dataclass(frozen=True, eq=False)
class Beams:
    """The points of one scan, sorted by bearing; robot frame, metres.

    `points` (n, 2); `bearings` (n,), ascending: seen from the sensor, radians. `origin` (2,):
    position of the sensor. `solid` (n,): which points are on walls: people and clutter may have
    moved. `loose` (n,): which points are on small free-standing objects, such as people; these are
    not compared.
    """

    points: Floats
    bearings: Floats
    origin: Floats
    solid: Bools
    loose: Bools

    @classmethod
    def of(cls, given: GivenBeams, ends: Floats) -> Beams:
        """Return the beams of a scan, some of them on walls by ends (m, 2, 2)."""
        from relmap.planes.scans.loose_kernels import on_walls

        points, bearings = given.by_bearing
        return cls(points, bearings, given.origin, on_walls(points, ends, NEAR_M), given.loose)

    def __len__(self) -> int:
        """Return the number of beams."""
        return len(self.points)

    @cached_property
    def on_one_wall(self) -> bool:
        """Whether all points lie along one line, bent by decimetres at most."""
        x, y = (self.points - self.points.mean(axis=0)).T
        xx, xy, yy = x @ x, x @ y, y @ y
        across = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
        return bool(across < ONE_WALL_M**2 * len(x))

    @cached_property
    def arrays(self) -> Any:
        """The arrays that the kernels use."""
        from relmap.planes.scans.beam_kernels import surfaces

        found = surfaces(self.points, self.bearings, self.origin)
        return self.points, self.origin, self.solid, self.loose, *found


@dataclass(frozen=True, eq=False)
class GivenBeams:
    """The end points of the beams of one scan, as given to a mapper; robot frame, metres.

    `points` (n, 2); `origin` (2,): position of the sensor. `in_order`: whether they come from a 2-D
    laser, whose beams verify motions; those of a cloud only mark free space.
    """

    points: NDArray[np.float32]
    origin: Floats
    in_order: bool

    @classmethod
    def checked(cls, points: Any, origin: Any) -> GivenBeams:
        """Return beams given their end points: (n, 2) of a laser, (n, 3) of a cloud.

        Those without a return, at the origin, are left out, and the others subsampled to at most
        `PER_SCAN`.

        Raises `RelmapError` if a shape is wrong or a value is not finite.
        """
        points = numbers(points, "beams", "an (n, 2) or (n, 3) array of numbers")
        origin = numbers(origin, "origin", "x and y of the sensor")
        points = points if points.shape != (0,) else np.empty((0, 2))
        if points.ndim != 2 or points.shape[1] not in (2, 3) or origin.shape != (2,):
            raise RelmapError(
                f"beams has shape {points.shape} and origin {origin.shape}; they must be (n, 2) or "
                "(n, 3), and (2,)"
            )
        if not all((np.abs(values) <= FARTHEST_M).all() for values in (points, origin)):
            raise RelmapError(f"beams must be finite, metres, and at most {FARTHEST_M:g}")
        in_order = points.shape[1] == 2
        returned = (points[:, 0] != origin[0]) | (points[:, 1] != origin[1])
        points = points if returned.all() else points[returned]
        every = max(-(-len(points) // PER_SCAN), 1)
        return cls(points[::every, :2].astype(np.float32), origin, in_order)

    @cached_property
    def by_bearing(self) -> tuple[Floats, Floats]:
        """Points (n, 2) by bearing from the sensor, and bearings."""
        points = self.points.astype(np.float64)
        bearings = np.arctan2(points[:, 1] - self.origin[1], points[:, 0] - self.origin[0])
        order = np.argsort(bearings, kind="stable")
        return points.take(order, axis=0), bearings[order]

    @cached_property
    def clutter(self) -> Bools:
        """Which points by bearing (n,) are isolated specks, if many are; otherwise none."""
        from relmap.planes.scans.loose_kernels import isolated_points

        found = _found_round(isolated_points, *self.by_bearing, self.origin)
        return np.asarray(found & (np.count_nonzero(found) >= CLUTTER * len(found)))

    @cached_property
    def loose(self) -> Bools:
        """Which points by bearing (n,) are on loose objects; clutter does not divide them."""
        from relmap.planes.scans.loose_kernels import free_standing

        points, bearings = self.by_bearing
        found, rest = _found_round(free_standing, points, bearings, self.origin), ~self.clutter
        if not rest.all():
            seen = points[rest], bearings[rest], self.origin
            found[rest] = _found_round(free_standing, *seen)
        return found

    def to_bytes(self) -> bytes:
        """Return the values stored in a journal: order flag, origin and points."""
        about = np.array([self.in_order, *self.origin], dtype="<f8")
        return about.tobytes() + self.points.astype("<f4").tobytes()

    @classmethod
    def from_bytes(cls, kept: bytes) -> GivenBeams:
        """Return beams from stored values."""
        about, points = np.frombuffer(kept[:24], "<f8"), np.frombuffer(kept[24:], "<f4")
        return cls(points.astype(np.float32).reshape(-1, 2), about[1:].copy(), bool(about[0]))


def _found_round(
    kernel: Callable[[Floats, Floats, Floats], Bools],
    points: Floats,
    bearings: Floats,
    origin: Floats,
) -> Bools:
    """Return what a kernel finds among points (n,); all round, the last is beside the first."""
    from relmap.planes.scans.loose_kernels import UNSEEN_RAD

    n, turn = len(points), 2 * np.pi
    if n == 0 or bearings[0] + turn - bearings[-1] > UNSEEN_RAD:
        return kernel(points, bearings, origin)
    found = kernel(np.tile(points, (2, 1)), np.append(bearings, bearings + turn), origin)
    return np.asarray(found[:n] | found[n:])


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


def compared(
    earlier: Beams, later: Beams, motions: Floats, near_m: float, step: int = 1, firm: bool = True
) -> Floats:
    """Return how many points agree, contradict, are undecided, and are out of view; (k, 4).

    For each of the motions (k, 3), yaw, x, y, from the frame of the earlier scan into that of the
    later one; the beams are subsampled.
    """
    from relmap.planes.scans import beam_kernels

    return beam_kernels.compared(earlier.arrays, later.arrays, motions, near_m, step, firm)


def odds_over(
    pairs: Iterable[tuple[Beams, Beams, Floats]], firm: bool = True
) -> tuple[Floats, Floats]:
    """Return the log odds that motions are better than another one, by the beams of scans.

    Only points in view by both motions are compared, one by one (McNemar): otherwise standing
    still, which keeps all of them in view, is favoured.

    `pairs`: an earlier scan, a later one, and the motions (1 + k, 3) between the two, of which the
    first is the other one. Returns `odds`, `share` (k,): log odds, and the sum of the differences
    in agreement as a fraction of the points.
    """
    from relmap.planes.scans import beam_kernels

    lead: Any = 0.0
    variance, n = lead, 0
    for earlier, later, motions in pairs:
        off = beam_kernels.differences(earlier.arrays, later.arrays, motions, firm)
        lead, variance = lead + off.sum(axis=1), variance + (off**2).sum(axis=1)
        n += len(earlier) + len(later)
    odds = np.sign(lead) * lead**2 / np.maximum(variance, 1e-18) / 2
    return np.asarray(odds), np.asarray(lead / max(n, 1))


def on_loose_things(ends: Floats, given: GivenBeams) -> Bools:
    """Return which walls, by their ends (m, 2, 2), are on small free-standing objects."""
    if not given.in_order:
        return np.zeros(len(ends), dtype=np.bool_)
    from relmap.planes.scans.loose_kernels import loose_walls

    return loose_walls(given.by_bearing[0], given.loose, ends)


def preferred(motions: Floats, odds_to: Callable[[Floats], Floats]) -> tuple[int, Floats]:
    """Return which of some motions (k, 3) beams prefer, and the log odds (k,) relative to it.

    `odds_to`: returns the log odds relative to a motion (3,). What is preferred to one motion need
    not be to another, so each that is preferred is compared with all.
    """
    best, odds = 0, odds_to(motions[0])
    for _ in motions:
        if odds.max() <= 0:
            break
        best = int(np.argmax(odds))
        odds = odds_to(motions[best])
    return best, odds
