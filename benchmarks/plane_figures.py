"""The paper's figures 4 to 7, drawn from runs of this software, and planes against points.

    python benchmarks/plane_figures.py [NUMBER ...] -o DIR [--quick]

Writes figureNN.png and the data behind it, figureNN.csv, of each figure named, figure05.gif too; of
all where none is. `0` names the crossing: crossing.png and crossing.csv, planes and points mapped
from the same points over the noise; in full it takes half an hour. --quick maps less.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from relmap import PlaneMapper
from relmap.datasets.scans import stored_scans
from relmap.figures.bench import BenchFrame, BenchRecorder, frame_step
from relmap.figures.corner_test import CornerTest, clearest, corner_tests
from relmap.figures.crossing import Cell, Crossing, run_crossing
from relmap.figures.noisy_map import NoisyMaps, run_noisy_maps
from relmap.figures.partial_wall import PartialWall, run_partial_wall
from relmap.evaluation.plane_evaluate import WallTruth
from relmap.evaluation.plane_run import run_plane_mapper
from relmap.files import atomic_write
from relmap.plots.bench import plot_bench, write_bench_gif
from relmap.plots.corner_test import plot_corner_test
from relmap.plots.crossing import plot_crossing, plot_noisy_maps, said
from relmap.plots.partial_wall import plot_partial_wall
from relmap.plots.sheet import write_png
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import simulate_building
from relmap.simulation.sensor import DEPTH_SENSOR
from relmap.tables import csv_text

SPACINGS_M = (0.2, 0.3, 0.4)
NOISES = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
SEEDS = range(5)
QUICK = ((0.3,), (0.05, 0.15, 0.3), range(1))
Data = CornerTest | BenchFrame | PartialWall | NoisyMaps | Crossing


def save(folder: Path, name: str, draw: Callable[[], object], data: Data) -> None:
    """Write the picture of a figure, and its data as a table."""
    write_png(folder / f"{name}.png", draw)
    atomic_write(folder / f"{name}.csv", csv_text(data.COLUMNS, data.rows()))


def corners(folder: Path, quick: bool) -> None:
    view_rad, range_m = DEPTH_SENSOR.view_rad, DEPTH_SENSOR.range_m
    iterations = 60 if quick else None
    building = simulate_building(sigma=0.02, iterations=iterations)
    mapper = PlaneMapper(segmenter=PlaneSegmenter(view_rad=view_rad, range_m=range_m))
    for scan in building.scans:
        mapper.update(scan.points)
    tests = corner_tests(mapper.history)
    test = clearest(tests)
    save(folder, "figure04", lambda: plot_corner_test(test, view_rad, range_m), test)
    right = np.mean([test.chosen == test.static for test in tests])
    print(
        f"figure 4: of {len(tests)} pairs of walls with one cut end each, the lowest deviation is "
        f"that of the static ends in {right:.0%}"
    )


def bench(folder: Path, quick: bool) -> None:
    building = simulate_building(iterations=40 if quick else None)
    scans = [scan.points for scan in building.scans]
    offsets = np.concatenate([[0], np.cumsum([len(scan) for scan in scans])]).astype(np.int64)
    log = stored_scans(np.concatenate(scans), offsets, building.stamps_s)
    ends = building.walls[:, :4].reshape(-1, 2, 2)
    seen = building.times_seen()[:, 1:]
    truth = WallTruth(ends, seen, building.stamps_s, building.trajectory)
    mapper, segmenter = PlaneMapper(), PlaneSegmenter()
    recorder = BenchRecorder(mapper, segmenter, truth, frame_step(len(log), 10 if quick else 80))
    run_plane_mapper(mapper, log, segmenter, progress=recorder.watch)
    last = recorder.last()
    assert last is not None
    save(folder, "figure05", lambda: plot_bench(last), last)
    write_bench_gif(folder / "figure05.gif", [*recorder.frames, last])
    print(f"figure 5: {len(last.walls)} walls mapped after {len(log)} scans")


def partial_wall(folder: Path, quick: bool) -> None:
    run = run_partial_wall()
    save(folder, "figure06", lambda: plot_partial_wall(run), run)
    ahead_m, left_m = np.abs(run.shift)
    print(
        f"figure 6: {run.weak_m:.1f} m along a partial wall: {ahead_m:.4f} m off along it, "
        f"{left_m:.4f} m across; path before and after it {run.errors_m[0]:.0e} and "
        f"{run.errors_m[1]:.0e} m off"
    )


def noisy(folder: Path, quick: bool) -> None:
    maps = run_noisy_maps(iterations=80 if quick else None)
    save(folder, "figure07", lambda: plot_noisy_maps(maps), maps)
    print(f"figure 7: planes: {maps.said_of_planes}; points: {maps.said_of_points}")


def crossing(folder: Path, quick: bool) -> None:
    spacings_m, noises, seeds = QUICK if quick else (SPACINGS_M, NOISES, SEEDS)
    data = run_crossing(spacings_m, noises, seeds, progress=counted)
    save(folder, "crossing", lambda: plot_crossing(data), data)
    print(table(data))
    print(said(data))


def counted(cells: Sequence[Cell]) -> Iterable[Cell]:
    for number, cell in enumerate(cells):
        print(f"\rcell {number + 1} of {len(cells)}", end="", flush=True)
        yield cell
    print()


def table(data: Crossing) -> str:
    """Return medians over the seeds in markdown; in brackets how much is mapped."""
    lines = [
        "| spacing [m] | sigma / spacing | planes [m] | points [m] | points, ids given [m] |",
        "|---|---|---|---|---|",
    ]
    for spacing_m in data.spacings_m:
        for k, noise in enumerate(data.noises(spacing_m)):
            cells = []
            for method in ("planes", "points", "points, ids given"):
                rmse_m = data.median("map_rmse_m", method, spacing_m)[k]
                told = f"{rmse_m:.3f}" if np.isfinite(rmse_m) else "none"
                share = data.median("coverage", method, spacing_m)[k]
                cells.append(f"{told} ({share:.0%})")
            lines.append(f"| {spacing_m:g} | {noise:g} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


MAKERS = {4: corners, 5: bench, 6: partial_wall, 7: noisy, 0: crossing}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("numbers", metavar="NUMBER", type=int, nargs="*", help="4 to 7, or 0")
    parser.add_argument("-o", dest="folder", metavar="DIR", type=Path, required=True)
    parser.add_argument("--quick", action="store_true", help="less data")
    arguments = parser.parse_args()
    wanted = arguments.numbers or list(MAKERS)
    if not set(wanted) <= set(MAKERS):
        parser.error("figures are 4, 5, 6, 7, and 0 for the crossing")
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for number in wanted:
        MAKERS[number](arguments.folder, arguments.quick)
