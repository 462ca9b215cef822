"""What a plane mapper takes in as one scan: walls, as a robot sees them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError

SHORTEST_M = 1e-6
"""A wall shorter than this has no direction."""


@dataclass(frozen=True, eq=False)
class PlaneObservation:
    """The walls of one scan: robot frame, metres; m walls.

    Attributes
    ----------
    ends : (m, 2, 2) float64
        x, y of the right and the left end, as seen from the robot.
    static : (m, 2) bool
        Whether an end is the wall's own, not where the sight of it ends.
    along : (m, 2) float64
        Unit vector from the right end to the left one.
    normal : (m, 2) float64
        Unit vector towards the robot.
    offset : (m,) float64
        ``normal @ p`` of every point p of the wall: negative.
    size : (m,) float64
    sd : (m,) float64
        Standard deviation of how far away a wall is, where its middle is; 0 where not known.
    z_extent : (m, 2) float64
        Lowest and highest z; 0 where not known.
    """

    ends: NDArray[np.float64]
    static: NDArray[np.bool_]
    along: NDArray[np.float64]
    normal: NDArray[np.float64]
    offset: NDArray[np.float64]
    size: NDArray[np.float64]
    sd: NDArray[np.float64]
    z_extent: NDArray[np.float64]

    def __len__(self) -> int:
        """Return the number of walls."""
        return len(self.ends)

    def only(self, rows: NDArray[np.bool_]) -> PlaneObservation:
        """Return some of the walls."""
        return PlaneObservation(*(getattr(self, field.name)[rows] for field in fields(self)))


def checked_planes(planes: Any) -> PlaneObservation:
    """Return the walls of one scan.

    Parameters
    ----------
    planes : relmap.segmentation.Planes, relmap.simulation's SeenWalls, or the like
        Anything with `ends` (m, 2, 2), robot frame, metres, right to left as seen from the robot,
        and `end_type` (m, 2), "corner" where an end is the wall's own.  `noise` (m,), `n_points`
        (m,) and `z_extent` (m, 2) are used where they are there.

    Raises
    ------
    RelmapError
        Where a shape is wrong, a value is not finite, or the robot sees a wall from behind.
    """
    ends = np.array(planes.ends, dtype=np.float64).reshape(-1, 2, 2)
    kind = np.asarray(planes.end_type)
    m = len(ends)
    if kind.size != 2 * m:
        raise RelmapError(f"end_type has shape {kind.shape}; it must be ({m}, 2), as ends are")
    if not np.isfinite(ends).all():
        wall = int(np.argmax(~np.isfinite(ends).all(axis=(1, 2))))
        raise RelmapError(f"wall {wall} ends at {ends[wall].tolist()}; it must be finite, metres")
    across = ends[:, 1] - ends[:, 0]
    size = np.hypot(across[:, 0], across[:, 1])
    kept = size > SHORTEST_M
    ends, size, kind = ends[kept], size[kept], kind.reshape(m, 2)[kept]
    along = across[kept] / size[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    offset = (normal * ends.mean(axis=1)).sum(axis=1)
    if (offset > 0).any():
        wall = int(np.flatnonzero(kept)[np.argmax(offset > 0)])
        raise RelmapError(
            f"wall {wall} is seen from behind; its ends must go from right to left as seen"
        )
    sd = np.zeros(len(ends))
    if hasattr(planes, "n_points"):
        sd = (planes.noise / np.sqrt(np.maximum(planes.n_points, 1)))[kept]
    z_extent = planes.z_extent[kept] if hasattr(planes, "z_extent") else np.zeros((len(ends), 2))
    return PlaneObservation(ends, kind == "corner", along, normal, offset, size, sd, z_extent)
