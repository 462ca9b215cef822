"""The point chart around one landmark of a run without ids: data of figures 9 to 11."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from relmap.core.arrays import Bools, Ints
from relmap.core.association import Constellation
from relmap.core.config import MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.grouping.chart import PointChart, grow_group
from relmap.core.state.store import ObservationStore
from relmap.datasets.base import ObservationLog
from relmap.simulation import simulate_figure_eight

ITERATIONS, QUICK_ITERATIONS = 900, 300
VISIT = 100
"""Preferred number of iterations in which the seed is in view."""
MARGIN = 20
"""Number of iterations shown before and after."""
FEWEST_MEMBERS = 4
"""Minimum number of landmarks in a group, as in section III."""


@dataclass(frozen=True, eq=False)
class ChartPicture:
    """A window of the point chart around a seed, and the group grown in it.

    `begin`: first iteration of the window; `landmarks` (n,): the seed and all landmarks visible
    together with it, sorted by the interval in common with the seed: the seed first; `visible`
    (n, i): one column for each iteration of the window; `members`: number of landmarks in the
    group, from the first on.
    """

    begin: int
    landmarks: Ints
    visible: Bools
    members: int

    @property
    def seed(self) -> int:
        """The seed of the chart."""
        return int(self.landmarks[0])

    @property
    def common_interval(self) -> Ints:
        """Number of iterations in common with the seed; (n,)."""
        return np.asarray((self.visible & self.visible[0]).sum(axis=1))

    @property
    def group_interval(self) -> Bools:
        """Iterations in which all members of the group were visible; (i,)."""
        return np.asarray(self.visible[: self.members].all(axis=0))

    @property
    def area(self) -> Ints:
        """Members x common interval of the first 1, 2, ... landmarks; (n,)."""
        together = np.logical_and.accumulate(self.visible, axis=0)
        return np.asarray(np.arange(1, len(together) + 1) * together.sum(axis=1))


def chart_picture(store: ObservationStore, seed: int, begin: int, end: int) -> ChartPicture:
    """Chart iterations around a seed, and grow its group; RelmapError if there is none."""
    chart = PointChart.around(seed, store, begin, end)
    rows, unmapped = np.arange(len(chart.landmarks)), np.zeros(len(chart.landmarks))
    group = grow_group(chart, rows, unmapped, FEWEST_MEMBERS, 0) if len(rows) else None
    if group is None:
        raise RelmapError(f"landmark {seed} makes no group in iterations {begin} to {end - 1}")
    landmarks = chart.landmarks[np.argsort(-chart.common_interval, kind="stable")]  # Fig. 10
    seen, iterations = store.seen(begin, end)
    window = np.arange(begin, end)
    visible = np.array([np.isin(window, iterations[seen == each]) for each in landmarks])
    return ChartPicture(begin, landmarks, visible, members=len(group.rows))


def paper_stops(area: Ints) -> int:
    """Return the group size by the paper's rule: up to the first that adds no area (n,)."""
    falls = np.flatnonzero(np.diff(area[FEWEST_MEMBERS - 1 :]) <= 0)
    return int(falls[0]) + FEWEST_MEMBERS if len(falls) else len(area)


@dataclass(frozen=True, eq=False)
class ChartedRun:
    """A figure eight with the true ids, and the store of its registration without them."""

    log: ObservationLog
    store: ObservationStore

    @property
    def visits(self) -> list[tuple[int, int, int]]:
        """Landmark, start and end of every visit well within the run."""
        landmarks, iterations = self.store.seen(0, self.store.n_iterations)
        order = np.argsort(landmarks, kind="stable")
        bounds = np.searchsorted(landmarks[order], np.arange(landmarks.max(initial=-1) + 2))
        seen = {n: iterations[order[a:b]] for n, (a, b) in enumerate(pairwise(bounds)) if a < b}
        visits = [(n, int(when[0]), int(when[-1]) + 1) for n, when in seen.items()]
        latest = self.store.n_iterations - MARGIN
        return [visit for visit in visits if visit[1] >= MARGIN and visit[2] <= latest]

    def truly_visible(self, chart: ChartPicture) -> Bools:
        """Return which cells (n, i) of a chart are truly visible.

        A row belongs to the true landmark of most of its observations.
        """
        ids = self.log.ids
        assert ids is not None
        end = chart.begin + chart.visible.shape[1]
        landmarks, iterations = self.store.seen(0, self.store.n_iterations)
        assert np.array_equal(iterations, self.log.iteration)
        within = (iterations >= chart.begin) & (iterations < end)
        truly = np.zeros_like(chart.visible)
        for row, landmark in enumerate(chart.landmarks):
            own = within & (ids == np.bincount(ids[within & (landmarks == landmark)]).argmax())
            truly[row, iterations[own] - chart.begin] = True
        return truly


@cache
def charted_run(quick: bool) -> ChartedRun:
    """Simulate the figure eight, short or in full, and register every scan; cached."""
    iterations = QUICK_ITERATIONS if quick else ITERATIONS
    log = simulate_figure_eight(density=25, iterations=iterations).log
    store, registration = ObservationStore(), Constellation(MapperConfig().max_missed)
    for scan in log.scans():
        store.append(registration.match(scan.points_robot, None), scan.points_robot)
    return ChartedRun(log, store)


@cache
def shown_chart(quick: bool) -> ChartPicture:
    """Return the chart around the landmark whose visit is nearest to `VISIT` iterations.

    Raises `RelmapError` if no landmark comes and goes within the run.
    """
    run = charted_run(quick)
    whole = [visit for visit in run.visits if visit[2] - visit[1] > 0.9 * VISIT]
    if not whole:
        raise RelmapError("no landmark comes and goes within the run: make it longer")
    seed, begin, end = min(whole, key=lambda visit: (abs(visit[2] - visit[1] - VISIT), visit[0]))
    return chart_picture(run.store, seed, begin - MARGIN, end + MARGIN)
