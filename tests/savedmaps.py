"""A saved map, and all public results of a mapper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from relmap import PointMapper
from tests.worlds import fed, walk


def told(mapper: Any) -> tuple[bytes, ...]:
    """Return all public results of a mapper."""
    found, rows = mapper.map, mapper.landmarks
    return (
        *(found.positions.tobytes(), found.landmark_ids.tobytes(), found.covariances.tobytes()),
        *(mapper.trajectory.tobytes(), rows.sd.tobytes(), rows.level.tobytes()),
        *(group.relative_map.tobytes() for group in mapper.groups),
    )


def saved_map(folder: Path) -> Path:
    mapper = fed(PointMapper(), (points for _, points in walk(3, 3, 0.02, iterations=40).scans))
    mapper.save(folder / "mapper.npz")
    return folder / "mapper.npz"


def state(mapper: Any, folder: Path) -> bytes:
    """Return everything that a mapper holds."""
    mapper.save(folder / "state.npz")
    return (folder / "state.npz").read_bytes()
