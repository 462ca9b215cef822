"""Beams of a laser: the ordered points of a scan, used to verify motions.

A motion is computed from walls and verified by beams. They agree where the points of one scan lie
on surfaces of the other, and contradict where a beam passed through such a surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats
from relmap.core.errors import RelmapError
from relmap.core.scan import FARTHEST_M, numbers

NEAR_M = 0.12
"""A point nearer to a surface agrees with it; one twice as far in front of it contradicts it."""
PER_SCAN = 2000
"""Maximum number of beams kept per scan, by subsampling: a cloud has a hundred thousand."""
CLUTTER = 1 / 24
"""Fraction of isolated points of a scan from which they are clutter: in other scans, an isolated
one is more likely an object at rest."""
ONE_WALL_M = 0.2
"""Standard deviation of the points of a scan across their main direction below which it shows one
wall only: the motion along it is not determined by bends of decimetres."""


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
