"""Figure 17: the trees of Victoria Park, mapped without ids and without odometry."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from relmap.core.errors import RelmapError
from relmap.datasets import open_log
from relmap.datasets.base import ObservationLog
from relmap.evaluation.run import run_mapper
from relmap.figures.base import Outcome, Table, Watch, judged, sentence, unwatched
from relmap.plots.victoria_park import Panel, compare_with_reference, plot_panels
from relmap.points.mapper import PointMapper

FORMAT = "victoria-park"
INTERVALS = ((1181, 1642), (4220, 4634))
"""Of the paper: elsewhere too few trees are seen at once."""
CLOSE_M = 1.0
COVERED = 0.9


class VictoriaParkFigure:
    """Two stretches of the drive over a reference.

    The reference is batch least squares with the published tree ids over the same scans, rigidly
    aligned; it is other people's work and no surveyed truth.
    """

    name = "17"
    title = "Victoria Park"
    claim = (
        "In the stretches of Victoria Park in which enough trees are in view, the trees come out "
        "where an EKF with odometry has them, without any odometry."
    )
    criterion = (
        f"in both stretches the RMSE against batch least squares with the published tree ids is "
        f"below {CLOSE_M:g} m and {COVERED:.0%} of the trees seen ten times are mapped; partly "
        "where one stretch is so"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Map both stretches."""
        if data is None:
            raise RelmapError("figure 17 needs the Victoria Park data: --data PATH")
        log = victoria_park(data)
        panels = []
        for interval in watch(INTERVALS):
            part = log.between(*interval)
            result = run_mapper(PointMapper(), part, "nearest", refine=True).result
            panels.append(compare_with_reference(result, part))
        return outcome(panels)


@cache
def victoria_park(path: Path) -> ObservationLog:
    """Read the data, from their folder or from one that holds it.

    Raises
    ------
    RelmapError
        Where they are not there, or damaged.
    """
    inner = path / FORMAT
    return open_log(inner if inner.is_dir() else path, FORMAT)


def outcome(panels: list[Panel]) -> Outcome:
    """Judge both stretches."""
    worst = max(panel.rmse_m for panel in panels)
    return Outcome(
        lambda: plot_panels(panels),
        Table(("stretch", "what", "seen_ten_times", "x", "y"), rows_of(panels)),
        worst,
        "RMSE of the trees in m in the worse stretch",
        " ".join(sentence(panel.title.replace("\n", ", ")) for panel in panels),
        judged(*(panel.rmse_m < CLOSE_M and panel.coverage >= COVERED for panel in panels)),
    )


def rows_of(panels: list[Panel]) -> list[tuple[object, ...]]:
    """Return a line for each tree, mapped or of the reference, and each pose; metres."""
    rows: list[tuple[object, ...]] = []
    for number, panel in enumerate(panels):
        rows += [(number, "tree", "", *place) for place in panel.trees_map.tolist()]
        reference = zip(panel.often.tolist(), panel.reference_map.tolist(), strict=True)
        rows += [(number, "reference", int(often), *place) for often, place in reference]
        rows += [(number, "pose", "", *place) for place in panel.path_map.tolist()]
    return rows
