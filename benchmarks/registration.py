"""How well landmarks are told apart without ids: the figures of docs/benchmarks.md.

    python benchmarks/registration.py [DATA]

Default settings, association "nearest", no odometry; ids only judge the result. Beside relmap's own
registration stands the paper's, "nearest-previous". DATA is a folder with the real data sets;
without it only the figure eight is measured. "Often" is at least ten times.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from relmap import MapperConfig, PointMapper
from relmap.comparison.baselines.known import least_squares_map
from relmap.core.arrays import Floats, Ints
from relmap.core.association import Constellation
from relmap.core.landmarks import LandmarkMap
from relmap.datasets import ObservationLog, open_log, slsjf
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.evaluation import metrics
from relmap.evaluation.landmarks import Identified, identify
from relmap.evaluation.run import run_mapper
from relmap.io.results import Result
from relmap.simulation import FigureEight, simulate_figure_eight

REGISTRATIONS = ("constellation", "nearest-previous")
SEEDS = range(5)
OFTEN = 10
INTERVALS = ((1181, 1642), (4220, 4634))


class CountingMapper(PointMapper):
    """Counts the iterations that could not be tied to anything before."""

    unmatched = 0
    _n_landmarks = 0
    _before = 0

    def update(
        self, points: ArrayLike, ids: ArrayLike | None = None, covariances: ArrayLike | None = None
    ) -> Ints:
        """Take in a scan; it is unmatched if all of it is new though the one before saw some."""
        labels = super().update(points, ids, covariances)
        all_new = len(labels) > 0 and labels.min() >= self._n_landmarks
        self.unmatched += all_new and self._before > 0
        self._n_landmarks = max(self._n_landmarks, labels.max(initial=-1) + 1)
        self._before = len(labels)
        return labels


@dataclass(frozen=True, eq=False)
class Outcome:
    """A run, and what its observations truly are of."""

    result: Result
    identified: Identified
    unmatched: int

    @property
    def purity(self) -> float:
        """Share of the observations that are of what most of their track's are of."""
        return metrics.purity(self.identified.landmark, self.identified.true_id)

    @property
    def tracks_per_landmark(self) -> float:
        """Tracks for each landmark that was seen."""
        labels, _, _ = self._majority
        seen = self.identified.true_id
        return len(labels) / len(np.unique(seen[seen >= 0]))

    def mapped(self) -> tuple[int, int]:
        """Return how many of the landmarks seen often are mapped, and how many there are."""
        often = metrics.seen_often(self.identified.true_id, self.identified.iteration, OFTEN)
        ids, _, _ = self._mapped_tracks
        return len(np.intersect1d(often, ids)), len(often)

    def agreeing(self, ids: Ints) -> float:
        """Return the share of these landmarks' observations that are in a track of theirs."""
        labels, majority, _ = self._majority
        of = self.identified.true_id
        chosen = np.isin(of, ids)
        stands_for = majority[np.searchsorted(labels, self.identified.landmark[chosen])]
        return float(np.mean(stands_for == of[chosen]))

    def rmse(self, truth: LandmarkMap, least: int = 1) -> tuple[float | None, int]:
        """Return the RMSE of mapped tracks seen so often, after alignment, and their number."""
        ids, positions, observations = self._mapped_tracks
        chosen = (observations >= least) & np.isin(ids, truth.landmark_ids)
        order = np.argsort(truth.landmark_ids)
        at = order[np.searchsorted(truth.landmark_ids[order], ids[chosen])]
        d = 2 if self.result.planar else 3
        here, there = positions[chosen, :d], truth.positions[at, :d]
        R, t = metrics.align(here, there)
        return metrics.rms(here @ R.T + t - there), len(here)

    @property
    def _majority(self) -> tuple[Ints, Ints, Ints]:
        return metrics.majority_ids(self.identified.landmark, self.identified.true_id)

    @property
    def _mapped_tracks(self) -> tuple[Ints, Floats, Ints]:
        """What each mapped track stands for, its place, and how often it was seen."""
        labels, majority, _ = self._majority
        table = self.result.landmarks
        rows = np.flatnonzero(self.result.mapped & np.isin(table.landmark, labels))
        ids = majority[np.searchsorted(labels, table.landmark[rows])]
        return ids, table.position[rows], table.observations[rows]


def outcomes(log: ObservationLog) -> list[Outcome]:
    """Map a log without its ids, once with each registration."""
    found = []
    for registration in REGISTRATIONS:
        mapper = CountingMapper(MapperConfig(registration=registration))
        result = run_mapper(mapper, log, "nearest", refine=True).result
        found.append(Outcome(result, identify(result, log), mapper.unmatched))
    return found


def title(text: str) -> None:
    print(f"\n| {text} | {' | '.join(REGISTRATIONS)} |\n|---|---|---|")


def row(name: str, values: Iterable[str]) -> None:
    print(f"| {name} | {' | '.join(values)} |", flush=True)


def share(counts: tuple[int, int]) -> str:
    return f"{counts[0]} of {counts[1]}"


def metres(rmse: tuple[float | None, int]) -> str:
    return "-" if rmse[0] is None else f"{rmse[0]:.4f} ({rmse[1]})"


