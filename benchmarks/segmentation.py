"""Segmentation of scans into planes.

    python benchmarks/segmentation.py

Simulated scenes of a building, seeds 0 to 29, the sensor's limits known. A wall counts if at
least 1 % of the scan's points lie on it; it is found if it and one plane share 80 % of the points
of each. "Known walls" labels points by the true walls and the true noise, each by the
likeliest: no method can be expected to do better. Times are processor times.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, field
from time import process_time
from typing import Any

import numpy as np
from shared.tables import header, row

from relmap import PlaneSegmenter, RelmapError
from relmap.core.arrays import Bools, Ints
from relmap.segmentation import Planes
from relmap.segmentation.em.mixture import WallMixture, scan_area
from relmap.simulation import BuildingScan, building_scene
from relmap.simulation.sensor import DEPTH_SENSOR, LASER

SIGMAS = (0.0, 0.05, 0.1, 0.2, 0.3)
SIZES = {500: 30, 2000: 30, 50000: 10}
"""Points of a scan, and how many scenes of that size."""
METHODS = ("em", "mixture", "ransac", "ransac3d", "patches")
OVERLAP = 0.8
COUNTED = 0.01


@dataclass
class Tally:
    """Results of a number of scenes."""

    correct: list[bool] = field(default_factory=list)
    over: list[bool] = field(default_factory=list)
    normal_deg: list[float] = field(default_factory=list)
    corner_m: list[float] = field(default_factory=list)
    outward_m: list[float] = field(default_factory=list)
    types: list[tuple[str, str]] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)

    def add(self, scan: BuildingScan, labels: Ints, planes: Planes | None) -> None:
        """Evaluate one scan; without planes only its labels."""
        for wall in np.flatnonzero(np.bincount(scan.stretch) >= COUNTED * len(scan.points)):
            plane, split = matched(scan.stretch == wall, labels)
            self.correct.append(plane >= 0)
            self.over.append(split)
            if plane >= 0 and planes is not None:
                self._measure(scan, int(wall), planes, plane)

    def _measure(self, scan: BuildingScan, wall: int, planes: Planes, plane: int) -> None:
        ends, kinds = scan.seen.ends[wall], scan.seen.end_type[wall]
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        nx, ny = planes.normal[plane]
        turn = np.arctan2(-along[1] * ny - along[0] * nx, -along[1] * nx + along[0] * ny)
        self.normal_deg.append(float(np.rad2deg(abs(turn))))
        for side in (0, 1):
            off = planes.ends[plane, side] - ends[side]
            self.types.append((str(kinds[side]), str(planes.end_type[plane, side])))
            if kinds[side] == "corner":
                self.corner_m.append(float(np.linalg.norm(off)))
                self.outward_m.append(float(off @ along) * (2 * side - 1))

    def precision_recall(self) -> tuple[float, float]:
        """Return both of the type `corner`, over the walls found."""
        right = sum(true == found == "corner" for true, found in self.types)
        claimed = sum(found == "corner" for _, found in self.types)
        there = sum(true == "corner" for true, _ in self.types)
        return right / max(claimed, 1), right / max(there, 1)


def matched(own: Bools, labels: Ints) -> tuple[int, bool]:
    """Return the plane that is a wall's, -1 for none, and whether several share the wall."""
    n = int(labels.max(initial=-1)) + 1
    inside = np.bincount(labels[own & (labels >= 0)], minlength=n)
    whole = np.bincount(labels[labels >= 0], minlength=n)
    for plane in np.flatnonzero((inside >= OVERLAP * whole) & (inside >= OVERLAP * own.sum())):
        return int(plane), False
    pieces = (inside > 0) & (inside >= OVERLAP * whole)
    return -1, bool(pieces.sum() > 1 and inside[pieces].sum() >= OVERLAP * own.sum())


def known_walls(scan: BuildingScan, sigma: float) -> Ints:
    """Return the likeliest true wall of each point."""
    along = scan.seen.ends[:, 1] - scan.seen.ends[:, 0]
    size = np.linalg.norm(along, axis=1)[:, None]
    share = np.bincount(scan.stretch, minlength=len(size))[:, None] / len(scan.stretch)
    walls = np.hstack([scan.seen.ends[:, 0], along / size, 0 * size, size, share])[share[:, 0] > 0]
    xy = np.ascontiguousarray(scan.points[:, :2])
    return WallMixture(walls, max(sigma, 1e-9), 1e-6, scan_area(xy, sigma)).labels(xy)


