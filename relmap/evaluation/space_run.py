"""One run of a log of clouds through the mapper of planes in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.landmarks import LandmarkTable
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import Progress, Through, feed
from relmap.evaluation.summary import completion, steps_of, versions
from relmap.io.results import Tracks, shifted
from relmap.planes3d import Plane3dMapper
from relmap.planes3d.files import Plane3dResult
from relmap.planes3d.submap import Submap
from relmap.planes3d.table import Plane3dTable

VARIANT = "planes3d"
LEAST_SCANS = 10
"""Minimum scans of a submap with a separate file."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SpaceResult(Plane3dResult):
    """A result of planes in space, with its parts.

    `paths`, list of (stamps (k,), poses (k, 4, 4)): of each submap; `weak` (w,): indices in `poses`
    of the scans with constant motion assumed in a direction.
    """

    parts: list[Submap]
    paths: list[tuple[Floats, Floats]]
    weak: np.ndarray


def run_in_space(
    mapper: Plane3dMapper,
    log: ScanLog,
    about: dict[str, Any],
    refine: bool,
    through: Through,
    progress: Progress,
) -> SpaceResult:
    """Map a whole log of clouds.

    `mapper`: a new mapper. `about`: additional entries of the summary. `through`: wraps the
    iterable of scans; if it ends early, so does the run. `progress`: called after each scan with
    the number of scans done and the total. Raises `RelmapError` if the log is from a 2-D laser, or
    a scan of it is damaged.
    """
    if log.dimension != 3:
        raise RelmapError(
            "the log is from a 2-D laser, and planes3d maps clouds: use --variant planes"
        )
    fed = feed(mapper, log, "nearest", refine, through, progress=progress)
    done = log.between(log.first_iteration, log.first_iteration + len(fed.labels))
    entries = about | {"configuration": mapper.settings} | completion(log, done, fed, refine)
    return _result(mapper, done, fed.labels, entries)


def _result(
    mapper: Plane3dMapper, log: ScanLog, labels: list[np.ndarray], entries: dict[str, Any]
) -> SpaceResult:
    first = log.first_iteration
    table = shifted(mapper.planes, first)
    parts = mapper.submaps
    paths = [(log.stamps_s[part.iteration], part.trajectory) for part in parts]
    counts = np.array([len(each) for each in labels], dtype=np.int64)
    rows = np.concatenate([*map(np.arange, counts), np.empty(0, np.int64)])
    named = mapper.landmarks_of(np.concatenate([*labels, np.empty(0, np.int64)]))
    tracks = Tracks(first + np.repeat(np.arange(len(counts)), counts), rows, named)
    stamps_s, poses = paths[0] if paths else (np.empty(0), np.empty((0, 4, 4)))
    weak = mapper.weak_links
    own = parts[0].iteration if parts else []
    summary = entries | {
        "dimensions": 3,
        "scans": [first, first + len(log)],
        "versions": versions(),
        "counts": {
            "iterations": len(log),
            "observations": len(named),
            "planes": len(table.plane),
            "planes_static": int((table.status == "static").sum()),
            "iterations_without_pose": len(log) - len(poses),
        },
        "submaps": [submap_row(part, first) for part in parts],
        "steps": steps_of([path for part in parts for path in consecutive(part)]),
        "weak_links": [first + k for k in weak],
        "weak_directions": [free.tolist() for free in weak.values()],
    }
    return SpaceResult(
        _landmarks(table),
        tracks,
        stamps_s,
        poses,
        summary,
        planes=table,
        parts=parts,
        paths=paths,
        weak=np.flatnonzero(np.isin(own, list(weak))),
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


def consecutive(part: Submap) -> list[Floats]:
    """Return the poses of a submap, apart where scans in between may be in another submap."""
    return np.split(part.trajectory, np.flatnonzero(np.diff(part.iteration) != 1) + 1)


def submap_row(part: Submap, first: int) -> dict[str, Any]:
    """Return the entry of a submap in `summary.json`; `first` is the first iteration of the run."""
    ways = (np.diff(path[:, :3, 3], axis=0) for path in consecutive(part))
    return {
        "planes": len(part),
        "iterations": [first + part.iteration[0], first + part.iteration[-1]],
        "scans": len(part.iteration),
        "metres": sum(float(np.linalg.norm(way, axis=1).sum()) for way in ways),
        "systematic_share": part.share,
    }
