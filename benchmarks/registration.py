"""Association of landmarks without ids.

    python benchmarks/registration.py [DATA]

Default settings, association "nearest", no odometry; ids are used only to evaluate the result. The
second figure is with the paper's registration, "nearest-previous". DATA is a folder with the real
data sets; without it only the figure eight is measured. "Often" is at least ten times.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from scipy.spatial import cKDTree
from shared.tables import header, row

from relmap import MapperConfig, PointMapper
from relmap.core.arrays import Floats, Ints, positions_of
from relmap.core.association import Constellation
from relmap.core.landmarks import LandmarkMap
from relmap.datasets import ObservationLog, open_log, slsjf, victoria_park
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.evaluation import metrics
from relmap.evaluation.landmarks import Identified, identify
from relmap.evaluation.run import run_mapper
from relmap.io.results import Result
from relmap.simulation import simulate_figure_eight

REGISTRATIONS = ("constellation", "nearest-previous")
SEEDS = range(5)
DENSITIES = {25: SEEDS, 200: SEEDS, 1000: range(1)}
"""Seeds for each density; one of the last takes a minute."""
OFTEN = 10
INTERVALS = ((1181, 1642), (4220, 4634))


@dataclass(frozen=True, eq=False)
class Outcome:
    """A run, and the true landmarks of its observations."""

    result: Result
    identified: Identified

    @property
    def purity(self) -> float:
        """Fraction of the observations that belong to the landmark of most of their track."""
        return metrics.purity(self.identified.landmark, self.identified.true_id) or 0.0

    @property
    def tracks_per_landmark(self) -> float:
        """Tracks for each landmark that was seen."""
        labels, _, _ = self._majority
        seen = self.identified.true_id
        return len(labels) / len(np.unique(seen[seen >= 0]))

    def mapped(self) -> tuple[int, int]:
        """Return how many of the landmarks seen often are mapped, and how many there are."""
        often = metrics.seen_often(self.identified.seen_id, self.identified.seen_iteration, OFTEN)
        ids, _, _ = self._mapped_tracks
        return len(np.intersect1d(often, ids)), len(often)

    def agreeing(self, ids: Ints) -> float:
        """Return the fraction of these landmarks' observations that are in one of their tracks."""
        labels, majority, _ = self._majority
        of = self.identified.true_id
        chosen = np.isin(of, ids)
        stands_for = majority[np.searchsorted(labels, self.identified.landmark[chosen])]
        return float(np.mean(stands_for == of[chosen]))

    def rmse(self, truth: LandmarkMap) -> float | None:
        """Return the RMSE of the mapped tracks seen often, metres, after alignment."""
        ids, positions, observations = self._mapped_tracks
        chosen = (observations >= OFTEN) & np.isin(ids, truth.landmark_ids)
        at = positions_of(truth.landmark_ids, ids[chosen])
        d = 2 if self.result.planar else 3
        return metrics.aligned_rmse(positions[chosen, :d], truth.positions[at, :d])

    @property
    def _majority(self) -> tuple[Ints, Ints, Ints]:
        return metrics.majority_ids(self.identified.landmark, self.identified.true_id)

    @property
    def _mapped_tracks(self) -> tuple[Ints, Floats, Ints]:
        """True landmark, position and number of observations of each mapped track."""
        labels, majority, _ = self._majority
        table = self.result.landmarks
        rows = np.flatnonzero(self.result.mapped & np.isin(table.landmark, labels))
        ids = majority[np.searchsorted(labels, table.landmark[rows])]
        return ids, table.position[rows], table.observations[rows]


def outcomes(log: ObservationLog) -> list[Outcome]:
    """Map a log without its ids, once with each registration."""
    found = []
    for registration in REGISTRATIONS:
        mapper = PointMapper(MapperConfig(registration=registration))
        result = run_mapper(mapper, log, "nearest", refine=True).result
        identified = identify(result, log)
        assert identified is not None
        found.append(Outcome(result, identified))
    return found


