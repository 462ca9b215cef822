"""The paper's figures 9 to 15, drawn from runs of this software.

    python benchmarks/figures.py [NUMBER ...] -o DIR [--quick]

Writes figureNN.png and the data behind it, figureNN.csv, of each figure named; of all where none
is. Times are processor time, the median over runs of the same log; --quick makes fewer runs. Figure
17 has a program of its own.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

from relmap import MapperConfig, PointMapper
from relmap.core.dynamics import Binning
from relmap.core.registration import Constellation
from relmap.core.store import ObservationStore
from relmap.datasets import ObservationLog
from relmap.evaluation.evaluate import identify, match_landmarks
from relmap.evaluation.metrics import rms
from relmap.evaluation.run import run_mapper
from relmap.evaluation.truth import Truth
from relmap.files import atomic_write
from relmap.plots import chart as charts
from relmap.plots import curves
from relmap.plots.eight import EightPicture, plot_eight
from relmap.plots.sheet import write_png
from relmap.simulation import simulate_figure_eight
from relmap.tables import csv_text

SIGMA_M = 0.05
VISIT = 100
"""Iterations for which the seed of figures 9 to 11 is in view, as nearly as may be."""
MARGIN = 20
"""Iterations that they show before and after."""
BLOCK = 30
"""Iterations in which the landmarks of figure 12 are seen."""
MISPLACED = 0.02
"""Share of them that the static bin may hold wrongly or lack, and be right all the same."""


@dataclass(frozen=True)
class Effort:
    """How much is run."""

    repeats: int  # of a timed run: an iteration's time is the median of them
    worlds: int  # of figure 12
    sizes: tuple[int, ...]  # of its blocks, in landmarks
    densities: tuple[float, ...]  # of figure 15; about 0.85 of them are visible


FULL = Effort(
    repeats=9,
    worlds=40,
    sizes=(20, 30, 50, 80, 130, 200, 320, 500, 800),
    densities=(12, 25, 50, 100, 200, 400, 700, 1200, 1900),
)
QUICK = Effort(
    repeats=3,
    worlds=10,
    sizes=(20, 50, 130, 320, 800),
    densities=(12, 50, 200, 700, 1900),
)
SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
Rows = Iterable[Sequence[object]]


def save(
    folder: Path, number: int, draw: Callable[[], object], header: Sequence[str], rows: Rows
) -> None:
    """Write the picture of a figure, and its data as a table."""
    write_png(folder / f"figure{number:02d}.png", draw)
    atomic_write(folder / f"figure{number:02d}.csv", csv_text(header, rows))


# Figures 9 to 11: the point chart.


def stored_log(log: ObservationLog) -> ObservationStore:
    """Register the scans of a log without its ids, and store them."""
    store, registration = ObservationStore(), Constellation(MapperConfig().max_missed)
    for scan in log.scans():
        store.append(registration.match(scan.points_robot, None), scan.points_robot)
    return store


def whole_visit(store: ObservationStore) -> tuple[int, int, int]:
    """Return the landmark whose visit is nearest to `VISIT` iterations, and begin and end of it."""
    landmarks, iterations = store.seen(0, store.n_iterations)
    best = (np.inf, 0, 0, 0)
    for landmark in range(int(landmarks.max()) + 1):
        when = iterations[landmarks == landmark]
        begin, end = int(when[0]), int(when[-1]) + 1
        if begin >= MARGIN and end <= store.n_iterations - MARGIN and len(when) > 0.9 * VISIT:
            best = min(best, (abs(end - begin - VISIT), landmark, begin, end))
    return best[1:]


def point_chart(folder: Path, numbers: Sequence[int], effort: Effort) -> None:
    store = stored_log(simulate_figure_eight(density=25, sigma=SIGMA_M).log)
    seed, begin, end = whole_visit(store)
    chart = charts.chart_picture(store, seed, begin - MARGIN, end + MARGIN)
    header = ("row", "landmark", "iteration", "in_seed_interval")
    if 9 in numbers:
        rows = visible_rows(chart, np.arange(len(chart.order)))
        save(folder, 9, lambda: charts.plot_unsorted(chart), header, rows)
    if 10 in numbers:
        rows = visible_rows(chart, chart.order)
        save(folder, 10, lambda: charts.plot_sorted(chart), header, rows)
    if 11 in numbers:
        header = ("row", "landmark", "common_interval", "area", "member")
        numbered = zip(chart.landmarks[chart.order], chart.common_interval, chart.area, strict=True)
        rows = ((row, *values, int(row < chart.members)) for row, values in enumerate(numbered))
        save(folder, 11, lambda: charts.plot_group(chart), header, rows)
    print(
        f"figures 9 to 11: landmark {seed}, seen in iterations {begin} to {end - 1}, "
        f"grows a group of {chart.members} landmarks x {chart.group_interval.sum()} iterations"
    )


def visible_rows(chart: charts.ChartPicture, order: NDArray[np.int64]) -> Rows:
    """Return a line per observation in the chart, its rows in the order given."""
    row, column = np.nonzero(chart.visible[order])
    landmark, within = chart.landmarks[order][row], chart.seed_interval[column].astype(int)
    return zip(row, landmark, chart.begin + column, within, strict=True)


# Figure 12: comparisons.


def observed_places(seed: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return landmarks that a robot sees in each of `BLOCK` iterations, without noise.

    Those that are dynamic but stand still for the time are left out: nothing tells them.

    Returns
    -------
    (n, i, 3) float64, robot frame, metres; (n,) bool
        The second tells which are static.
    """
    density = 6 * FULL.sizes[-1]
    world = simulate_figure_eight(density, BLOCK, sigma=0.0, dynamic=0.4, seed=seed)
    log = world.log
    ids, counts = np.unique(log.ids, return_counts=True)
    ids = ids[counts == BLOCK]
    by_landmark = np.lexsort((log.iteration, log.ids))
    of_them = by_landmark[np.isin(log.ids[by_landmark], ids)]
    block = log.points_robot[of_them].reshape(len(ids), BLOCK, 3)
    R, t = world.trajectory[:, :3, :3], world.trajectory[:, :3, 3]
    place = np.einsum("ijk,nik->nij", R, block) + t
    static = world.status[ids] == "static"
    moves = np.sqrt(place.var(axis=1).sum(axis=1)) > SIGMA_M
    return block[static | moves], static[static | moves]


