"""The test of a relative map for motion, and the stored status."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.grouping.chart import PointChart
from relmap.core.grouping.completion import RelativeMap, complete
from relmap.core.grouping.dynamics import FEWEST, LIMIT, STILL, DynamicStatus, rests
from relmap.core.state.table import LandmarkState

SIGMA = 0.05


def relative_map(
    landmarks: list[int], variance: list[float], end: int, n_used: int = 10
) -> RelativeMap:
    """Return a relative map of ten iterations up to `end`, with the fields that the test uses."""
    n = len(landmarks)
    places = np.random.default_rng(0).uniform(-5, 5, (n + 2, 2))
    block = np.repeat(places[:, None], 10, axis=1)
    chart = PointChart(np.arange(n + 2), np.arange(end - 9, end + 1), block)
    whole = complete(chart, places, np.zeros(n + 2, dtype=bool), np.nan)
    used = np.zeros((n, 10), dtype=bool)
    used[:, :n_used] = True
    return replace(
        whole.only(np.arange(n + 2) < n),
        landmarks=np.array(landmarks),
        variance=np.array(variance),
        amplified=np.ones(n),
        used=used,
        n_used=used.sum(axis=1),
    )


def status(n: int) -> DynamicStatus:
    table = LandmarkState()
    table.resize(n, 0, 2)
    return DynamicStatus(table)


STEADY, MOVED = 0.99 * LIMIT * SIGMA**2, 1.01 * LIMIT * SIGMA**2


def caught(remembered: DynamicStatus, end: int) -> None:
    """Let landmark 0 be seen moving often enough to be called dynamic, at last at `end`."""
    for before in (20, 10, 0):
        moving = relative_map([0], [MOVED], end - before)
        assert remembered.test(moving, SIGMA).tolist() == [False]
    assert remembered.table.dynamic[0]


def test_the_limit_is_on_the_variance_in_units_of_the_noise() -> None:
    relative = relative_map([0, 1, 2], [STEADY, MOVED, np.nan], end=20)
    assert rests(relative, SIGMA).tolist() == [True, False, True]
    assert rests(relative, 2 * SIGMA).tolist() == [True, True, True]
    remembered = status(3)
    assert remembered.test(relative, SIGMA).tolist() == [True, False, True]
    caught(remembered, end=50)
    assert remembered.table.dynamic.tolist() == [True, False, False]


def test_landmarks_hardly_seen_are_not_classified() -> None:
    remembered = status(1)
    for end in (20, 30, 40):
        hardly = relative_map([0], [MOVED], end, FEWEST - 1)
        assert remembered.test(hardly, SIGMA).tolist() == [False]
    assert not remembered.table.dynamic[0]
    caught(remembered, end=70)


def test_a_landmark_that_moved_is_static_again_when_it_stood_still_for_long() -> None:
    remembered = status(1)
    caught(remembered, end=30)
    for end in range(40, 30 + STILL + 1, 10):
        assert remembered.test(relative_map([0], [STEADY], end), SIGMA).tolist() == [False]
        assert remembered.table.dynamic[0]
    assert remembered.test(relative_map([0], [STEADY], 31 + STILL), SIGMA).tolist() == [True]
    assert not remembered.table.dynamic[0]
    caught(remembered, end=130)
    remembered.test(relative_map([0], [STEADY], 130 + STILL), SIGMA)
    assert remembered.table.dynamic[0]


def test_a_landmark_out_of_sight_does_not_stand_still() -> None:
    remembered = status(1)
    caught(remembered, end=30)
    back = relative_map([0], [STEADY], end=30 + 3 * STILL)  # ten iterations at rest
    remembered.test(back, SIGMA)
    assert remembered.table.dynamic[0]
