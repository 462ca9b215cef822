"""Validation of one scan of walls."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats
from relmap.core.errors import RelmapError
from relmap.core.scan import FARTHEST_M, numbers
from relmap.core.state.store import ObservationStore
from relmap.planes.scans.beams import GivenBeams, on_loose_things
from relmap.planes.scans.corners import CORNER, CUT, LOOSE, UNKNOWN

CODES = {"open": CUT, "corner": CORNER, "unknown": UNKNOWN}
CODES |= {f"loose {name}": LOOSE + code for name, code in CODES.items()}
"""Kinds of ends by name."""
SHORTEST_M = 1e-6
"""A shorter wall has no defined direction."""
NO_BEAMS = GivenBeams.checked(np.empty((0, 2)), np.zeros(2))
FARTHEST_END_M = FARTHEST_M / 4
"""Upper limit of an end's coordinates, so that points estimated from it stay within the limit of
points."""


@dataclass(frozen=True, eq=False)
class PlaneObservation:
    """The walls of one scan: robot frame, metres; m walls.

    `ends` (m, 2, 2): x, y of the right and the left end, as seen from the robot; `kind` (m, 2):
    whether an end is an end of the wall itself, of its visible part, or unknown, see
    `relmap.planes.scans.corners`; `along`, `normal` (m, 2): unit vectors from the right end to the
    left one, and towards the robot; `offset` (m,): ``normal @ p`` of every point p of the wall:
    negative; `size` (m,); `sd` (m,): standard deviation of the distance of a wall at its midpoint,
    0 if unknown; `z_extent` (m, 2): lowest and highest z, 0 if unknown; `beams`: empty if not
    given.
    """

    ends: Floats
    kind: NDArray[np.int8]
    along: Floats
    normal: Floats
    offset: Floats
    size: Floats
    sd: Floats
    z_extent: Floats
    beams: GivenBeams = NO_BEAMS

    @classmethod
    def of(
        cls, ends: Floats, kind: NDArray[np.int8], sd: Floats, z_extent: Floats
    ) -> PlaneObservation:
        """Return walls from their stored rows."""
        across = ends[:, 1] - ends[:, 0]
        size = np.hypot(across[:, 0], across[:, 1])
        along = across / size[:, None]
        normal = np.empty_like(along)
        normal[:, 0], normal[:, 1] = -along[:, 1], along[:, 0]
        middle = normal * ((ends[:, 0] + ends[:, 1]) / 2)
        offset = middle[:, 0] + middle[:, 1]
        return cls(ends, kind, along, normal, offset, size, sd, z_extent)

    def __len__(self) -> int:
        return len(self.ends)

    @cached_property
    def static(self) -> Bools:
        """Whether an end is given as an end of the wall itself; (m, 2)."""
        return np.asarray(self.kind % LOOSE == CORNER)

    @cached_property
    def loose(self) -> Bools:
        """Which walls (m,) are on small free-standing objects, such as people."""
        return np.asarray((self.kind >= LOOSE).any(axis=1))

    @cached_property
    def arrays(self) -> Any:
        """The walls in the form used by the compiled matching."""
        return self.ends, self.along, self.normal, self.size, self.sd, self.static

    def only(self, rows: Bools | slice) -> PlaneObservation:
        """Return some of the walls, without beams."""
        names = [column.name for column in fields(self) if column.name != "beams"]
        return PlaneObservation(**{name: getattr(self, name)[rows] for name in names})


def seen_before(store: ObservationStore, scan: int) -> PlaneObservation:
    """Return the walls of an earlier scan, without beams."""
    columns, rows = ("location", "kind", "sd", "z_extent"), store.rows(scan)
    return PlaneObservation.of(*(store.column(name)[rows] for name in columns))


def checked_planes(planes: Any, beams: Any = None) -> PlaneObservation:
    """Return the walls of one scan.

    `planes`: `relmap.segmentation.Planes`, the `SeenWalls` of relmap.simulation, or the like:
    anything with `ends` (m, 2, 2), robot frame, metres, right to left as seen from the robot, and
    `end_type` (m, 2), "corner" for an end of the wall itself, "unknown" if not known, which is the
    default. `noise` (m,), `n_points` (m,), `z_extent` (m, 2) and `origin` (2,), the position of the
    sensor, are used if present. `beams` (n, 2) or (n, 3): end points of the beams; see
    `GivenBeams.checked`. Raises `RelmapError` if a shape is wrong, a value is not finite, or the
    robot sees a wall from behind.
    """
    ends = checked_ends(planes.ends)
    m = len(ends)
    kind = np.asarray(getattr(planes, "end_type", np.full((m, 2), "unknown")))
    if kind.shape != (m, 2) and (m or kind.size):
        raise RelmapError(f"end_type has shape {kind.shape}; it must be ({m}, 2), as ends are")
    sd, z_extent = _measured(planes, m)
    given = NO_BEAMS
    if beams is not None:
        given = GivenBeams.checked(beams, getattr(planes, "origin", np.zeros(2)))
    kept, kind = np.hypot(*(ends[:, 1] - ends[:, 0]).T) > SHORTEST_M, kind.reshape(m, 2)
    if not kept.all():
        ends, kind, sd, z_extent = ends[kept], kind[kept], sd[kept], z_extent[kept]
    codes = [CODES.get(name, CUT) for name in kind.ravel().tolist()]  # others are not of the wall
    kind = np.array(codes, dtype=np.int8).reshape(kind.shape)
    kind[on_loose_things(ends, given)] += LOOSE
    seen = PlaneObservation.of(ends, kind, sd, z_extent)
    behind = seen.offset > 0
    if behind.any():
        wall = int(np.flatnonzero(kept)[np.argmax(behind)])
        raise RelmapError(
            f"wall {wall} is seen from behind; its ends must go from right to left as seen"
        )
    return replace(seen, beams=given)


def checked_ends(ends: Any) -> Floats:
    """Return the ends of walls as a new array (m, 2, 2).

    Raises `RelmapError` if the shape is wrong or a value is not finite.
    """
    array = numbers(ends, "ends", "an (m, 2, 2) array of numbers")
    if array.size == 0:
        return np.empty((0, 2, 2))
    if array.ndim != 3 or array.shape[1:] != (2, 2):
        raise RelmapError(f"ends has shape {array.shape}; it must be (m, 2, 2)")
    near = (np.abs(array) <= FARTHEST_END_M).all(axis=(1, 2))
    if not near.all():
        wall = int(np.argmin(near))
        raise RelmapError(
            f"wall {wall} ends at {array[wall].tolist()}; it must be finite, metres, and at most "
            f"{FARTHEST_END_M:g}"
        )
    return array


def _measured(planes: Any, m: int) -> tuple[Floats, Floats]:
    """Return the standard deviations of wall distances (m,) and z extents (m, 2), metres."""
    sd, z_extent = np.zeros(m), np.zeros((m, 2))
    if hasattr(planes, "n_points") and hasattr(planes, "noise"):
        n_points = _column(planes.n_points, "n_points", (m,))
        noise = _column(planes.noise, "noise", (m,))
        if (noise < 0).any():
            raise RelmapError("noise holds a negative value; it must be in metres, 0 or more")
        sd = noise / np.sqrt(np.maximum(n_points, 1))
    if hasattr(planes, "z_extent"):
        z_extent = _column(planes.z_extent, "z_extent", (m, 2))
    return sd, z_extent


def _column(values: Any, name: str, shape: tuple[int, ...]) -> Floats:
    array = numbers(values, name, f"a {shape} array of numbers")
    if array.size == 0 and shape[0] == 0:
        return np.zeros(shape)
    if array.shape != shape:
        raise RelmapError(f"{name} has shape {array.shape}; it must be {shape}, one per wall")
    if not np.isfinite(array).all():
        raise RelmapError(f"{name} holds a value that is not finite; it must be in metres")
    return array


def journaled(seen: PlaneObservation) -> Floats:
    """Return the walls (m,) of one scan as rows (m, 9) for a journal."""
    ends = seen.ends.reshape(-1, 4)
    return np.column_stack([ends, seen.z_extent, seen.sd, seen.kind.astype(np.float64)])


def of_journal(rows: Floats) -> SimpleNamespace:
    """Return the walls stored as rows (m, 9)."""
    rows = rows.reshape(-1, 9)
    names = np.full(2 * LOOSE, "loose unknown")
    names[list(CODES.values())] = list(CODES)
    return SimpleNamespace(
        ends=rows[:, :4].reshape(-1, 2, 2),
        end_type=names[rows[:, 7:].astype(np.int64)],
        z_extent=rows[:, 4:6],
        noise=rows[:, 6],
        n_points=np.ones(len(rows)),
    )
