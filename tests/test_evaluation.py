"""A result against a truth, on small worlds whose figures are known by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.landmarks import overlay
from relmap.io.results import Tracks
from tests.judged import TRUE_MAP, K, N, make_log, make_result, make_truth, with_table


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


@pytest.mark.parametrize("path", [True, False])
def test_ids_that_the_truth_gives_to_other_places_are_noticed(path: bool) -> None:
    truth = make_truth()
    if not path:
        truth = replace(truth, stamps_s=np.empty(0), poses=np.empty((0, 4, 4)))
    turned = replace(truth, landmark_ids=np.roll(truth.landmark_ids, 1))
    evaluation = evaluate(make_result(), turned, make_log())
    assert evaluation.landmark_rmse_m > 1
    assert f"{N} of {N} landmarks are not where their ids are" in " ".join(evaluation.notes)
    order = np.arange(N)[::-1]
    reordered = replace(
        truth,
        landmark_ids=truth.landmark_ids[order],
        landmarks_map=truth.landmarks_map[order],
        status=truth.status[order],
    )
    assert evaluate(make_result(), reordered, make_log()).notes == ()


def test_two_exchanged_ids_of_the_truth_are_noticed() -> None:
    truth = make_truth()
    ids = truth.landmark_ids.copy()
    ids[:2] = ids[1::-1]
    evaluation = evaluate(make_result(), replace(truth, landmark_ids=ids), make_log())
    assert "2 of 5 landmarks are not where their ids are" in " ".join(evaluation.notes)


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
    np.testing.assert_allclose(truth.landmarks_map, result.landmarks.position, atol=1e-12)
    np.testing.assert_allclose(truth.path_map, result.poses[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(truth.errors_map[:, 0], truth.errors_map[:, 1], atol=1e-12)
