"""Beams of a laser: the points of a scan in order, and what they say of a motion.

A motion is computed from walls; beams accept or refuse it.  They agree where the points of one scan
lie on surfaces of the other, and contradict where a beam passed through what is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.core.scan import FARTHEST_M, numbers
from relmap.core.state.growing import GrowingArray

NEAR_M = 0.12
"""Points nearer to a surface agree with it; those twice as far before one contradict it."""


@dataclass(frozen=True, eq=False)
class Beams:
    """The points of one scan, in the order of their bearings; robot frame, metres.

    Attributes
    ----------
    points : (n, 2) float64
    bearings : (n,) float64, ascending
        Seen from the sensor, radians.
    origin : (2,) float64
        Where the sensor is.
    solid : (n,) bool
        Which points are on walls: people and clutter may have moved.
    """

    points: NDArray[np.float64]
    bearings: NDArray[np.float64]
    origin: NDArray[np.float64]
    solid: NDArray[np.bool_]

    @classmethod
    def of(
        cls, points: NDArray[Any], origin: NDArray[np.float64], ends: NDArray[np.float64]
    ) -> Beams:
        """Return the beams that end at points (n, 2), some of them on walls by ends (m, 2, 2)."""
        from relmap.planes.beam_kernels import on_walls

        points = points.astype(np.float64)
        bearings = np.arctan2(points[:, 1] - origin[1], points[:, 0] - origin[0])
        order = np.argsort(bearings, kind="stable")
        points = points[order]
        solid = on_walls(points, ends, NEAR_M)
        return cls(points, bearings[order], origin, solid)

    def __len__(self) -> int:
        """Return the number of beams."""
        return len(self.points)

    @property
    def arrays(self) -> Any:
        """What the kernels know of it."""
        return self.points, self.bearings, self.origin, self.solid


class BeamStore:
    """The beams of every scan, as they were taken: 8 bytes each."""

    _points: GrowingArray[np.float32]
    STATE = "_points _offsets _origins"

    def __init__(self) -> None:
        self._points = GrowingArray(np.float32, (2,))
        self._offsets: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._offsets.extend(np.zeros(1, dtype=np.int64))
        self._origins: GrowingArray[np.float64] = GrowingArray(np.float64, (2,))

    def append(self, points: NDArray[np.float32], origin: NDArray[np.float64]) -> None:
        """Add the points (n, 2) of a scan, and where its sensor is; none where they are not told."""
        self._points.extend(points)
        self._offsets.extend(np.array([len(self._points)]))
        self._origins.extend(origin[None])

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self._points)

    def of(self, iteration: int, ends: NDArray[np.float64]) -> Beams:
        """Return the beams of one scan, of which these are the ends of walls (m, 2, 2)."""
        begin, end = self._offsets.values[iteration : iteration + 2].tolist()
        return Beams.of(self._points.values[begin:end], self._origins.values[iteration], ends)


def checked_beams(planes: Any) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return the points (n, 2) where beams ended, and where the sensor is; none if not told.

    Raises
    ------
    RelmapError
        Where a shape is wrong or a value is not finite.
    """
    points = numbers(getattr(planes, "beams", np.empty((0, 2))), "beams", "an (n, 2) array")
    origin = numbers(getattr(planes, "origin", np.zeros(2)), "origin", "x and y")
    if points.ndim != 2 or points.shape[1] != 2 or origin.shape != (2,):
        raise RelmapError(
            f"beams has shape {points.shape}, origin {origin.shape}; they must be (n, 2) and (2,)"
        )
    if not (np.abs(points) <= FARTHEST_M).all() or not (np.abs(origin) <= FARTHEST_M).all():
        raise RelmapError(f"beams must be finite, metres, and at most {FARTHEST_M:g}")
    return points.astype(np.float32), origin


def compared(
    earlier: Beams, later: Beams, motions: NDArray[np.float64], near_m: float, step: int = 1
) -> NDArray[np.float64]:
    """Return how many points agree, contradict and are not told of; (k, 3).

    For each of the motions (k, 3), yaw, x, y, from the frame of the earlier scan into that of the
    later one; of every so many beams one is looked at.
    """
    from relmap.planes import beam_kernels

    return beam_kernels.compared(earlier.arrays, later.arrays, motions, near_m, step)
