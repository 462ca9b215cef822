"""Figure 13: the figure eight, and the map that closes over it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.evaluation.evaluate import Evaluation, evaluate
from relmap.evaluation.landmarks import identify, match_landmarks
from relmap.evaluation.metrics import rms
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import truth_of
from relmap.figures.base import Outcome, Table, Watch, judged, unwatched
from relmap.plots.eight import EightPicture, plot_eight
from relmap.points.mapper import PointMapper
from relmap.simulation import simulate_figure_eight

SIGMA_M = 0.05
QUICK_DENSITY, DENSITY = 15.0, 25.0
COVERED = 0.95
ONCE = 1.1


class EightFigure:
    """One loop, mapped without ids."""

    name = "13"
    title = "the figure eight"
    claim = (
        "The robot climbs and descends along an eight, so that it is back where it was only after "
        "the whole loop; landmarks seen again there are merged, which closes the loop."
    )
    criterion = (
        f"without ids the map is better than one observation (RMSE below sigma, {SIGMA_M} m) with "
        f"{COVERED:.0%} of the landmarks seen ten times, and it has at most {ONCE:g} landmarks for "
        "each true one; partly where one of the two holds"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Map the loop."""
        world = simulate_figure_eight(QUICK_DENSITY if quick else DENSITY, sigma=SIGMA_M)
        mapper = PointMapper()
        result = run_mapper(
            mapper, world.log, "nearest", progress=lambda scans: watch(list(scans)), refine=True
        ).result
        truth = truth_of(world)
        matched = match_landmarks(result, truth, identify(result, world.log))
        assert matched is not None
        R, t = matched.R, matched.t  # the map is drawn in the frame of the truth
        picture = EightPicture(
            result.landmarks.position[result.mapped] @ R.T + t,
            result.poses[:, :3, 3] @ R.T + t,
            world.landmarks_map,
            world.trajectory[:, :3, 3],
            rms(matched.position @ R.T + t - matched.truth) or 0.0,
        )
        return outcome(picture, evaluate(result, truth, world.log))


def outcome(picture: EightPicture, found: Evaluation) -> Outcome:
    """Judge a map of the eight."""
    names = ("mapped landmark", "path from the map", "true landmark", "true path")
    places = (picture.landmarks_map, picture.path_map,
              picture.true_landmarks_map, picture.true_path_map)  # fmt: skip
    rows = [
        (name, *point)
        for name, points in zip(names, places, strict=True)
        for point in points.tolist()
    ]
    covered, per_true = found.coverage or 0.0, found.landmarks_per_true or np.inf
    return Outcome(
        lambda: plot_eight(picture),
        Table(("what", "x", "y", "z"), rows),
        picture.rmse_m,
        "RMSE of the landmarks in m",
        f"{len(picture.landmarks_map)} landmarks mapped without ids, {covered:.0%} of those seen "
        f"ten times, RMSE {picture.rmse_m:.4f} m, {per_true:.3f} landmarks for each true one; the "
        f"path is {'-' if found.ate_m is None else format(found.ate_m, '.3f')} m off.",
        judged(picture.rmse_m < SIGMA_M and covered >= COVERED, per_true <= ONCE),
    )
