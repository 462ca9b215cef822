"""The result of a run of the mapper of planes in space."""

from __future__ import annotations

from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import LandmarkTable
from relmap.core.landmarks import Submap as LandmarkSubmap
from relmap.evaluation.feeding import Log, stamps_of
from relmap.evaluation.summary import by_status, steps_of
from relmap.io.results import SubmapPath, Tracks, shifted
from relmap.planes3d import Plane3dMapper
from relmap.planes3d.files import Plane3dResult
from relmap.planes3d.submap import Submap
from relmap.planes3d.table import Plane3dTable, is_mapped
from relmap.recorded import versions

NOWHERE = SubmapPath(np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, 4, 4)))


def result_in_space(mapper: Plane3dMapper, log: Log, tracks: Tracks) -> Plane3dResult:
    """Return the result of a mapper for the scans of a log."""
    first = log.first_iteration
    table = shifted(mapper.planes, first)
    parts, times_s = mapper.submaps, stamps_of(log)
    own = [np.array(part.iteration, dtype=np.int64) for part in parts]
    paths = [
        SubmapPath(first + scans, times_s[scans], part.trajectory)
        for scans, part in zip(own, parts, strict=True)
    ]
    main = paths[0] if paths else NOWHERE
    weak = mapper.weak_links
    path = [span for part in parts for span in consecutive(part)]
    summary = {
        "association": "nearest",
        "dimensions": 3,
        "scans": [first, first + len(log)],
        "versions": versions(),
        "counts": {
            "iterations": len(log),
            "observations": len(tracks.row),
            "planes": len(table.plane),
            **by_status(table.status, "planes_"),
            "iterations_without_pose": len(log) - len(main.poses),
        },
        "submaps": [submap_row(part, first) for part in parts],
        "steps": steps_of(path, np.array([*weak], dtype=np.int64)),
        "weak_links": [first + k for k in weak],
        "weak_directions": [free.tolist() for free in weak.values()],
    }
    return Plane3dResult(
        _landmarks(table),
        tracks,
        main.stamps_s,
        main.poses,
        summary,
        tuple(_submap(part) for part in parts),
        iterations=main.iterations,
        planes=table,
        parts=tuple(parts),
        paths=tuple(paths),
        weak=np.flatnonzero(np.isin(main.iterations - first, list(weak))),
    )


def _landmarks(table: Plane3dTable) -> LandmarkTable:
    mapped = table.status == "static"
    return LandmarkTable(
        landmark=table.plane,
        position=np.where(mapped[:, None], table.centre, np.nan),
        sd=np.where(mapped, table.sd, np.nan),
        observations=table.observations,
        first_iteration=table.first_iteration,
        last_iteration=table.last_iteration,
        level=np.zeros(len(table.plane), dtype=np.int64),
        status=table.status,
        submap=table.submap,
        moving_bin=np.full(len(table.plane), -1),
    )


def _submap(part: Submap) -> LandmarkSubmap:
    """Return the planes of a submap that would be mapped in the first one."""
    mapped = np.flatnonzero(is_mapped(part))
    mapped = mapped[np.argsort(part.number[mapped])]
    at = part.all_planes().centre[mapped]
    return LandmarkSubmap(part.number[mapped], at, part.iteration[0], part.iteration[-1])


def consecutive(part: Submap) -> list[tuple[Floats, Ints]]:
    """Return poses and iterations of a submap, apart where scans between may be in another one."""
    cuts = np.flatnonzero(np.diff(part.iteration) != 1) + 1
    iteration = np.split(np.array(part.iteration, dtype=np.int64), cuts)
    return list(zip(np.split(part.trajectory, cuts), iteration, strict=True))


def submap_row(part: Submap, first: int) -> dict[str, Any]:
    """Return the entry of a submap in `summary.json`; `first` is the first iteration of the run."""
    ways = (np.diff(path[:, :3, 3], axis=0) for path, _ in consecutive(part))
    return {
        "planes": len(part),
        "iterations": [first + part.iteration[0], first + part.iteration[-1]],
        "scans": len(part.iteration),
        "metres": sum(float(np.linalg.norm(way, axis=1).sum()) for way in ways),
        "systematic_share": part.share,
    }
