"""Beyond figure 7: from which noise on planes have the better map, from the same points."""

from __future__ import annotations

from pathlib import Path

from relmap.figures.base import Outcome, Table, Watch, judged, sentence, unwatched
from relmap.figures.crossing import METHODS, Crossing, run_crossing
from relmap.plots.crossing import plot_crossing, said

SPACINGS_M = (0.2, 0.3, 0.4)
NOISES = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
SEEDS = range(5)
QUICK = ((0.3,), (0.05, 0.15, 0.3), range(1))


class CrossingFigure:
    """Planes and points over the noise."""

    name = "crossing"
    title = "planes and points over the noise"
    claim = (
        "Planes can still be mapped where the noise is too large for points, which is what figure "
        "7 stands for (this picture is not in the paper)."
    )
    criterion = (
        "at every spacing of the points there is a noise from which on planes have the better map, "
        "and one at which points lose half of it; partly where one of the two holds"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Map points of walls both ways, over spacings, noises and seeds."""
        spacings_m, noises, seeds = QUICK if quick else (SPACINGS_M, NOISES, SEEDS)
        return outcome(run_crossing(spacings_m, noises, seeds, progress=watch))


def outcome(data: Crossing) -> Outcome:
    """Judge all runs."""
    points = METHODS[1]
    ahead = [data.planes_ahead(points, spacing_m) for spacing_m in data.spacings_m]
    lost = [data.fails_at(points, spacing_m) for spacing_m in data.spacings_m]
    begins = [interval[0] for interval in ahead if interval is not None]
    return Outcome(
        lambda: plot_crossing(data),
        Table(data.COLUMNS, list(data.rows())),
        max(begins, default=float("nan")),
        "noise over spacing from which on planes have the better map",
        " ".join(map(sentence, said(data).splitlines())),
        judged(len(begins) == len(ahead), None not in lost),
    )
