"""Figure 6: without noise the map is exact, past a stretch with a single partial wall too."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.figures.base import Outcome, Table, Watch, judged, unwatched
from relmap.figures.partial_wall import PartialWall, run_partial_wall
from relmap.plots.partial_wall import plot_partial_wall

EXACT_M = 1e-6
QUICK_POINTS, QUICK_BESIDE = 250, 30


class PartialWallFigure:
    """A drive past a long wall of which only a part is ever in view."""

    name = "6"
    title = "without noise: partial planes, and only one of them"
    claim = (
        "Without noise the map comes out without error, though walls are seen in part and at one "
        "place a single partial wall is all that is in view."
    )
    criterion = (
        f"errors below {EXACT_M:g} m, before and after the single wall, and from the one side of "
        "it to the other; partly where one of the two holds"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Drive past the wall and map it."""
        size = {"points": QUICK_POINTS, "beside": QUICK_BESIDE} if quick else {}
        return outcome(run_partial_wall(**size, progress=lambda scans: watch(list(scans))))


def outcome(run: PartialWall) -> Outcome:
    """Judge a run."""
    worst_m = max(np.inf if error is None else error for error in run.errors_m)
    ahead_m, left_m = np.abs(run.shift)
    off = run.in_truth(run.poses[:, :2, 3]) - run.true_poses[:, :2, 3]
    farthest_m = np.linalg.norm(off[slice(*run.stretch)], axis=1).max()
    return Outcome(
        lambda: plot_partial_wall(run),
        Table(run.COLUMNS, list(run.rows())),
        float(ahead_m),
        "m off along the single partial wall",
        f"Before and after the single wall the path is {worst_m:.0e} m off. Along it, for "
        f"{run.weak_m:.1f} m, nothing that is seen tells how far the robot goes; the motion model "
        f"bridges this; at its end it is {ahead_m:.3f} m off along the wall, {left_m:.4f} m "
        f"across, and on the way at most {farthest_m:.3f} m off.",
        judged(worst_m < EXACT_M, max(ahead_m, left_m) < EXACT_M),
    )
