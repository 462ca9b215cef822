"""The point chart of a run without ids, around one landmark: the data of figures 9 to 11."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from relmap.core.association import Constellation
from relmap.core.config import MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.state.store import ObservationStore
from relmap.datasets.base import ObservationLog
from relmap.plots.chart import ChartPicture, chart_picture
from relmap.simulation import simulate_figure_eight

QUICK_ITERATIONS = 300
VISIT = 100
"""Iterations for which the seed is in view, as nearly as may be."""
MARGIN = 20
"""Iterations that are shown before and after."""


@dataclass(frozen=True, eq=False)
class ChartedRun:
    """A figure eight, registered without its ids.

    Attributes
    ----------
    log : ObservationLog
        With the true ids.
    store : ObservationStore
        With the landmarks as they were told apart.
    """

    log: ObservationLog
    store: ObservationStore

    @property
    def visits(self) -> list[tuple[int, int, int]]:
        """Landmark, begin and end of every visit that lies well within the run."""
        landmarks, iterations = self.store.seen(0, self.store.n_iterations)
        order = np.argsort(landmarks, kind="stable")
        bounds = np.searchsorted(landmarks[order], np.arange(landmarks.max(initial=-1) + 2))
        found = []
        for landmark, (low, high) in enumerate(pairwise(bounds)):
            when = iterations[order[low:high]]
            if not len(when):
                continue
            begin, end = int(when[0]), int(when[-1]) + 1
            if begin >= MARGIN and end <= self.store.n_iterations - MARGIN:
                found.append((landmark, begin, end))
        return found

    def truly_visible(self, chart: ChartPicture) -> NDArray[np.bool_]:
        """Return what the simulator says to the cells (n, i) of a chart.

        A row is of the true landmark that most of its observations are of.
        """
        assert self.log.ids is not None
        end = chart.begin + chart.visible.shape[1]
        landmarks, iterations = self.store.seen(0, self.store.n_iterations)
        assert np.array_equal(iterations, self.log.iteration)
        within = (iterations >= chart.begin) & (iterations < end)
        truly = np.zeros_like(chart.visible)
        for row, landmark in enumerate(chart.landmarks):
            ids = self.log.ids[within & (landmarks == landmark)]
            own = within & (self.log.ids == np.bincount(ids).argmax())
            truly[row, iterations[own] - chart.begin] = True
        return truly


@cache
def charted_run(quick: bool) -> ChartedRun:
    """Drive the figure eight and register every scan; kept for the next figure."""
    iterations = QUICK_ITERATIONS if quick else 900
    log = simulate_figure_eight(density=25, iterations=iterations).log
    store, registration = ObservationStore(), Constellation(MapperConfig().max_missed)
    for scan in log.scans():
        store.append(registration.match(scan.points_robot, None), scan.points_robot)
    return ChartedRun(log, store)


@cache
def shown_chart(quick: bool) -> ChartPicture:
    """Return the chart around the landmark whose visit is nearest to `VISIT` iterations.

    Raises
    ------
    RelmapError
        Where no landmark comes and goes within the run.
    """
    run = charted_run(quick)
    whole = [visit for visit in run.visits if visit[2] - visit[1] > 0.9 * VISIT]
    if not whole:
        raise RelmapError("no landmark comes and goes within the run: make it longer")
    seed, begin, end = min(whole, key=lambda visit: (abs(visit[2] - visit[1] - VISIT), visit[0]))
    return chart_picture(run.store, seed, begin - MARGIN, end + MARGIN)
