"""Lines of sight from the sensor to the observed points, in the map frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, Ints, positions_of
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog
from relmap.datasets.textfile import shown
from relmap.evaluation.feeding import Log, stamps_of
from relmap.evaluation.metrics import match_stamps
from relmap.evaluation.sources import read_again
from relmap.evaluation.truth import Variant
from relmap.exports.content import MapContent
from relmap.io.results import MAPPER, SUMMARY, TRACKS, TRAJECTORY
from relmap.planes import PlaneMapper
from relmap.planes.places.map_part import MapPart
from relmap.planes.scans.beam_store import PlacedBeams
from relmap.points import PointMapper

MOST = 5_000_000
"""Maximum number of beams, by subsampling."""
JUDGED = 60_000
"""Approximate number of beams by which a log is compared with the map."""
LEAST_M = 3.0
"""Length of wall passed through, up to which it may be a door or glass."""
MISFIT = 0.5
"""Deviation of a log from the map above which it is another one: of points, as a fraction of their
distance; of beams, the length of wall that they pass through, as a fraction of that on which they
end: with the log that was mapped at most 0.08, also without refinement, mirrored 1 or more."""
Lines = tuple[Floats, Floats]
"""Start and end points of lines, (n, 2) each, map frame, metres."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Observations: which pose saw which mapped landmark.

    `pose`, `landmark` (n,): rows of the poses and of the landmarks of a `MapContent`.
    `points_robot` (n, d), robot frame, metres: measured positions; None without the log.
    """

    pose: Ints
    landmark: Ints
    points_robot: Floats | None


def sight_lines(content: MapContent, log: Path | None) -> Lines | None:
    """Return start and end points of beams; for points, lines from poses to landmarks.

    `log`: the log that was mapped; None to use ``mapper.npz``. Returns `begins`, `ends` (n, 2), map
    frame, metres: None if there is neither. Raises `RelmapError` if ``mapper.npz`` or the log is
    invalid.
    """
    if content.walls is None:
        seen = sightings(content, log)
        if seen is None:
            return None
        begins = content.result.poses[seen.pose, :2, 3]
        return begins, content.landmarks.position[seen.landmark, :2]
    if log is not None:
        read = _read(content, log)
        lines = _placed(content, read)
        if isinstance(read, ScanLog) and read.dimension == 2:  # clouds are not levelled here
            _check_beams(content, lines)
        return lines
    saved = content.folder / MAPPER
    if not saved.is_file():
        return None
    mapper = PlaneMapper.load(saved)
    return mapper.beams_of(0, MOST)[:2] if mapper.submaps else None


def sightings(content: MapContent, log: Path | None) -> Sightings | None:
    """Return which pose of a map of points saw which landmark, if known; see `sight_lines`."""
    read = None if log is None else _read(content, log)
    iterations = _iterations(content, read)
    if iterations is None:
        return None
    tracks = content.result.tracks
    pose = positions_of(iterations, tracks.iteration)
    landmark = positions_of(content.landmarks.landmark, tracks.landmark)
    known = (pose >= 0) & (landmark >= 0)
    if log is not None and len(content.landmarks.landmark) and not known.any():
        raise RelmapError(
            f"{content.folder / TRACKS} names no observation of {log}: give the log that was "
            "mapped; of a merged map, whose tracks are empty, export without --log"
        )
    if not isinstance(read, ObservationLog):
        return Sightings(pose[known], landmark[known], None)
    points = read.points_robot[_rows(content, read)[known]]
    seen = Sightings(pose[known], landmark[known], points)
    _check_points(content, seen, points)
    return seen


def _check_points(content: MapContent, seen: Sightings, points: Floats) -> None:
    """Raise an error if measured points (n, d) are not where the map has them."""
    if not len(points):
        return
    off_m = np.median(np.linalg.norm(points - as_mapped(content, seen), axis=1))
    away_m = np.median(np.linalg.norm(points, axis=1))
    if off_m > MISFIT * away_m:
        raise _another(content, f"its points, {away_m:.2g} m away, are {off_m:.2g} m off the map")


def as_mapped(content: MapContent, seen: Sightings) -> Floats:
    """Return the observed points (n, d), robot frame, metres, computed from the map."""
    at, T = content.landmarks.position[seen.landmark], content.result.poses[seen.pose]
    points = np.einsum("nji,nj->ni", T[:, :3, :3], at - T[:, :3, 3])
    return np.asarray(points[:, : 2 if content.result.planar else 3])


def _another(content: MapContent, why: str) -> RelmapError:
    """Return the error that a log is not the one that was mapped, which the summary names."""
    mapped = content.result.summary.get("input")
    expected = f"; give {shown(mapped)}" if isinstance(mapped, str) else ""
    return RelmapError(f"the log is not the one that was mapped: {why}{expected}")


def _read(content: MapContent, log: Path) -> Log:
    variant: Variant = "points" if content.walls is None else "planes"
    read = read_again(log, variant, content.result.summary)
    if isinstance(read, ObservationLog):
        planar = read.points_robot.shape[1] == 2
        if planar != content.result.planar:
            kinds = ("in space", "planar") if planar else ("planar", "in space")
            raise _another(content, f"the map is {kinds[0]}, the log {kinds[1]}")
    return read


def _rows(content: MapContent, log: ObservationLog) -> Ints:
    """Return the index in the log of each tracked observation (n,)."""
    tracks = content.result.tracks
    row = positions_of(log.rows, tracks.row)
    there = log.iteration[row] if len(log.rows) else row
    strange = np.flatnonzero((row < 0) | (there != tracks.iteration))
    if len(strange):
        first, iteration = tracks.row[strange[0]], tracks.iteration[strange[0]]
        raise _another(
            content, f"its row {first} is not of iteration {iteration}, as {TRACKS} has it"
        )
    return row.astype(np.int64)


def _iterations(content: MapContent, log: Log | None) -> Ints | None:
    """Return the iteration of each pose (p,) of a map of points; None if unknown."""
    result, folder = content.result, content.folder
    if log is not None:
        return np.add(log.first_iteration, _scans(content, log))
    if not (folder / MAPPER).is_file():
        return None
    mapper = PointMapper.load(folder / MAPPER)
    there = np.flatnonzero(np.isfinite(mapper.trajectory[:, 0, 0]))
    scans = result.summary.get("scans")
    if not (isinstance(scans, list) and len(scans) == 2 and isinstance(scans[1], int)):
        raise RelmapError(f"{folder / SUMMARY}: scans is {scans!r:.40}, expected [first, end]")
    first = scans[1] - mapper.n_iterations
    numbers = first + there[len(there) - len(result.poses) :]
    if len(numbers) < len(result.poses):
        raise RelmapError(f"{folder / MAPPER} is not of the same run as {TRAJECTORY} beside it")
    return numbers


def _scans(content: MapContent, log: Log) -> Ints:
    """Return the scan of a log for each pose (p,)."""
    stamps_s = content.result.stamps_s
    mine, scan = match_stamps(stamps_s, stamps_of(log))
    if len(mine) < len(stamps_s):
        missing = stamps_s[np.setdiff1d(np.arange(len(stamps_s)), mine)[0]]
        raise _another(
            content,
            f"{len(stamps_s) - len(mine)} poses of the result have no scan of their time in it, "
            f"the first at {missing:.16g} s",
        )
    return scan.astype(np.int64)


def _placed(content: MapContent, log: Log) -> Lines:
    """Return the beams of a log of scans, transformed by the poses of the result."""
    assert isinstance(log, ScanLog)
    begins, ends = [np.empty((0, 2))], [np.empty((0, 2))]
    sensor = np.array([log.sensor.x_m, log.sensor.y_m])
    for scan, T in zip(_scans(content, log).tolist(), content.result.poses, strict=True):
        R, t, points = T[:2, :2], T[:2, 3], log.points_of(scan)[:, :2]
        ends.append(points @ R.T + t)
        begins.append(np.broadcast_to(R @ sensor + t, points.shape))
    every = max(-(-sum(map(len, ends)) // MOST), 1)
    return np.concatenate(begins)[::every], np.concatenate(ends)[::every]


def _check_beams(content: MapContent, lines: Lines) -> None:
    """Raise an error if beams pass through the mapped walls rather than end on them."""
    walls = content.walls
    if walls is None or not len(walls.plane):
        return
    some = slice(None, None, 1 + len(lines[0]) // JUDGED)
    begins, ends = (np.ascontiguousarray(each[some]) for each in lines)
    beams = PlacedBeams(begins, ends, np.zeros(len(begins), dtype=np.int64))
    part = MapPart.of(0, walls.ends, walls.plane, beams, np.empty((0, 3)))
    on_m, through_m = part.judged(begins, ends)
    if through_m > max(MISFIT * on_m, LEAST_M):
        raise _another(
            content,
            f"its beams pass through {through_m:.3g} m of the walls, and end on {on_m:.3g} m",
        )
