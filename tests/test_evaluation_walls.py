"""Wall recall, precision and doubled length, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.evaluation.truth import Truth
from relmap.evaluation.walls import doubled_length, judge_corners, judge_walls, match_corners
from relmap.planes.walls.table import PlaneTable
from tests.tables import poses_along, wall_table
from tests.worlds import turn

POSES = poses_along([0.0, 2.0, 2.0], [0.0, 0.0, 3.0])


def segments(*rows: tuple[float, float, float, float]) -> Floats:
    return np.array(rows, dtype=np.float64).reshape(-1, 2, 2)


def table(ends: Floats, status: str = "static") -> PlaneTable:
    return wall_table(ends, status=np.full(len(ends), status))


def judged(
    mapped: Floats, true: Floats, seen_m: Floats | None = None
) -> tuple[float | None, float | None]:
    length = np.linalg.norm(true[:, 1] - true[:, 0], axis=1)
    whole = np.column_stack([0 * length, length])
    truth = Truth(ends=true, seen_m=whole if seen_m is None else seen_m)
    told = judge_walls(table(mapped), truth, POSES, POSES)
    return told["wall_recall"], told["wall_precision"]


ROOM = segments((0, 0, 4, 0), (4, 0, 4, 3), (4, 3, 0, 3), (0, 3, 0, 0))


def test_the_truth_itself_is_found_and_right() -> None:
    assert judged(ROOM, ROOM) == (1.0, 1.0)


def test_a_true_wall_without_length_matches_nothing() -> None:
    truth = Truth(ends=np.concatenate([segments((0, 0, 0, 0)), ROOM]))
    inside = np.array([[0.0, 1], [-1, 0], [0, -1], [1, 0]])
    mapped = wall_table(ROOM, corner=np.arange(8).reshape(4, 2), normal=inside)
    matched = match_corners(mapped, truth, POSES, POSES)
    assert matched is not None
    assert np.unique(matched.wall).tolist() == [1, 2, 3, 4]


def test_a_corner_without_a_true_one_near_that_faces_alike_is_false() -> None:
    inside = np.array([[0.0, 1], [-1, 0], [0, -1], [1, 0]])
    ends, normal = ROOM.copy(), inside.copy()
    ends[0] += [0.0, 0.9]
    normal[3] = [np.sin(0.6), np.cos(0.6)]  # 56 degrees off
    mapped = wall_table(ends, corner=np.arange(8).reshape(4, 2), normal=normal)
    matched = match_corners(mapped, Truth(ends=ROOM), POSES, POSES)
    assert matched is not None
    assert np.unique(matched.wall).tolist() == [1, 2]
    assert matched.n_false == 4
    assert matched.rmse_m == pytest.approx(0.0, abs=1e-9)
    seen = np.array([[0, 0], [10, 9], [10, 10], [9, 10]])
    figures, counts, _ = judge_corners(mapped, Truth(ends=ROOM, corner_scans=seen), POSES, matched)
    assert counts["due_corners"] == 4
    assert figures["coverage"] == 3 / 4


def test_shares_are_of_the_length() -> None:
    recall, precision = judged(segments((0, 0, 4, 0), (9, 0, 9, 2)), ROOM)
    assert recall == pytest.approx(4 / 14, abs=0.02)  # neighbours count as far as 0.1 m
    assert precision == pytest.approx(4 / 6)


def test_half_of_a_wall_is_half_found() -> None:
    recall, precision = judged(segments((1, 0.05, 3, 0.05)), ROOM[:1])
    assert recall == pytest.approx(2.2 / 4, abs=0.02)
    assert precision == 1.0


@pytest.mark.parametrize(
    ("mapped", "found"),
    [
        ((0, 0.09, 4, 0.09), True),
        ((0, 0.11, 4, 0.11), False),
        ((4, 0, 0, 0), False),  # the other side
        ((0, -0.1, 2, 0.0875), False),  # turned by 5.4 degrees
        ((0, -0.08, 2, 0.08), True),  # by 4.6
    ],
)
def test_what_lies_on_a_wall(mapped: tuple[float, float, float, float], found: bool) -> None:
    _, precision = judged(segments(mapped), ROOM[:1])
    assert precision == (1.0 if found else 0.0)


def test_only_the_observed_part_of_walls_over_half_a_metre_is_required() -> None:
    true = segments((0, 0, 4, 0), (9, 0, 9, 0.4), (20, 0, 24, 0), (30, 0, 34, 0))
    seen_m = np.array([[0.0, 1.0], [0.0, 0.4], [np.nan, np.nan], [1.0, 1.3]])
    assert judged(segments((0, 0, 1, 0)), true, seen_m) == (1.0, 1.0)
    assert judged(segments((2, 0, 3, 0)), true, seen_m) == (0.0, 1.0)
    assert judged(segments((0, 1, 0.4, 1)), true, seen_m) == (0.0, None)  # short: not judged


def test_maps_are_aligned_first_and_moving_walls_left_out() -> None:
    R, poses = turn(1.0), POSES.copy()
    poses[:, :2, 3] = POSES[:, :2, 3] @ R.T + [3.0, 4.0]
    length = np.linalg.norm(ROOM[:, 1] - ROOM[:, 0], axis=1)
    truth = Truth(ends=ROOM, seen_m=np.column_stack([0 * length, length]))
    moved = ROOM @ R.T + [3.0, 4.0]
    told = judge_walls(table(moved), truth, poses, POSES)
    assert told == {"wall_recall": 1.0, "wall_precision": 1.0, "doubled_length": 0.0}
    none = judge_walls(table(moved, "dynamic"), truth, poses, POSES)
    assert none == {"wall_recall": 0.0, "wall_precision": None, "doubled_length": None}


def test_without_a_truth_of_walls_only_doubles_are_reported() -> None:
    assert judge_walls(table(ROOM), Truth(), POSES, POSES) == {"doubled_length": 0.0}
    unseen = judge_walls(table(ROOM), Truth(ends=ROOM), POSES, POSES)
    assert unseen["wall_recall"] is None
    assert unseen["wall_precision"] == 1.0


@pytest.mark.parametrize(
    ("second", "doubled"),
    [
        ((0, 0.05, 4, 0.05), 1.0),
        ((1, 0.05, 3, 0.05), (2 + 2) / 6),
        ((4, 0.05, 8, 0.05), 0.0),  # goes on
        ((4, 0.05, 0, 0.05), 0.0),  # the other side of it
        ((0, 0.15, 4, 0.15), 0.0),
    ],
)
def test_doubled_walls(second: tuple[float, float, float, float], doubled: float) -> None:
    assert doubled_length(segments((0, 0, 4, 0), second)) == pytest.approx(doubled, abs=0.01)
    assert doubled_length(segments(second)) == 0.0
    assert doubled_length(segments()) is None


def test_a_map_that_is_all_wrong_takes_no_more_memory() -> None:
    assert judged(segments((0, 50, 1e9, 50), (0, 0, 4, 0)), ROOM)[1] == pytest.approx(0, abs=1e-6)
