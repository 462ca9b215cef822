"""Results and truths come back from their files."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from relmap.evaluation.truth import read_truth, write_truth
from relmap.io.results import read_result, write_result
from tests.judged import N, make_result, make_truth, with_table


def test_truth_comes_back_bit_by_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    truth = replace(make_truth(), landmarks_map=rng.normal(size=(N, 3)))
    (tmp_path / "truth").mkdir()
    write_truth(tmp_path / "truth", truth)
    for path in (tmp_path, tmp_path / "truth"):
        again = read_truth(path)
        np.testing.assert_array_equal(again.landmarks_map, truth.landmarks_map)
        np.testing.assert_array_equal(again.landmark_ids, truth.landmark_ids)
        np.testing.assert_array_equal(again.status, truth.status)
        np.testing.assert_array_equal(again.stamps_s, truth.stamps_s)
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
    for found, given in ((again.landmarks, result.landmarks), (again.tracks, result.tracks)):
        for column in fields(given):
            np.testing.assert_array_equal(getattr(found, column.name), getattr(given, column.name))
    np.testing.assert_array_equal(again.stamps_s, result.stamps_s)
    np.testing.assert_array_equal(again.poses[:, :, 3], result.poses[:, :, 3])
    np.testing.assert_allclose(again.poses, result.poses, rtol=0, atol=1e-15)
    assert again.summary == result.summary


def test_columns_beyond_the_contract_may_be_missing(tmp_path: Path) -> None:
    result = make_result()
    position = result.landmarks.position.copy()
    position[1] = np.nan
    write_result(tmp_path, with_table(result, position=position))
    path = tmp_path / "landmarks.csv"
    lines = [line.rsplit(",", 2)[0] for line in path.read_text().splitlines()]
    assert lines[0].endswith(",level,status")
    path.write_text("\n".join(lines) + "\n")
    landmarks = read_result(tmp_path).landmarks
    assert landmarks.submap.tolist() == [0, -1] + [0] * (N - 2)
    assert set(landmarks.moving_bin) == {-1}
