"""Each figure of the paper: the data in its tables, and its verdict from numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from relmap import MapperConfig, PointMapper
from relmap.core.errors import RelmapError
from relmap.core.geometry.alignment import fit_rigid
from relmap.figures import (
    figure05,
    figure09_11,
    figure12,
    figure13,
    figure14_15,
    figure16,
    figure17,
)
from relmap.figures.base import judged, n_log_n
from relmap.figures.figure12 import Comparisons
from relmap.figures.figure14_15 import LoopTiming, median_times
from relmap.figures.figure16 import ErrorCurves
from relmap.figures.figure17 import Panel
from relmap.figures.making import FIGURES, chosen_figures
from relmap.figures.point_chart import MARGIN, ChartedRun, charted_run
from relmap.simulation import simulate_building, simulate_figure_eight
from tests import tinyfigures as tiny
from tests.tinyfigures import SEEN
from tests.worlds import refined, seen

YES, PARTLY, NO = "borne out", "partly borne out", "not borne out"


def test_a_claim_is_judged_by_its_parts() -> None:
    assert judged(True, True) == YES
    assert judged(True, False) == judged(False, True) == PARTLY
    assert judged(False, False) == judged(False) == NO


def test_figures_come_in_the_papers_order_each_once() -> None:
    every = [figure.name for figure in chosen_figures([])]
    assert every == ["4", "5", "6", "7", *map(str, range(9, 18))]
    assert [figure.name for figure in chosen_figures(["16", "04", "crossing", "4"])] == [
        "4",
        "crossing",
        "16",
    ]
    assert len({figure.claim for figure in FIGURES}) == len(FIGURES)


@pytest.mark.parametrize(
    ("name", "said"),
    [("8", "is a sketch"), ("18", "no figure '18'"), ("-4", "no figure '-4'"), ("", "no figure")],
)
def test_unknown_figures_are_refused(name: str, said: str) -> None:
    with pytest.raises(RelmapError, match=said):
        chosen_figures(["4", name])


# Figure 5.


def test_bench_shows_the_true_walls_and_an_animation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figure05, "QUICK_ITERATIONS", 12)
    monkeypatch.setattr("relmap.plots.bench.HOLD", 1)
    found = figure05.FIGURE.judge(figure05.FIGURE.run(True, None, iter))
    walls = simulate_building(iterations=12).walls[:, :4]
    told = [row[2:] for row in found.table.rows if row[0] == "true wall"]
    np.testing.assert_array_equal(np.array(told, dtype=np.float64), walls)
    assert found.verdict == judged(found.value < 0.05, "100%" in found.ours)
    found.more[".gif"](tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as image:
        assert getattr(image, "n_frames", 1) >= 6


# Figures 9 to 11.


def test_chart_holds_what_was_visible() -> None:
    found = figure09_11.CHART.judge((tiny.chart(), ChartedRun(tiny.log(), tiny.store())))
    assert (found.verdict, found.value) == (YES, 1.0)
    rows = np.array(found.table.rows)
    assert {(landmark, k) for _, landmark, k, _ in rows.tolist()} == {
        (landmark, k) for landmark in (0, 1, 2, 3, 4, 6) for k in SEEN[landmark]
    }
    assert all(within == (k in SEEN[2]) for _, _, k, within in rows.tolist())


def test_cells_of_another_landmark_are_wrong() -> None:
    log = tiny.log()
    assert log.ids is not None
    ids = np.where((log.ids == 3) & (log.iteration > 4), 99, log.ids)
    run = ChartedRun(replace(log, ids=ids), tiny.store())
    found = figure09_11.CHART.judge((tiny.chart(), run))
    assert found.value == pytest.approx(1 - 2 / 48)  # iterations 5 and 6 of 6 landmarks x 8
    assert found.verdict == PARTLY


def test_sorted_rows_share_less_and_less_with_the_seed() -> None:
    found = figure09_11.SORTED.judge(tiny.chart())
    rows = np.array(found.table.rows)
    shared = np.bincount(rows[:, 0], weights=rows[:, 3])
    assert shared.tolist() == [6, 6, 5, 5, 5, 3]
    assert (found.verdict, found.value) == (YES, 5.0)


def test_rule_of_the_paper_is_compared_with_the_largest_area() -> None:
    found = figure09_11.GROUP.judge([tiny.chart(), tiny.chart()])
    assert (found.verdict, found.value) == (YES, 1.0)
    assert [row[3] for row in found.table.rows] == [6, 12, 15, 16, 20, 12]
    stops_early = figure09_11.GROUP.judge([tiny.chart(), tiny.dipping_chart()])
    assert stops_early.value == pytest.approx(16 / 18)
    assert stops_early.verdict == NO
    half = figure09_11.GROUP.judge([tiny.chart(), tiny.dipping_chart(), tiny.chart()])
    assert half.value == pytest.approx((16 / 18 + 1) / 2)
    assert half.verdict == PARTLY


def test_visits_lie_within_the_run() -> None:
    run = charted_run(True)
    landmarks, iterations = run.store.seen(0, run.store.n_iterations)
    assert len(run.visits) > 10
    for landmark, begin, end in run.visits:
        when = iterations[landmarks == landmark]
        assert (when.min(), when.max() + 1) == (begin, end)
        assert begin >= MARGIN
        assert end <= run.store.n_iterations - MARGIN


# Figure 12.


def test_comparisons_are_judged_up_to_forty_percent() -> None:
    data = tiny.comparisons()
    every = np.ones_like(data.right)
    good = Comparisons(data.n, data.dynamic, data.comparisons, every)
    found = figure12.FIGURE.judge(good)
    assert found.verdict == YES  # 1.1 n log n at 70 % does not count
    assert found.value == (data.comparisons[:2] / n_log_n(data.n)[:, None]).max()
    assert len(found.table.rows) == data.right.size
    many = replace(good, comparisons=2 * data.comparisons)
    assert figure12.FIGURE.judge(many).verdict == PARTLY
    assert figure12.FIGURE.judge(replace(many, right=~every)).verdict == NO


def test_landmarks_of_small_worlds_are_sorted() -> None:
    data = figure12.sorted_worlds((20, 50), 2)
    assert np.all(data.comparisons <= n_log_n(data.n)[:, None])
    assert np.all(data.comparisons >= np.array([19, 49])[:, None] // 2)
    assert data.right[:3].mean() > 0.8


def test_blocks_have_the_share_that_moves() -> None:
    pool, static = figure12.observed_places(0, 50)
    block, at_rest = figure12.block_of(30, 0.4, pool, static, 0)
    assert (~at_rest).sum() == 12
    # Static or moving, a landmark is one of the pool's, with noise.
    apart = np.linalg.norm(block[:, None] - pool, axis=3).max(axis=2)
    nearest = apart.argmin(axis=1)
    assert np.all(apart.min(axis=1) < 6 * np.sqrt(3) * figure12.SIGMA_M)
    assert len(np.unique(nearest)) == 30
    np.testing.assert_array_equal(static[nearest], at_rest)


# Figure 13.


def test_a_map_of_the_eight_is_judged_by_error_and_merging() -> None:
    judge, good = figure13.FIGURE.judge, {"landmark_rmse_m": 0.02, "coverage": 1.0, "ate_m": 0.05}
    found = judge(tiny.eight(**good, landmarks_per_true=1.05))
    assert (found.verdict, found.value) == (YES, 0.02)
    assert len(found.table.rows) == 12 + 9 + 12 + 9
    assert judge(tiny.eight(**good, landmarks_per_true=1.3)).verdict == PARTLY
    assert judge(tiny.eight(**good | {"coverage": 0.5}, landmarks_per_true=1.05)).verdict == PARTLY


# Figures 14 and 15.


def test_a_loop_is_flat_in_median_and_mean() -> None:
    data = tiny.loop()
    found = figure14_15.LOOP.judge(data)
    assert (found.verdict, found.value) == (YES, 1.0)
    assert [row[1] for row in found.table.rows] == data.time_ms.tolist()
    spikes = np.where((np.arange(80) % 10 == 0) & (np.arange(80) > 50), 50.0, 1.0)
    assert figure14_15.LOOP.judge(replace(data, time_ms=spikes)).verdict == PARTLY
    slower = LoopTiming(np.arange(80.0) + 1, data.visible, data.landmarks, data.true_landmarks)
    assert figure14_15.LOOP.judge(slower).verdict == NO


def test_landmarks_seen_so_far_are_counted() -> None:
    log = tiny.log()
    so_far = [len({i for i, when in SEEN.items() if when[0] <= k}) for k in range(8)]
    assert figure14_15.seen_so_far(log.ids, log).tolist() == so_far


def test_growth_is_compared_with_n_log_n() -> None:
    data = tiny.densities()
    found = figure14_15.VISIBLE.judge(data)
    assert found.verdict == YES
    bound = 640 * np.log2(640) / (160 * np.log2(160))
    assert found.value == pytest.approx(data.median_ms[-1] / data.median_ms[-2] / bound)
    assert figure14_15.VISIBLE.judge(replace(data, mean_ms=data.visible**2)).verdict == PARTLY
    assert figure14_15.VISIBLE.judge(tiny.densities(power=2)).verdict == NO


def test_every_iteration_is_timed() -> None:
    log = simulate_figure_eight(density=20, iterations=30).log
    times_ms = median_times(log, 3)
    assert times_ms.shape == (30,)
    assert np.all(times_ms >= 0)


# Figure 16.


def errors(paper: tuple[float, float]) -> ErrorCurves:
    others = {figure16.FITTED: (0.02, 0.02), figure16.LIVE: (0.03, 0.03)}
    others |= {figure16.SHAPED: (0.02, 0.01), figure16.MRPT: (0.04, 0.04)}
    return tiny.errors(**{figure16.PAPER: paper}, **others)


def test_margins_over_the_ekf_are_judged_noise_by_noise() -> None:
    found = figure16.FIGURE.judge(errors((0.04, 0.03)))
    assert found.verdict == PARTLY
    assert found.value == pytest.approx(4 / 3)
    assert "Under flat noise there is no wide margin" in found.ours
    assert "0.25 times the error of that EKF and 0.50 times" in found.ours
    assert figure16.FIGURE.judge(errors((0.04, 0.02))).verdict == YES
    assert figure16.FIGURE.judge(errors((0.06, 0.03))).verdict == NO
    assert len(found.table.rows) == 2 * 5 * 3 * 2
    assert all(len(row) == len(found.table.columns) for row in found.table.rows)
    assert not any("," in str(cell) for row in found.table.rows for cell in row)


def test_curves_end_at_the_errors_of_the_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = (figure16.PAPER, figure16.SHAPED)
    monkeypatch.setattr(figure16, "METHODS", {name: figure16.METHODS[name] for name in kept})
    data = figure16.error_curves(1, 100)
    world = simulate_figure_eight(iterations=100, noise="uniform", seed=0)
    mapper = refined(PointMapper(MapperConfig(keep_observations=True)), seen(world.log))
    there = world.landmarks_map[mapper.map.landmark_ids]
    R, t = fit_rigid(mapper.map.positions, there)
    off = mapper.map.positions @ R.T + t - there
    curve = data["flat"][figure16.SHAPED]
    assert curve.iteration.tolist() == [99]
    assert curve.end_m == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()))
    assert data["Gaussian"][figure16.PAPER].iteration.tolist() == list(range(9, 100, 10))


# Figure 17.


def panel(rmse_m: float, coverage: float) -> Panel:
    places = np.arange(6.0).reshape(3, 2)
    often = np.array([True, True, False])
    return Panel("scans 0 to 9\nas it is", places, places, often, places[:2], rmse_m, coverage)


def test_stretches_are_judged_one_by_one() -> None:
    good, far, gone = panel(0.2, 1.0), panel(2.0, 1.0), panel(0.1, 0.3)
    found = figure17.FIGURE.judge([good, good])
    assert (found.verdict, found.value) == (YES, 0.2)
    assert found.ours == "Scans 0 to 9, as it is. Scans 0 to 9, as it is."
    assert figure17.FIGURE.judge([good, far]).verdict == PARTLY
    assert figure17.FIGURE.judge([gone, far]).verdict == NO
    assert len(found.table.rows) == 2 * (3 + 3 + 2)
    assert [row[2] for row in found.table.rows if row[1] == "reference"] == [1, 1, 0] * 2


def test_victoria_park_from_its_folder_or_the_one_above(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = figure17.victoria_park(shared_data)
    inner = figure17.victoria_park(shared_data / "victoria-park")
    assert len(whole) == len(inner) == 7249
    monkeypatch.setattr(figure17, "INTERVALS", figure17.INTERVALS[:1])
    found = figure17.FIGURE.judge(figure17.FIGURE.run(True, shared_data, iter))
    assert found.verdict == YES
    assert found.value < 0.5
    trees = [row for row in found.table.rows if row[:2] == (0, "tree")]
    assert len(trees) >= 86  # of scans 1181 to 1641, where 88 are seen ten times


def test_victoria_park_without_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RelmapError, match="needs the Victoria Park data"):
        figure17.FIGURE.run(True, None, iter)
    with pytest.raises(RelmapError):
        figure17.FIGURE.run(True, tmp_path / "nowhere", iter)