def both(name: str, own: Iterable[str], paper: Iterable[str]) -> None:
    """Print a row; in brackets the figures with the paper's registration."""
    row(name, *(f"{figure} [{other}]" for figure, other in zip(own, paper, strict=True)))


def log_row(name: str, log: ObservationLog, truth: LandmarkMap | None) -> None:
    """Map a log and print its row."""
    both(name, *(figures(run, truth) for run in outcomes(log)))


def figures(run: Outcome, truth: LandmarkMap | None) -> list[str]:
    found, often = run.mapped()
    error_m = None if truth is None else run.rmse(truth)
    return [
        f"{run.purity:.4f}",
        f"{found} of {often}",
        "-" if error_m is None else f"{error_m:.3f}",
        f"{run.tracks_per_landmark:.3g}",
        f"{len(run.result.submaps)}",
    ]


def worst(runs: Sequence[Outcome]) -> list[str]:
    return [
        f"{min(run.purity for run in runs):.4f}",
        f"{min(np.divide(*run.mapped()) for run in runs):.1%}",
        "-",
        f"{max(run.tracks_per_landmark for run in runs):.3g}",
        f"{max(len(run.result.submaps) for run in runs)}",
    ]


def figure_eight() -> None:
    for density, seeds in DENSITIES.items():
        worlds = [simulate_figure_eight(density=density, seed=seed) for seed in seeds]
        runs = zip(*(outcomes(world.log) for world in worlds), strict=True)
        both(f"figure eight, density {density}, worst of {len(seeds)}", *map(worst, runs))
    pure = []
    for seed in SEEDS:
        world = simulate_figure_eight(dynamic=0.4, seed=seed)
        static = world.landmark_ids[world.status == "static"]
        pure.append([run.agreeing(static) for run in outcomes(world.log)])
    name = f"figure eight, 40 % dynamic, static ones, worst of {len(SEEDS)}"
    both(name, *([f"{value:.4f}", *"----"] for value in np.min(pure, axis=0)))


def real(data: Path) -> None:
    for name in ("kf-slam_6D_demo_noncentered", "kf-slam_6D_demo"):
        path = data / "mrpt-kf-slam" / f"{name}.observations.csv.gz"
        log_row(f"MRPT `{name}`", open_log(path), LandmarkMap(*read_ground_truth(path)[:2]))
    victoria = open_log(data / "victoria-park")
    reference = LandmarkMap(*victoria_park.read_reference_map(data / "victoria-park"))
    for begin, end in INTERVALS:
        part = victoria.between(begin, end)
        log_row(f"Victoria Park, scans {begin}:{end}", part, reference)
    log_row("Victoria Park, all scans", victoria, reference)
    log_row("DLR circles", open_log(data / "dlr-circles"), None)
    truth = LandmarkMap(*slsjf.read_ground_truth(data / "slsjf-sim-8240")[:2])
    log_row("I-SLSJF simulation", open_log(data / "slsjf-sim-8240"), truth)


def cost(iterations: int = 300, warm_up: int = 20) -> None:
    """Compare the time of one match with building and querying a k-d tree of the same scans."""
    print()
    header("cost of matching a scan, median", "k-d tree [ms]", "constellation [ms]", "ratio")
    for density in (125, 500, 1250):
        log = simulate_figure_eight(density=density, iterations=iterations).log
        registration = Constellation(MapperConfig().max_missed)
        times, previous = [], None
        for scan in log.scans():
            points = scan.points_robot
            begin = process_time()
            if previous is not None:
                cKDTree(points).query(previous)
            middle = process_time()
            registration.match(points, None)
            times.append((middle - begin, process_time() - middle))
            previous = points
        tree, match = 1e3 * np.median(times[warm_up:], axis=0)
        visible = len(log.points_robot) / len(log)
        row(f"{visible:.0f} visible", f"{tree:.3f}", f"{match:.3f}", f"{match / tree:.1f}")


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path, help="folder of the real data sets")
    data = parser.parse_args().data
    header("data", "purity", "mapped", "RMSE [m]", "tracks per landmark", "submaps")
    figure_eight()
    if data is not None:
        real(data)
    cost()


if __name__ == "__main__":
    main()
