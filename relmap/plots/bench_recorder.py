"""Recording the test bench (Fig. 5 of the paper): a plane mapper, scan by scan."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.motions import transforms
from relmap.datasets.scans import PointScan, ScanLog
from relmap.evaluation.feeding import pose_on_robot, segment_scan
from relmap.evaluation.truth import Truth
from relmap.planes import PlaneMapper
from relmap.plots.path import fit_to_truth
from relmap.segmentation import PlaneSegmenter

FRAMES = 80
"""Approximate number of frames of an animation."""

COLUMNS = ("what", "number", "x0", "y0", "x1", "y1")


def rows_of(shapes: Mapping[str, Floats]) -> Iterator[tuple[object, ...]]:
    """Yield a row for each line (n, 2, 2) and known place (n, 2), as `COLUMNS` name them."""
    for what, each in shapes.items():
        rest = () if each.ndim == 3 else ("", "")
        flat = each.reshape(-1, 4 - len(rest))
        for number, place in enumerate(flat[np.isfinite(flat[:, 0])].tolist()):
            yield what, number, *place, *rest


@dataclass(frozen=True, eq=False)
class BenchFrame:
    """One scan and the map after it, in the robot frame and in the world frame.

    The world frame is that of the truth if known, otherwise that of the map.

    `points_robot` (n, 2), metres; `label` (n,): segmented plane of each point, -1 for none;
    `ends_robot` (m, 2, 2), metres: ends of the segmented planes, right to left; `static_end`
    (m, 2): whether an end is the end of the wall itself; `walls` (w, 2, 2), `corners` (c, 2),
    metres, world: as mapped; `links` (l, 2, 2), metres, world: from the centre of each group to its
    walls; `path` (k, 2), metres, world: NaN in iterations without a pose; `T_world_robot` (4, 4):
    NaN if the scan has no pose; `true_walls` (t, 2, 2), metres, world: empty if unknown.
    """

    iteration: int
    points_robot: Floats
    label: Ints
    ends_robot: Floats
    static_end: Bools
    walls: Floats
    corners: Floats
    links: Floats
    path: Floats
    T_world_robot: Floats
    true_walls: Floats

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield a row for everything drawn, with columns `COLUMNS`; points with their plane."""
        for label, point in zip(self.label.tolist(), self.points_robot.tolist(), strict=True):
            yield "point (robot)", label, *point, "", ""
        lines = {"plane (robot)": self.ends_robot, "wall": self.walls}
        lines |= {"true wall": self.true_walls, "link": self.links}
        yield from rows_of(lines | {"corner": self.corners, "pose": self.path})


class BenchRecorder:
    """Records frames of a plane mapper that maps a log.

    `segmenter`: the segmenter of the run. `every`: scans between frames; 0: none.

    Attributes: `n_before`: scans of earlier logs that the mapper has processed; their times are
    unknown.
    """

    def __init__(
        self, log: ScanLog, segmenter: PlaneSegmenter, truth: Truth | None, every: int
    ) -> None:
        self.segmenter = segmenter
        self.n_before = 0
        self.frames: list[BenchFrame] = []
        self._log, self._truth, self._every = log, truth, every

    def watch(self, mapper: PlaneMapper, scans: Iterable[PointScan]) -> Iterator[PointScan]:
        """Yield the scans of a run; record a frame at intervals, once the scan is mapped."""
        for scan in scans:
            yield scan
            self.see(mapper)

    def see(self, mapper: PlaneMapper) -> None:
        """Record a frame if one is due after the scan that was mapped last."""
        if self._every and mapper.n_iterations % self._every == 0:
            self.frames.append(self.frame(mapper))

    def frame(self, mapper: PlaneMapper) -> BenchFrame:
        """Return the scan that was mapped last, with the current map."""
        n = mapper.n_iterations - self.n_before
        last = self._log.first_iteration + n - 1
        (scan,) = self._log.between(last, last + 1).scans()
        stamps_s = np.append(np.full(self.n_before, np.nan), self._log.stamps_s[:n])
        poses, planes = mapper.trajectory, mapper.planes
        mapped = planes.status == "static"
        R, t = self._world(stamps_s, poses)
        walls = planes.ends[mapped] @ R.T + t
        view, segmenter = self._log.sensor, copy(self.segmenter)
        segment_scan(segmenter, scan.points_robot, view)
        seen, (R_sensor, t_sensor) = segmenter.planes_, pose_on_robot(view)
        return BenchFrame(
            scan.iteration,
            scan.points_robot[:, :2],
            segmenter.labels_,
            seen.ends @ R_sensor.T + t_sensor,
            seen.end_type == "corner",
            walls,
            walls[planes.corner[mapped] >= 0],
            _links(mapper.group_walls, planes.plane[mapped], walls.mean(axis=1)),
            poses[:, :2, 3] @ R.T + t,
            transforms(R, t) @ poses[-1],
            np.empty((0, 2, 2)) if self._truth is None else self._truth.ends,
        )

    def _world(self, stamps_s: Floats, poses: Floats) -> tuple[Floats, Floats]:
        """Return the motion R (2, 2), t (2,) from the map to the world frame."""
        placed = np.isfinite(poses[:, 0, 0] + stamps_s)
        found = self._truth and fit_to_truth(stamps_s[placed], poses[placed], self._truth)
        return found or (np.eye(2), np.zeros(2))


def _links(groups: list[Ints], walls: Ints, middles: Floats) -> Floats:
    """Return lines (l, 2, 2) from the centre of each group to the midpoints of its walls."""
    links = [np.empty((0, 2, 2))]
    for members in groups:
        at = middles[np.isin(walls, members)]
        if len(at) > 1:
            links.append(np.stack([np.broadcast_to(at.mean(axis=0), at.shape), at], axis=1))
    return np.concatenate(links)


def frame_step(n_scans: int, frames: int = FRAMES) -> int:
    """Return the number of scans between frames, for about `frames` in total."""
    return max(1, math.ceil(n_scans / frames))
