"""Figure 7: planes hold at a noise at which points are lost."""

from __future__ import annotations

from pathlib import Path

from relmap.figures.base import Outcome, Table, Watch, judged, unwatched
from relmap.figures.crossing import HALF
from relmap.figures.noisy_map import NoisyMaps, run_noisy_maps
from relmap.plots.crossing import plot_noisy_maps

QUICK_ITERATIONS = 80
MUCH = 2.0


class NoisyMapFigure:
    """The same noisy points mapped as planes, and as points."""

    name = "7"
    title = "planes under noise that points do not survive"
    claim = (
        "With a noise so large that no point can be told from its neighbours, the map of planes "
        "has some error, much less than with points, which could not be mapped at all."
    )
    criterion = (
        f"planes: {HALF:.0%} of the corners seen ten times are mapped, and points: less than "
        f"{HALF:.0%} of them are, or they are {MUCH:g} times as far off; partly where one holds"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Map the points of a building's walls both ways."""
        return outcome(run_noisy_maps(iterations=QUICK_ITERATIONS if quick else None))


def outcome(maps: NoisyMaps) -> Outcome:
    """Judge two maps."""
    planes_m, points_m = maps.planes_rmse_m, maps.points_rmse_m
    hold = planes_m is not None and maps.planes_coverage >= HALF
    lost = points_m is None or maps.points_coverage < HALF
    worse = lost or (planes_m is not None and points_m is not None and points_m > MUCH * planes_m)
    return Outcome(
        lambda: plot_noisy_maps(maps),
        Table(maps.COLUMNS, list(maps.rows())),
        float("nan") if planes_m is None else planes_m,
        "RMSE of the corners in m",
        f"Noise {maps.sigma:.3g} m, {maps.noise:g} of the spacing of the points. "
        f"Planes: {maps.said_of_planes}. Points, without ids: {maps.said_of_points}.",
        judged(hold, worse),
    )