def submaps(result: Result) -> str:
    """Say how many submaps the map has, and how many landmarks are in the largest."""
    sizes = [len(submap.landmark_ids) for submap in result.submaps]
    return f"{len(sizes)} ({sizes[0] if sizes else 0} of {sum(sizes)})"


def common_rows(runs: Sequence[Outcome]) -> None:
    row("purity", (f"{run.purity:.4f}" for run in runs))
    row("landmarks seen often that are mapped", (share(run.mapped()) for run in runs))
    row("tracks per landmark", (f"{run.tracks_per_landmark:.2f}" for run in runs))
    row("iterations left unmatched", (str(run.unmatched) for run in runs))
    row("submaps (landmarks in the largest)", (submaps(run.result) for run in runs))


def figure_eight() -> None:
    for density in (25, 200, 1000):
        worlds = [simulate_figure_eight(density=density, seed=seed) for seed in SEEDS]
        runs = list(zip(*(outcomes(world.log) for world in worlds), strict=True))
        title(f"figure eight, density {density}, sigma 0.05, {len(SEEDS)} seeds, worst of them")
        row("purity", (f"{min(run.purity for run in kind):.5f}" for kind in runs))
        row(
            "share of the landmarks seen often that are mapped",
            (f"{min(np.divide(*run.mapped()) for run in kind):.4f}" for kind in runs),
        )
        row(
            "tracks per landmark",
            (f"{max(run.tracks_per_landmark for run in kind):.2f}" for kind in runs),
        )
    dynamic_figure_eight([simulate_figure_eight(dynamic=0.4, seed=seed) for seed in SEEDS])


def dynamic_figure_eight(worlds: Sequence[FigureEight]) -> None:
    title(f"figure eight, density 25, 40 % dynamic, {len(SEEDS)} seeds, worst of them")
    pure = []
    for world in worlds:
        static = world.landmark_ids[world.status == "static"]
        pure.append([run.agreeing(static) for run in outcomes(world.log)])
    row("purity of the static landmarks", (f"{value:.5f}" for value in np.min(pure, axis=0)))


def mrpt(data: Path) -> None:
    for name in ("kf-slam_6D_demo_noncentered", "kf-slam_6D_demo"):
        path = data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
        truth = LandmarkMap(*read_ground_truth(path)[:2])
        runs = outcomes(open_log(path))
        title(name)
        common_rows(runs)
        row("RMSE of tracks seen often [m] (tracks)", (metres(r.rmse(truth, OFTEN)) for r in runs))


def victoria_park(data: Path) -> None:
    log = open_log(data / "victoria-park")
    for begin, end in INTERVALS:
        part = log.between(begin, end)
        reference = least_squares_map(part)
        runs = outcomes(part)
        title(f"Victoria Park {begin}:{end}, published ids")
        common_rows(runs)
        for text, least in (("all tracks", 1), ("tracks seen often", OFTEN)):
            row(
                f"RMSE of {text} [m] against batch (tracks)",
                (metres(run.rmse(reference, least)) for run in runs),
            )
    runs = outcomes(log)
    title("Victoria Park, all scans, published ids")
    common_rows(runs)
    largest_submaps(runs[0].result)


def largest_submaps(result: Result, n: int = 5) -> None:
    print(f"\nLargest submaps of {REGISTRATIONS[0]}:\n")
    for submap in result.summary["submaps"][:n]:
        scans = f"{submap['iterations'][0]}:{submap['iterations'][1] + 1}"
        print(f"* {submap['landmarks']} landmarks, scans {scans}", flush=True)


def small_robots(data: Path) -> None:
    runs = outcomes(open_log(data / "dlr-circles"))
    title("dlr-circles")
    common_rows(runs)
    truth = LandmarkMap(*slsjf.read_ground_truth(data / "slsjf-sim-8240")[:2])
    runs = outcomes(open_log(data / "slsjf-sim-8240"))
    title("slsjf-sim-8240")
    common_rows(runs)
    row("RMSE of tracks seen often [m] (tracks)", (metres(r.rmse(truth, OFTEN)) for r in runs))


def cost(iterations: int = 300, warm_up: int = 20) -> None:
    """Time one match beside building and asking one k-d tree of the same scans."""
    print("\n| cost of matching a scan, median | k-d tree [ms] | constellation [ms] | ratio |")
    print("|---|---|---|---|")
    for density in (125, 500, 1250):
        log = simulate_figure_eight(density=density, iterations=iterations).log
        registration = Constellation(MapperConfig().max_missed)
        times, previous = [], None
        for scan in log.scans():
            points = scan.points_robot
            begin = perf_counter()
            if previous is not None:
                cKDTree(points).query(previous)
            middle = perf_counter()
            registration.match(points, None)
            times.append((middle - begin, perf_counter() - middle))
            previous = points
        tree, match = 1e3 * np.median(times[warm_up:], axis=0)
        visible = len(log.points_robot) / len(log)
        print(
            f"| {visible:.0f} visible | {tree:.3f} | {match:.3f} | {match / tree:.1f} |", flush=True
        )


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path, help="folder of the real data sets")
    data = parser.parse_args().data
    cost()
    figure_eight()
    if data is not None:
        mrpt(data)
        victoria_park(data)
        small_robots(data)


if __name__ == "__main__":
    main()