def block_of(
    n: int, share: float, pool: NDArray[np.float64], static: NDArray[np.bool_], seed: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return n of the landmarks, a share of them dynamic, with noise; and which are static."""
    rng = np.random.default_rng([seed, n, round(100 * share)])
    n_dynamic = round(share * n)
    chosen = [rng.permutation(np.flatnonzero(~static))[:n_dynamic]]
    chosen.append(rng.permutation(np.flatnonzero(static))[: n - n_dynamic])
    rows = rng.permutation(np.concatenate(chosen))
    return pool[rows] + rng.normal(0, SIGMA_M, (n, BLOCK, 3)), static[rows]


def comparisons(folder: Path, numbers: Sequence[int], effort: Effort) -> None:
    shape = (len(SHARES), len(effort.sizes), effort.worlds)
    counts, right = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
    for seed in range(effort.worlds):
        pool, static = observed_places(seed)
        for s, k in np.ndindex(shape[:2]):
            n = effort.sizes[k]
            block, at_rest = block_of(n, SHARES[s], pool, static, seed)
            bins = Binning(block, SIGMA_M).sort(np.zeros(n))
            misplaced = np.sum(np.isin(np.arange(n), bins.static) != at_rest)
            counts[s, k, seed] = bins.n_comparisons
            right[s, k, seed] = misplaced <= max(1, MISPLACED * n)
    data = curves.Comparisons(np.array(effort.sizes), np.array(SHARES), counts, right)
    rows = (
        (SHARES[s], effort.sizes[k], world, counts[s, k, world], int(right[s, k, world]))
        for s, k, world in np.ndindex(shape)
    )
    header = ("dynamic", "landmarks", "world", "comparisons", "static_bin_right")
    save(folder, 12, lambda: curves.plot_comparisons(data), header, rows)
    most = (data.median / curves.n_log_n(data.n)).max(axis=1)
    print("figure 12: by share dynamic, most comparisons / n log2 n, worlds with the bin right")
    for share, ratio, found in zip(SHARES, most, right.mean(axis=(1, 2)), strict=True):
        print(f"  {100 * share:.0f} %: {ratio:.2f}, {100 * found:.0f} %")


# Figure 13: the eight.


def eight(folder: Path, numbers: Sequence[int], effort: Effort) -> None:
    world = simulate_figure_eight(density=25, sigma=SIGMA_M)
    result = run_mapper(PointMapper(), world.log, "nearest", refine=True).result
    stamps_s = np.arange(len(world.log), dtype=np.float64)
    truth = Truth(world.landmark_ids, world.landmarks_map, world.status, stamps_s, world.trajectory)
    matched = match_landmarks(result, truth, identify(result, world.log))
    R, t = matched.R, matched.t  # the map is drawn in the frame of the truth
    data = EightPicture(
        result.landmarks.position[result.mapped] @ R.T + t,
        result.poses[:, :3, 3] @ R.T + t,
        world.landmarks_map,
        world.trajectory[:, :3, 3],
        rms(matched.position @ R.T + t - matched.truth),
    )
    names = ("mapped landmark", "path from the map", "true landmark", "true path")
    places = (data.landmarks_map, data.path_map, data.true_landmarks_map, data.true_path_map)
    rows = [
        (name, *point)
        for name, points in zip(names, places, strict=True)
        for point in points.tolist()
    ]
    save(folder, 13, lambda: plot_eight(data), ("what", "x", "y", "z"), rows)
    print(f"figure 13: {len(data.landmarks_map)} landmarks mapped, RMSE {data.rmse_m:.4f} m")


# Figures 14 and 15: run time.


def timed(log: ObservationLog) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Map a log without its ids; return each iteration's time, ms, and each point's landmark."""
    mapper, times_s, labels = PointMapper(), [], []
    for scan in log.scans():
        began = process_time()
        labels.append(mapper.update(scan.points_robot))
        times_s.append(process_time() - began)
    return 1e3 * np.array(times_s), mapper.landmarks_of(np.concatenate(labels))


def median_times(log: ObservationLog, repeats: int) -> NDArray[np.float64]:
    """Return the time of each iteration, ms: the median of several runs."""
    return np.median([timed(log)[0] for _ in range(repeats)], axis=0)


def seen_so_far(landmarks: NDArray[np.int64], log: ObservationLog) -> NDArray[np.int64]:
    """Return how many different landmarks were seen up to each iteration of a log."""
    _, first = np.unique(landmarks, return_index=True)
    return np.cumsum(np.bincount(log.iteration[first], minlength=len(log)))


def warm_up() -> None:
    """Have everything compiled that is compiled when it is first used."""
    timed(simulate_figure_eight(density=100, iterations=100).log)


def loop(folder: Path, numbers: Sequence[int], effort: Effort) -> None:
    warm_up()
    log = simulate_figure_eight(density=1000, sigma=SIGMA_M).log
    times_ms, labels = median_times(log, effort.repeats), timed(log)[1]
    visible = np.bincount(log.iteration, minlength=len(log))
    data = curves.LoopTiming(times_ms, visible, seen_so_far(labels, log), seen_so_far(log.ids, log))
    header = ("iteration", "time_ms", "visible", "landmarks", "true_landmarks")
    counts = (visible, data.landmarks, data.true_landmarks)
    rows = zip(range(len(log)), times_ms, *counts, strict=True)
    save(folder, 14, lambda: curves.plot_loop_timing(data), header, rows)
    print(f"figure 14: {data.said}")


def densities(folder: Path, numbers: Sequence[int], effort: Effort) -> None:
    warm_up()
    found = []
    for density in effort.densities:
        log = simulate_figure_eight(density, sigma=SIGMA_M).log
        times_ms = median_times(log, effort.repeats)
        visible = len(log.points_robot) / len(log)
        found.append((visible, float(np.median(times_ms)), float(np.mean(times_ms))))
    data = curves.DensityTiming(*np.array(found).T)
    header = ("visible", "median_ms", "mean_ms")
    save(folder, 15, lambda: curves.plot_density_timing(data), header, found)
    print(f"figure 15: {data.said}")


MAKERS = dict.fromkeys((9, 10, 11), point_chart)
MAKERS |= {12: comparisons, 13: eight, 14: loop, 15: densities}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw figures 9 to 15.")
    parser.add_argument("numbers", metavar="NUMBER", type=int, nargs="*", help="9 to 15")
    parser.add_argument("-o", dest="folder", metavar="DIR", type=Path, required=True)
    parser.add_argument("--quick", action="store_true", help="fewer runs")
    arguments = parser.parse_args()
    wanted = arguments.numbers or list(MAKERS)
    if not set(wanted) <= set(MAKERS):
        parser.error(f"figures are {', '.join(map(str, MAKERS))}")
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for make in dict.fromkeys(MAKERS[number] for number in sorted(wanted)):
        make(arguments.folder, wanted, QUICK if arguments.quick else FULL)
