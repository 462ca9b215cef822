"""The content of ``summary.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.odometry import OdometryUse
from relmap.core.readout import contradicted_at
from relmap.core.refinement.joint import Refined
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import Fed, Log
from relmap.evaluation.trust import MANY, trust_of
from relmap.io.results import Result
from relmap.planes import PlaneMapper
from relmap.planes.submaps.submap import WallSubmap
from relmap.planes.walls.files import PlaneResult
from relmap.planes3d import Plane3dMapper
from relmap.points import PointMapper
from relmap.recorded import versions

SHOWN = 5
"""Number of weakest segments and merges listed."""
STATUS = ("static", "dynamic", "unmapped")
SEGMENT = {name: name for name in ("first_iteration", "residual", "middle")}
MERGE = {name: name for name in ("landmark", "apart_m", "residual")} | {"seen_again_as": "track"}


def summary_of(
    mapper: PointMapper | PlaneMapper, result: Result, log: Log, offset: int, n_groups: int
) -> dict[str, Any]:
    """Return the summary of a map.

    `result`: its result for the log; `offset`: log number of the mapper's first iteration. The
    summary is JSON serialisable: counts, submaps and the residuals of scans and segments.
    """
    counts = _counts_of_walls(result) if isinstance(result, PlaneResult) else _counts(result, log)
    counts["groups"] = n_groups
    counts["iterations_without_pose"] = len(log) - len(result.poses)
    summary: dict[str, Any] = {"versions": versions(), "counts": {"iterations": len(log)} | counts}
    begun = mapper.begun if isinstance(mapper, PlaneMapper) else ()
    summary["submaps"] = [
        _submap_row(result, number, offset, begun) for number in range(len(result.submaps))
    ]
    summary["refinement"] = weakness(mapper.refined, offset)
    summary["association_trust"] = trust_of(mapper, result, counts["observations"], offset)
    summary["odometry"] = _odometry(mapper.odometry, result, offset)
    if isinstance(mapper, PlaneMapper):
        weak = (mapper.weak_links + offset).tolist()
        view_rad = log.sensor.view_rad if isinstance(log, ScanLog) else None
        paths = [
            (own.poses, own.first_iteration + np.arange(len(own.poses))) for own in mapper.submaps
        ]
        steps = steps_of(paths, np.append(mapper.weak_links, mapper.begun), view_rad)
        free = mapper.weak_directions.tolist()
        return summary | {"weak_links": weak, "weak_directions": free, "steps": steps}
    for row, at in zip(summary["submaps"], contradicted_at(mapper.engine), strict=True):
        row["contradicted_at"] = None if at is None else offset + at
    if summary["refinement"] is not None:
        engine = mapper.engine
        # With odometry, one landmark in a scan may be enough for a map, but not for a segment.
        points = engine.rows.points if len(engine.rows.points) else engine.kept.location
        summary["refinement"]["median_range_m"] = _median(np.linalg.norm(points, axis=1))
    summary["rejected_iterations"] = ends_of(mapper.rejected + offset, "iterations")
    summary["rejected_observations"] = ends_of(_rejected_rows(mapper, log, offset), "rows")
    return summary


def _odometry(use: OdometryUse | None, result: Result, offset: int) -> dict[str, Any] | None:
    """Return how odometry was used, and its estimated quality; None if there was none."""
    if use is None:
        return None
    sd = np.empty(0) if isinstance(result, PlaneResult) else result.landmarks.sd
    largest_m = np.nanmax(sd[np.isfinite(sd)], initial=-1.0)
    hanging = use.hanging + offset
    runs = np.split(hanging, np.flatnonzero(np.diff(hanging) > 1) + 1)
    stretches = [[int(run[0]), int(run[-1])] for run in runs if len(run)]
    # Where ids close loops, the residuals show the noise.
    has_ids = result.summary["association"] == "known"
    return {
        "used": bool(use.is_used),
        "wrong_throughout": use.is_wrong,
        "scale": float(use.noise.scale),
        "sigma_share_of_way": float(use.noise.sigma_way),
        "sigma_rad": float(use.noise.sigma_rad),
        "noise_assumed": bool(use.is_used) and use.noise.is_assumed and not has_ids,
        "drift_over_noise": float(use.drift),
        "alike_elsewhere": use.alike,
        "of_two_places": ends_of(use.of_two_places, "ids"),
        "largest_sd_m": float(largest_m) if use.is_used and largest_m >= 0 else None,
        "tied_by_it_alone": ends_of(hanging, "iterations") | {"stretches": stretches},
        "left_out": ends_of(use.left_out + offset, "iterations"),
    }


def _rejected_rows(mapper: PointMapper, log: ObservationLog | ScanLog, offset: int) -> Ints:
    """Return the rows (r,) of the log whose ids were overruled."""
    assert isinstance(log, ObservationLog)
    iteration, row = mapper.rejected_observations.T
    iteration = iteration + offset
    first = np.searchsorted(log.iteration, iteration)
    inside = (iteration >= log.first_iteration) & (iteration < log.end_iteration)
    return np.asarray(log.rows[(first + row)[inside]])


def _counts(result: Result, log: ObservationLog | ScanLog) -> dict[str, int]:
    assert isinstance(log, ObservationLog)
    table = result.landmarks
    return {
        "observations": len(log.points_robot),
        "observations_without_id": 0 if log.ids is None else int(np.sum(log.ids < 0)),
        "iterations_without_observation": len(log) - len(np.unique(log.iteration)),
        "landmarks": len(table.landmark),
        "mapped": int(result.mapped.sum()),
        "moving_bins": len(np.unique(table.moving_bin[table.moving_bin >= 0])),
        **by_status(table.status),
    }


def _counts_of_walls(result: PlaneResult) -> dict[str, int]:
    planes, corners = result.planes, result.landmarks
    return {
        "observations": len(result.tracks.row),
        "planes": len(planes.plane),
        "corners": len(corners.landmark),
        **by_status(planes.status, "planes_"),
        **by_status(corners.status, "corners_"),
    }


def by_status(status: NDArray[np.str_], prefix: str = "") -> dict[str, int]:
    """Return the number of landmarks (n,) of each status, by its name with a prefix."""
    return {f"{prefix}{name}": int((status == name).sum()) for name in STATUS}


def _submap_row(
    result: Result, number: int, offset: int, begun: Ints | tuple[()]
) -> dict[str, Any]:
    submap = result.submaps[number]
    row: dict[str, Any] = {
        "landmarks": len(submap.landmark_ids),
        "iterations": [offset + submap.first_iteration, offset + submap.last_iteration],
    }
    if isinstance(submap, WallSubmap):
        scans, metres = submap.n_scans, submap.length_m(begun)
        return row | {"scans": scans, "metres": metres, "refined": submap.refined}
    path = result.paths[number]
    return row | {"scans": len(path.poses), "metres": path.length_m}


def steps_of(
    paths: Sequence[tuple[Floats, Ints]], weak: Ints, view_rad: float | None = None
) -> dict[str, float | None]:
    """Return the median step between scans, and the width of the sensor's view.

    None if unknown; metres and degrees. Steps that the scans do not determine do not count.

    `paths`, sequence of (k, d + 1, d + 1) and (k,): poses of consecutive scans, NaN if unknown, and
    their iterations; `weak`: iterations with an undetermined step from the one before.
    """
    view_deg = None if view_rad is None else float(np.rad2deg(view_rad))
    steps = [
        (np.linalg.inv(poses[:-1]) @ poses[1:])[~np.isin(iteration[1:], weak)]
        for poses, iteration in paths
    ]
    T = np.concatenate(steps) if steps else np.empty((0, 3, 3))
    T = T[np.isfinite(T[:, 0, -1])]
    half_sine = np.linalg.norm(T[:, :-1, :-1] - np.eye(T.shape[1] - 1), axis=(1, 2)) / np.sqrt(8)
    turn_rad = 2 * np.arcsin(np.minimum(half_sine, 1.0))
    way_m = np.linalg.norm(T[:, :-1, -1], axis=1)
    median_deg = _median(np.rad2deg(turn_rad))
    return {"median_m": _median(way_m), "median_deg": median_deg, "view_deg": view_deg}


def is_refined(mapper: PointMapper | PlaneMapper | Plane3dMapper) -> bool:
    """Return whether the map, of walls the largest submap, is refined."""
    if isinstance(mapper, Plane3dMapper):
        return mapper.is_refined
    if isinstance(mapper, PlaneMapper):
        return any(submap.refined for submap in mapper.submaps[:1])
    return len(mapper.refined) > 0


def ends_of(numbers: Ints, of: str) -> dict[str, Any]:
    """Return the count of numbers (n,), and under the key `of` the first and last ones."""
    listed = numbers.tolist()
    if len(listed) > MANY:
        listed = listed[: MANY // 2] + listed[-MANY // 2 :]
    return {"count": len(numbers), of: listed}


def weakness(refined: Sequence[Refined], first_iteration: int) -> dict[str, Any] | None:
    """Return the segments and merges with the largest residuals, JSON serialisable.

    Residuals are relative to their expectation from the noise: ideally about 1.

    `refined`: refined submaps; only the first is described. `first_iteration`: log number of the
    mapper's first iteration. Returns None if nothing was refined.
    """
    if not refined:
        return None
    submap, merges = refined[0], refined[0].merges
    segments = submap.segments
    segments = replace(segments, first_iteration=first_iteration + segments.first_iteration)
    return {
        "converged": all(each.converged for each in refined),
        "noise_m": submap.noise_m,
        "power": submap.power,
        "anchor_iteration": first_iteration + submap.anchor_iteration,
        "segments": len(segments.residual),
        "segment_residual_median": _median(segments.residual),
        "weakest_segments": _weakest(segments, SEGMENT),
        "merges": len(merges.residual),
        "weakest_merges": _weakest(merges, MERGE),
    }


def _weakest(table: Any, columns: dict[str, str]) -> list[dict[str, Any]]:
    """Return the rows of the largest residuals: names in the summary, names in the table."""
    rows = np.argsort(-table.residual, kind="stable")[:SHOWN]
    return [
        {shown: getattr(table, name)[row].tolist() for shown, name in columns.items()}
        for row in rows
    ]


def completion(log: Log, done: Log, fed: Fed, refined: bool) -> dict[str, Any]:
    """Return how much of a log was mapped, whether the map was refined, and the times."""
    return {
        "interrupted": len(done) < len(log),
        "input_iterations": len(log),
        "refined": refined,
        "timing": _timing(fed, isinstance(log, ScanLog)),
    }


def _timing(fed: Fed, segmented: bool) -> dict[str, float | None]:
    """Return the times of a run, `segmented` if walls or planes were found in its scans first."""
    (prepare_s, mapping_s), total_s = fed.durations_s.T, fed.durations_s.sum(axis=1)
    times = timing_of(mapping_s) | {"refine_ms": 1e3 * fed.refine_s, "reading_s": fed.reading_s}
    times |= {"mapping_s": float(mapping_s.sum()), "finish_s": fed.finish_s}
    if segmented:
        times |= {
            "segmentation_median_ms": _median_ms(prepare_s),
            "segmentation_share": float(prepare_s.sum() / total_s.sum()) if len(total_s) else None,
            "scan_median_ms": _median_ms(total_s),
            "segmentation_s": float(prepare_s.sum()),
        }
    return times


def timing_of(durations_s: Floats) -> dict[str, float | None]:
    """Return statistics of the time per iteration in milliseconds, from seconds (k,)."""
    return {
        "median_ms": _median_ms(durations_s),
        "p95_ms": 1e3 * float(np.percentile(durations_s, 95)) if len(durations_s) else None,
        "first_100_median_ms": _median_ms(durations_s[:100]),
        "last_100_median_ms": _median_ms(durations_s[-100:]),
    }


def _median_ms(seconds: Floats) -> float | None:
    return _median(1e3 * seconds)


def _median(values: Floats) -> float | None:
    return float(np.median(values)) if len(values) else None
