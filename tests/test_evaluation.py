"""A result against a truth, on small worlds whose figures are known by hand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from relmap import MapperConfig, PointMapper, RelmapError
from relmap.core.landmarks import LandmarkTable
from relmap.datasets.base import ObservationLog, Scan
from relmap.evaluation.evaluate import evaluate, overlay
from relmap.evaluation.run import run_mapper, stamps_of, timing
from relmap.evaluation.truth import Truth, read_truth, write_truth
from relmap.results import Result, Tracks, read_result, write_result
from relmap.simulation import simulate_figure_eight

N, K = 5, 12
TRUE_MAP = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4], [4, 4, 4]])


def make_truth() -> Truth:
    poses = np.tile(np.eye(4), (K, 1, 1))
    poses[:, 0, 3] = np.arange(K)
    return Truth(np.arange(N), TRUE_MAP, np.full(N, "static"), np.linspace(0.0, K - 1, K), poses)


def make_log() -> ObservationLog:
    """Every landmark in every iteration."""
    return ObservationLog(
        points_robot=np.zeros((N * K, 3)),
        iteration=np.repeat(np.arange(K), N),
        rows=np.arange(N * K),
        first_iteration=0,
        end_iteration=K,
        ids=np.tile(np.arange(N), K),
    )


def make_result(label_of_id: dict[int, int] | None = None) -> Result:
    """Return a perfect result in a map frame of its own; labels are the ids plus ten."""
    log, truth = make_log(), make_truth()
    assert log.ids is not None
    turn = Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix()
    T_map_true = np.eye(4)
    T_map_true[:3, :3], T_map_true[:3, 3] = turn, [1, 2, 3]
    table = LandmarkTable(
        landmark=np.arange(N) + 10,
        position=TRUE_MAP @ turn.T + [1, 2, 3],
        sd=np.full(N, 0.1),
        observations=np.full(N, K),
        first_iteration=np.zeros(N, np.int64),
        last_iteration=np.full(N, K - 1),
        level=np.ones(N, np.int64),
        status=np.full(N, "static"),
        piece=np.zeros(N, np.int64),
    )
    tracks = Tracks(log.iteration, log.rows, log.ids + 10)
    summary = {"scans": [0, K], "association": "nearest", "dimensions": 3}
    return Result(table, tracks, truth.stamps_s, T_map_true @ truth.poses, summary)


def with_table(result: Result, **columns: NDArray[Any]) -> Result:
    return replace(result, landmarks=replace(result.landmarks, **columns))


def test_perfect_result_in_another_frame() -> None:
    evaluation = evaluate(make_result(), make_truth(), make_log())
    assert evaluation.landmark_rmse_m == pytest.approx(0, abs=1e-12)
    assert evaluation.coverage == evaluation.landmarks_per_true == evaluation.purity == 1
    assert evaluation.ate_m == pytest.approx(0, abs=1e-12)
    assert evaluation.rpe_m == pytest.approx(0, abs=1e-12)
    assert evaluation.counts == {
        "landmarks": N,
        "mapped": N,
        "true_landmarks": N,
        "matched_poses": K,
        "matched_landmarks": N,
        "identified_observations": N * K,
    }


def test_unmapped_landmark_costs_coverage_only() -> None:
    result = make_result()
    position = result.landmarks.position.copy()
    position[0] = np.nan
    status = np.array(["unmapped", *["static"] * (N - 1)])
    evaluation = evaluate(
        with_table(result, position=position, status=status), make_truth(), make_log()
    )
    assert evaluation.coverage == pytest.approx(4 / 5)
    assert evaluation.landmark_rmse_m == pytest.approx(0, abs=1e-12)
    assert evaluation.landmarks_per_true == 1


def test_landmark_found_twice() -> None:
    result = make_result()
    tracks, table = result.tracks, result.landmarks
    # The later half of landmark 10 becomes another one, 15, in the same place.
    late = (tracks.landmark == 10) & (tracks.iteration >= K // 2)
    columns = {
        name: np.append(getattr(table, name), getattr(table, name)[:1])
        for name in ("sd", "observations", "first_iteration", "last_iteration", "level", "status")
    }
    table = replace(
        table,
        landmark=np.arange(N + 1) + 10,
        position=np.vstack([table.position, table.position[:1]]),
        **columns,
    )
    tracks = replace(tracks, landmark=np.where(late, 15, tracks.landmark))
    evaluation = evaluate(replace(result, tracks=tracks, landmarks=table), make_truth(), make_log())
    assert evaluation.landmarks_per_true == pytest.approx(6 / 5)
    assert evaluation.purity == 1
    assert evaluation.coverage == 1
    assert evaluation.counts["matched_landmarks"] == N + 1


def test_mixed_up_observations_cost_purity() -> None:
    result = make_result()
    landmark = result.tracks.landmark.copy()
    landmark[:2] = landmark[1::-1]
    mixed = replace(result, tracks=replace(result.tracks, landmark=landmark))
    assert evaluate(mixed, make_truth(), make_log()).purity == pytest.approx(1 - 2 / (N * K))


def test_rmse_in_closed_form() -> None:
    result = make_result()
    # A cross blown up by a tenth: each of its ends is off by a tenth, the fit moves nothing.
    cross = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 0]])
    truth = replace(make_truth(), landmarks_map=cross)
    evaluation = evaluate(with_table(result, position=1.1 * cross), truth, make_log())
    assert evaluation.landmark_rmse_m == pytest.approx(0.1 * np.sqrt(4 / 5))


@pytest.mark.parametrize("of", ["truth", "result"])
def test_dynamic_landmarks_are_left_out_of_the_rmse(of: str) -> None:
    result, truth = make_result(), make_truth()
    status = np.array(["dynamic", *["static"] * (N - 1)])
    landmarks_map = TRUE_MAP.copy()
    landmarks_map[0] += 100
    truth = replace(truth, landmarks_map=landmarks_map)
    if of == "truth":
        truth = replace(truth, status=status)
    else:
        result = with_table(result, status=status)
    evaluation = evaluate(result, truth, make_log())
    assert evaluation.landmark_rmse_m == pytest.approx(0, abs=1e-12)
    assert evaluation.coverage == 1
    assert evaluation.counts["matched_landmarks"] == N - 1


def test_coverage_asks_for_ten_iterations_within_the_scans_mapped() -> None:
    log, result = make_log(), make_result()
    mapped = result.tracks.iteration < 9
    tracks = Tracks(*(getattr(result.tracks, f)[mapped] for f in ("iteration", "row", "landmark")))
    short = replace(result, tracks=tracks, summary=result.summary | {"scans": [0, 9]})
    assert evaluate(short, make_truth(), log).coverage is None


def test_planar_result_is_fitted_in_the_plane() -> None:
    result = make_result()
    flat = TRUE_MAP * [1, 1, 0]
    turn = Rotation.from_rotvec([0, 0, 1]).as_matrix()
    poses = make_truth().poses
    moved = poses.copy()
    moved[:, :3, :3] = turn @ poses[:, :3, :3]
    moved[:, :3, 3] = poses[:, :3, 3] @ turn.T + [1, 1, 0]
    planar = replace(
        with_table(result, position=flat @ turn.T + [1, 1, 0]),
        poses=moved,
        summary=result.summary | {"dimensions": 2},
    )
    evaluation = evaluate(planar, replace(make_truth(), landmarks_map=flat), make_log())
    assert evaluation.landmark_rmse_m == pytest.approx(0, abs=1e-12)
    assert evaluation.ate_m == pytest.approx(0, abs=1e-12)
    assert evaluation.rpe_m == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("log", [None, replace(make_log(), ids=None)])
def test_without_ids_only_the_path_is_judged(log: ObservationLog | None) -> None:
    evaluation = evaluate(make_result(), make_truth(), log)
    assert evaluation.landmark_rmse_m is None
    assert evaluation.coverage is None
    assert evaluation.landmarks_per_true is None
    assert evaluation.purity is None
    assert evaluation.ate_m == pytest.approx(0, abs=1e-12)
    assert overlay(make_result(), make_truth(), log) is None


def test_labels_are_ids_where_the_association_was_known() -> None:
    result = make_result()
    known = replace(
        with_table(result, landmark=np.arange(N)),
        tracks=replace(result.tracks, landmark=result.tracks.landmark - 10),
        summary=result.summary | {"association": "known"},
    )
    evaluation = evaluate(known, make_truth())
    assert evaluation.landmark_rmse_m == pytest.approx(0, abs=1e-12)
    assert evaluation.purity == evaluation.coverage == 1


def test_truth_of_landmarks_only() -> None:
    truth = replace(make_truth(), stamps_s=np.empty(0), poses=np.empty((0, 4, 4)))
    evaluation = evaluate(make_result(), truth, make_log())
    assert evaluation.ate_m is None
    assert evaluation.rpe_m is None
    assert evaluation.landmark_rmse_m == pytest.approx(0, abs=1e-12)


def test_truth_without_the_landmarks_seen() -> None:
    truth = replace(make_truth(), landmark_ids=np.arange(N) + 100)
    evaluation = evaluate(make_result(), truth, make_log())
    assert evaluation.landmark_rmse_m is None
    assert evaluation.coverage is None
    empty = replace(
        truth,
        landmark_ids=np.empty(0, np.int64),
        landmarks_map=np.empty((0, 3)),
        status=np.empty(0, np.str_),
    )
    assert evaluate(make_result(), empty, make_log()).landmark_rmse_m is None


@pytest.mark.parametrize("change", ["rows", "iterations", "length"])
def test_another_log_is_refused(change: str) -> None:
    log = make_log()
    if change == "rows":
        log = replace(log, rows=log.rows + 1)
    elif change == "iterations":
        log = replace(log, iteration=np.sort(np.tile(log.iteration[::N], N) // 2))
    else:
        log = log.between(0, 5)
    with pytest.raises(RelmapError, match="not the one that was mapped"):
        evaluate(make_result(), make_truth(), log)


def test_overlay_lies_on_the_map() -> None:
    result = make_result()
    truth = overlay(result, make_truth(), make_log())
    assert truth is not None
    np.testing.assert_allclose(truth.landmarks_map, result.landmarks.position, atol=1e-12)
    np.testing.assert_allclose(truth.path_map, result.poses[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(truth.errors_map[:, 0], truth.errors_map[:, 1], atol=1e-12)


def test_truth_comes_back_bit_by_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    truth = replace(make_truth(), landmarks_map=rng.normal(size=(N, 3)))
    (tmp_path / "truth").mkdir()
    write_truth(tmp_path / "truth", truth)
    for path in (tmp_path, tmp_path / "truth"):
        again = read_truth(path)
        np.testing.assert_array_equal(again.landmarks_map, truth.landmarks_map)
        np.testing.assert_array_equal(again.landmark_ids, truth.landmark_ids)
        np.testing.assert_array_equal(again.poses, truth.poses)


def test_mrpt_truth(shared_data: Path) -> None:
    folder = shared_data / "mrpt-kf-slam"
    truth = read_truth(folder / "kf-slam_demo_ground_truth.txt")
    assert len(truth.landmark_ids) == 70
    assert truth.stamps_s.tolist() == list(range(250))
    assert set(truth.status) == {"static"}


def test_result_comes_back_bit_by_bit(tmp_path: Path) -> None:
    result = make_result()
    position = result.landmarks.position.copy()
    position[1] = np.nan
    result = with_table(result, position=position)
    write_result(tmp_path, result)
    again = read_result(tmp_path)
    for name in ("landmark", "position", "sd", "observations", "level", "status"):
        np.testing.assert_array_equal(
            getattr(again.landmarks, name), getattr(result.landmarks, name)
        )
    np.testing.assert_array_equal(again.tracks.landmark, result.tracks.landmark)
    np.testing.assert_array_equal(again.poses[:, :, 3], result.poses[:, :, 3])
    assert again.summary == result.summary


def test_run_tells_what_happened() -> None:
    log = simulate_figure_eight(density=10, iterations=40).log
    seen: list[int] = []

    def watch(scans: Iterable[Scan]) -> Iterator[Scan]:
        for scan in scans:
            seen.append(scan.iteration)
            yield scan

    run = run_mapper(
        PointMapper(MapperConfig(group_after=4)),
        log.between(10, 40),
        "known",
        {"input": "x"},
        watch,
    )
    summary, table = run.result.summary, run.result.landmarks
    assert seen == list(range(10, 40))
    assert summary["scans"] == [10, 40]
    assert summary["input"] == "x"
    assert (
        summary["counts"]["observations"] == table.observations.sum() == (log.iteration >= 10).sum()
    )
    assert summary["counts"]["landmarks"] == len(table.landmark)
    assert table.first_iteration.min() == 10
    assert table.last_iteration.max() == 39
    assert run.result.stamps_s.tolist() == list(range(10, 40))
    assert len(run.groups) == summary["counts"]["groups"] > 0
    assert all(np.isin(group, table.landmark).all() for group in run.groups)


def test_nearest_keeps_the_ids_from_the_mapper() -> None:
    log = simulate_figure_eight(density=10, iterations=30).log
    with_ids = run_mapper(PointMapper(), log, "nearest").result
    without = run_mapper(PointMapper(), replace(log, ids=None), "nearest").result
    np.testing.assert_array_equal(with_ids.tracks.landmark, without.tracks.landmark)
    np.testing.assert_array_equal(with_ids.landmarks.position, without.landmarks.position)


def test_unidentified_observations_have_no_track() -> None:
    log = simulate_figure_eight(density=10, iterations=30).log
    assert log.ids is not None
    ids = log.ids.copy()
    ids[::7] = -1
    tracks = run_mapper(PointMapper(), replace(log, ids=ids), "known").result.tracks
    np.testing.assert_array_equal(tracks.row, np.flatnonzero(ids >= 0))
    np.testing.assert_array_equal(tracks.landmark, ids[ids >= 0])


def test_known_needs_ids() -> None:
    log = replace(simulate_figure_eight(density=10, iterations=5).log, ids=None)
    with pytest.raises(RelmapError, match="ids"):
        run_mapper(PointMapper(), log, "known")


def test_stamps_are_those_of_the_clock_where_there_is_one() -> None:
    log = make_log()
    assert stamps_of(log.between(3, 5)).tolist() == [3.0, 4.0]
    clocked = replace(log, stamps_s=np.arange(K) / 4)
    assert stamps_of(clocked.between(3, 5)).tolist() == [0.75, 1.0]


def test_timing_in_milliseconds() -> None:
    durations_s = np.concatenate([np.full(100, 1e-3), np.full(300, 2e-3), np.full(100, 3e-3)])
    assert timing(durations_s) == pytest.approx(
        {"median_ms": 2, "p95_ms": 3, "first_100_median_ms": 1, "last_100_median_ms": 3}
    )
    assert set(timing(np.empty(0)).values()) == {None}
