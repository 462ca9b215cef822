from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from relmap.core.arrays import Floats
from relmap.core.grouping.chart import PointChart, grow_group
from relmap.core.state.store import ObservationStore

visibility = st.integers(1, 8).flatmap(
    lambda n: st.lists(st.lists(st.booleans(), min_size=n, max_size=n), min_size=1, max_size=12)
)


def filled_store(visible: list[list[bool]]) -> tuple[ObservationStore, np.ndarray]:
    """Store iterations x landmarks of visibility; return it and the dense table (NaN = unseen)."""
    rng = np.random.default_rng(0)
    seen = np.array(visible)
    table = np.where(seen[:, :, None], rng.normal(size=(*seen.shape, 3)), np.nan)
    store = ObservationStore()
    for row, points in zip(seen, table, strict=True):
        landmarks = rng.permutation(np.flatnonzero(row))
        store.append(landmarks, points[landmarks])
    return store, table


@given(visibility, st.data())
def test_chart_shows_landmarks_visible_with_the_seed(
    visible: list[list[bool]], data: st.DataObject
) -> None:
    store, table = filled_store(visible)
    begin = data.draw(st.integers(0, len(visible) - 1))
    window = np.array(visible)[begin:]
    candidates = np.flatnonzero(window.any(axis=0))
    if not len(candidates):
        return
    seed = int(data.draw(st.sampled_from(candidates.tolist())))
    chart = PointChart.around(seed, store, begin, len(visible))
    when = np.flatnonzero(window[:, seed])
    assert chart.landmarks[0] == seed
    np.testing.assert_array_equal(chart.iterations, when + begin)
    together = np.flatnonzero(window[when].any(axis=0))
    np.testing.assert_array_equal(np.sort(chart.landmarks), together)
    np.testing.assert_array_equal(chart.visible, window[when].T[chart.landmarks])
    there = table[begin:][when].transpose(1, 0, 2)[chart.landmarks]
    np.testing.assert_array_equal(chart.points_robot, there)
    np.testing.assert_array_equal(chart.common_interval, window[when].sum(axis=0)[chart.landmarks])


def paper_chart() -> PointChart:
    """Return a chart like that of Fig. 9 (0-based: the paper's point four is landmark 3)."""
    rows = [
        "....xxxxxx......",
        "..xxxxxxxx......",
        "..xxxxxxxxx.....",
        "..xxxxxxxxxx....",
        ".....xxxxxxxxxxx",
        "xxxxx...........",
        "..x......x.x....",
        "...xxxxxxxx.....",
    ]
    visible = [[row[i] == "x" for row in rows] for i in range(len(rows[0]))]
    store, _ = filled_store(visible)
    return PointChart.around(3, store, 0, len(visible))


def test_chart_sorts_by_common_interval_as_in_figure_10() -> None:
    chart = paper_chart()
    order = np.argsort(-chart.common_interval, kind="stable")
    assert chart.landmarks[order].tolist() == [3, 2, 1, 7, 4, 0, 5, 6]


def grown(
    chart: PointChart, weights: Floats, min_members: int, min_shared: int
) -> tuple[list[int], list[int]] | None:
    """Grow a group of all candidates; return its landmarks and iterations."""
    everybody = np.arange(len(chart.landmarks))
    group = grow_group(chart, everybody, weights, min_members, min_shared)
    if group is None:
        return None
    return chart.landmarks[group.rows].tolist(), chart.iterations[group.columns].tolist()


def test_group_grows_to_the_largest_area_as_in_figure_11() -> None:
    group = grown(paper_chart(), np.zeros(8), min_members=4, min_shared=0)
    # Areas down the chart: 10, 18, 24, 28 (landmarks 3 2 1 7, iterations 3-9), 5 x 5 = 25, 30.
    assert group == ([3, 2, 1, 7, 4, 0], [5, 6, 7, 8, 9])


def test_only_candidates_become_members() -> None:
    chart = paper_chart()
    candidates = np.flatnonzero(np.isin(chart.landmarks, [3, 2, 1, 7]))
    group = grow_group(chart, candidates, np.zeros(8), min_members=4, min_shared=0)
    assert set(chart.landmarks[group.rows].tolist()) == {3, 2, 1, 7}
    assert grow_group(chart, candidates[:3], np.zeros(8), min_members=4, min_shared=0) is None


def test_group_reaches_down_to_the_mapped_landmarks_that_fix_it() -> None:
    chart = paper_chart()
    weights = np.where(np.isin(chart.landmarks, [2, 1, 5]), 9.0, 0.0)
    # 5 left the view before the others came: nothing in common.
    assert grown(chart, weights, min_members=4, min_shared=3) is None
    weights = np.where(np.isin(chart.landmarks, [2, 1, 0]), 9.0, 0.0)
    group = grown(chart, weights, min_members=4, min_shared=3)
    assert {0, 1, 2, 3} <= set(group[0])


@given(visibility, st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_every_member_is_visible_in_the_whole_common_interval(
    visible: list[list[bool]], min_shared: int, seed: int
) -> None:
    store, table = filled_store(visible)
    weights = np.random.default_rng(seed).integers(0, 3, table.shape[1]).astype(float)
    for landmark in np.unique(store.column("landmark")):
        chart = PointChart.around(int(landmark), store, 0, len(visible))
        group = grown(chart, weights[chart.landmarks], min_shared + 1, min_shared)
        if group is None:
            continue
        members, iterations = map(np.array, group)
        assert np.isfinite(table[iterations][:, members]).all()
        assert len(members) > min_shared
        assert np.sum(weights[members] > 0) >= min_shared
