"""Detection of moving landmarks: precision, recall, and number of comparisons.

    python benchmarks/dynamics.py [--quick]

The figure eight, sigma 0.05 m, with 10 to 70 % of its landmarks moving in all ways of the
simulation.  The status of landmarks seen 30 times at the end of the run is compared with the truth.
Without ids a landmark may have several tracks: each track seen 30 times is evaluated separately, by
the true landmark of most of its observations.  A track that moves only while it is not observed, or
stopped long before it left the view, counts as missed.

Each group sorts the landmarks of its chart into bins; n are those seen often enough to be
compared, if these are two or more.  Pairs compared for the first noise estimate, of at most
`PAIRED` landmarks (`relmap.core.grouping.noise`), are not counted.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from shared.runs import ids_of
from shared.tables import table
from speed import on_one_core

from relmap import PointMapper
from relmap.core.arrays import Floats
from relmap.core.grouping.chart import PointChart
from relmap.core.grouping.completion import RelativeMap
from relmap.core.grouping.dynamics import FEWEST
from relmap.evaluation.metrics import majority_ids
from relmap.simulation import FigureEight, simulate_figure_eight

SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.65, 0.7)
DENSITIES = (25, 100)
SEEDS = range(5)
SEEN = 30
"""Minimum number of observations of an evaluated landmark."""
BAR, JUDGED = 0.97, (0.4, 0.65)
"""Required precision and recall, and the fractions of dynamic landmarks to which this applies."""

Groups = list[tuple[int, int]]
"""Landmarks sorted for each chart, and pairs of them compared."""


class CountingMapper(PointMapper):
    """Counts the landmarks sorted for each chart, and the pairs of them compared."""

    def __init__(self) -> None:
        super().__init__()
        self.charts: Groups = []
        engine = self.engine
        relative_map = engine.relative_map

        def counted(chart: PointChart, weights: Floats, min_shared: int) -> RelativeMap | None:
            averaged = relative_map(chart, weights, min_shared)
            n = int(np.sum(chart.visible.sum(axis=1) >= FEWEST))
            self.charts.append((n, engine.averaging.n_comparisons))
            return averaged

        setattr(engine, "relative_map", counted)  # noqa: B010 - mypy refuses an assignment


@dataclass(frozen=True)
class Outcome:
    """Result of one run: evaluated tracks by their true status and the status found."""

    both: int  # true positives
    called: int
    dynamic: int
    judged: int
    load: Floats  # comparisons / (n log2 n) of each group


def outcome(world: FigureEight, known: bool) -> Outcome:
    mapper = CountingMapper()
    labels = [
        mapper.update(scan.points_robot, scan.ids if known else None) for scan in world.log.scans()
    ]
    mapper.finish()
    tracks = mapper.landmarks_of(np.concatenate(labels))
    judged, true_ids, _ = majority_ids(tracks, ids_of(world.log))
    found = mapper.landmarks
    row = np.searchsorted(found.landmark, judged)
    often = found.observations[row] >= SEEN
    called = (found.status[row] == "dynamic")[often]
    dynamic = (world.status[true_ids] == "dynamic")[often]
    n, compared = np.array([group for group in mapper.charts if group[0] > 1]).T
    return Outcome(
        int(np.sum(called & dynamic)),
        int(called.sum()),
        int(dynamic.sum()),
        int(often.sum()),
        compared / (n * np.log2(n)),
    )


def ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def cells_of(runs: list[Outcome], share: float) -> list[str]:
    """Return pooled and worst precision and recall, and the load of the groups."""
    both = sum(run.both for run in runs)
    cells = [f"{sum(run.judged for run in runs)}"]
    met = True
    for name in ("called", "dynamic"):
        pooled = ratio(both, sum(getattr(run, name) for run in runs))
        worst = min(ratio(run.both, getattr(run, name)) for run in runs)
        cells.append(f"{pooled:.3f} ({worst:.3f})")
        met &= pooled >= BAR
    load = np.concatenate([run.load for run in runs])
    cells.append(("yes" if met else "no") if share in JUDGED else "")
    cells += [f"{len(load)}", f"{np.median(load):.2f}", f"{load.max():.2f}"]
    return [*cells, f"{100 * np.mean(load > 1):.2f} %"]


def main(
    shares: tuple[float, ...], densities: tuple[int, ...], seeds: range, iterations: int = 900
) -> None:
    rows = []
    for density in densities:
        for share in shares:
            worlds = [
                simulate_figure_eight(density, iterations, dynamic=share, seed=seed)
                for seed in seeds
            ]
            for name in ("known", "nearest"):
                runs = [outcome(world, name == "known") for world in worlds]
                first = [f"{density}", f"{100 * share:.0f} %", name]
                rows.append([*first, *cells_of(runs, share)])
    header = ["density", "dynamic", "association", "judged", "precision (worst seed)"]
    header += ["recall (worst seed)", f"both >= {BAR}", "groups"]
    header += ["comparisons / (n log2 n), median", "largest", "groups above 1"]
    table(f"Status dynamic, and comparisons; seeds {seeds[0]} to {seeds[-1]}", header, rows)


if __name__ == "__main__":
    on_one_core()
    parser = argparse.ArgumentParser(description="Measure how moving landmarks are found.")
    quick = "half a loop, one seed, density 25, 40 and 65 %%"
    parser.add_argument("--quick", action="store_true", help=quick)
    if parser.parse_args().quick:
        main(JUDGED, DENSITIES[:1], SEEDS[:1], 450)
    else:
        main(SHARES, DENSITIES, SEEDS)