def judge(
    method: str, sigma: float, points: int, scenes: Iterable[int], **options: Any
) -> Tally | None:
    """Segment scenes of a building; None if the method is not installed."""
    tally = Tally()
    laser = options.get("sampling") == "laser"
    sensor = LASER if laser else DEPTH_SENSOR
    segmenter = PlaneSegmenter(
        method if method != "known walls" else None,
        view_rad=float(sensor.view_rad),
        range_m=sensor.range_m,
    )
    for seed in scenes:
        scan = building_scene(seed, points, sigma, **options)
        if method == "known walls":
            tally.add(scan, known_walls(scan, sigma), None)
            continue
        begin = process_time()
        try:
            segmenter.fit(scan.points[:, :2] if laser else scan.points)
        except RelmapError:
            return None
        tally.ms.append(1e3 * (process_time() - begin))
        tally.add(scan, segmenter.labels_, segmenter.planes_)
    return tally


def middle(values: list[float], form: str = ".3f") -> str:
    """Return the median as text."""
    return format(float(np.median(values)), form) if values else "-"


def warm_up() -> None:
    """Compile everything before times are measured."""
    for method in METHODS:
        judge(method, 0.2, 500, [1000])
    judge("scanlines", 0.01, 361, [1000], sampling="laser")


def print_comparison() -> None:
    """Print the table of all methods over noise and scan size."""
    sigmas = (f"σ {sigma:g}" for sigma in SIGMAS)
    header("points", "method", *sigmas, "normal [°]", "corner [m]", "ms")
    for points, scenes in SIZES.items():
        for method in ("known walls", *METHODS):
            tallies = [judge(method, sigma, points, range(scenes)) for sigma in SIGMAS]
            done = [tally for tally in tallies if tally is not None]
            if len(done) < len(tallies):
                row(points, method, "does not run here", *[""] * (len(SIGMAS) + 2))
                continue
            found = [f"{np.mean(one.correct):.3f} / {np.mean(one.over):.2f}" for one in done]
            at = done[SIGMAS.index(0.1)]
            ms = middle([ms for one in done for ms in one.ms], ".0f")
            row(points, method, *found, middle(at.normal_deg, ".2f"), middle(at.corner_m), ms)


def print_default() -> None:
    """Print all figures of the default method at 2000 points."""
    accuracy = ("normal [°]", "corner [m]", "bias [m]", "precision", "recall")
    header("scenes", "found", "over", *accuracy, "ms")
    rows: list[tuple[str, float, dict[str, Any]]] = [
        *((f"σ {sigma:g}", sigma, {}) for sigma in SIGMAS),
        ("σ 0, ends sampled", 0.0, {"sample_ends": True}),
        ("σ 0.1, uniform noise", 0.1, {"noise": "uniform"}),
        ("σ 0.05, ray cast", 0.05, {"sampling": "rays"}),
        ("σ 0.1, ray cast", 0.1, {"sampling": "rays"}),
        ("σ 0.01, 361-beam laser", 0.01, {"sampling": "laser"}),
    ]
    for name, sigma, options in rows:
        laser = options.get("sampling") == "laser"
        method, points = ("scanlines", 361) if laser else ("em", 2000)
        tally = judge(method, sigma, points, range(30), **options)
        assert tally is not None
        precision, recall = tally.precision_recall()
        form = ".1e" if sigma == 0 else ".4f"
        row(
            *(name, f"{np.mean(tally.correct):.3f} of {len(tally.correct)}"),
            *(f"{np.mean(tally.over):.3f}", middle(tally.normal_deg, form)),
            *(middle(tally.corner_m, form), f"{np.mean(tally.outward_m):.4f}"),
            *(f"{precision:.3f}", f"{recall:.3f}", middle(tally.ms, ".1f")),
        )
        if options.get("sample_ends"):
            print(f"largest error there: corner {max(tally.corner_m):.1e} m")


def main() -> None:
    parser = argparse.ArgumentParser(description="Accuracy and time of plane segmentation.")
    parser.add_argument("--only", choices=("comparison", "default"), help="one table only")
    only = parser.parse_args().only
    warm_up()
    if only in (None, "comparison"):
        print_comparison()
        print()
    if only in (None, "default"):
        print_default()


if __name__ == "__main__":
    main()
