"""Which landmarks are due for grouping, and when."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relmap.core.config import MapperConfig
from relmap.core.grouping.level_kernels import reached
from relmap.core.state.schedule import LONGEST_INTERVAL, WAIT, GroupingSchedule
from relmap.core.state.table import LandmarkState

AFTER, MISSED = 4, 2


def begun(after: int = AFTER, missed: int = MISSED) -> tuple[GroupingSchedule, LandmarkState]:
    table = LandmarkState()
    return GroupingSchedule(table, MapperConfig(group_after=after, max_missed=missed)), table


def see(
    schedule: GroupingSchedule, table: LandmarkState, landmarks: list[int], iteration: int
) -> list[int]:
    seen = np.array(landmarks, dtype=np.int64)
    table.resize(max(landmarks, default=-1) + 1, iteration, 2)
    return sorted(schedule.see(seen, iteration).tolist())


def level_of(
    schedule: GroupingSchedule, table: LandmarkState, landmark: int, n_averaged: int, level: int
) -> int:
    seen, is_gone = int(table.in_interval[landmark]), bool(table.is_gone[landmark])
    return reached(level, n_averaged, seen, is_gone, *schedule.limits)


@pytest.mark.parametrize("passes", [(3, 6), (2, 9)])
def test_the_passes_are_due_after_multiples_of_the_first(passes: tuple[int, int]) -> None:
    second, third = passes
    table = LandmarkState()
    config = MapperConfig(
        group_after=AFTER, second_pass=second, third_pass=third, max_missed=MISSED
    )
    schedule, due = GroupingSchedule(table, config), {}
    for k in range(AFTER * third + 1):
        see(schedule, table, [0], k)
        while (now := schedule.next_due()) is not None:
            assert now[0] == 0
            due[now[1]] = k + 1
            table.level[0] = now[1]
    assert due == {1: AFTER, 2: AFTER * second, 3: AFTER * third}


def test_one_that_found_no_group_is_due_again_after_as_many_more() -> None:
    schedule, table = begun()
    tried = []
    for k in range(3 * AFTER - 1):
        see(schedule, table, [0], k)
        if schedule.next_due() is not None:
            tried.append(k + 1)
    assert tried == [AFTER, 2 * AFTER]


@pytest.mark.parametrize(("unplaced", "due"), [(2, []), (3, list(range(20)))])
def test_a_few_without_a_position_wait_for_a_higher_level(unplaced: int, due: list[int]) -> None:
    schedule, table = begun()
    see(schedule, table, list(range(20)), 0)
    table.weight[: 20 - unplaced] = 1.0
    for k in range(1, 3 * AFTER):
        see(schedule, table, list(range(20)), k)
        if k == 2 * AFTER - 1:
            queued = iter(schedule.next_due, None)
            assert sorted(seed for seed, level in queued if level == 1) == due
    assert sorted(seed for seed, _ in iter(schedule.next_due, None)) == list(range(20))


def test_lower_levels_come_first_and_then_those_seen_longest() -> None:
    schedule, table = begun()
    for k in range(3 * AFTER):
        landmarks = [0, 1]
        landmarks += [2] * (k >= AFTER) + [3] * (k >= 2 * AFTER)
        see(schedule, table, landmarks, k)
    table.level[[0, 1]] = 1
    assert [schedule.next_due() for _ in range(5)] == [(2, 1), (3, 1), (0, 2), (1, 2), None]


@given(st.lists(st.sets(st.integers(0, 4)), min_size=1, max_size=40), st.integers(0, 3))
def test_landmarks_in_view_and_landmarks_that_left(scans: list[set[int]], missed: int) -> None:
    schedule, table = begun(missed=missed)
    last: dict[int, int] = {}
    in_view: set[int] = set()
    for k, scan in enumerate(scans):
        left = see(schedule, table, sorted(scan), k)
        last |= dict.fromkeys(scan, k)
        now = {landmark for landmark, at in last.items() if k - at <= missed}
        assert set(left) == in_view - now
        in_view = now
        assert sorted(schedule.in_view.tolist()) == sorted(in_view)
        gone = schedule.gone.tolist()
        assert len(set(gone)) == len(gone)
        assert set(gone) == set(last) - in_view
        assert schedule.waited(k).tolist() == [
            landmark for landmark in gone if k - last[landmark] >= missed + WAIT * AFTER
        ]
    schedule.end()
    assert sorted(schedule.gone.tolist()) == sorted(last)


def test_one_back_before_its_last_pass_goes_on_with_its_interval() -> None:
    schedule, table = begun()
    for k in range(3):
        see(schedule, table, [0, 1], k)
    for k in range(3, 3 + 2 * MISSED):
        see(schedule, table, [1], k)
    assert schedule.gone.tolist() == [0]
    see(schedule, table, [0, 1], 9)
    assert (table.begin[0], table.in_interval[0]) == (0, 4)
    assert schedule.gone.tolist() == []


def test_one_back_after_its_last_pass_begins_another_interval() -> None:
    schedule, table = begun()
    see(schedule, table, [0], 0)
    for k in range(1, 9):
        see(schedule, table, [], k)
    schedule.begin_anew(np.array([0]), 9)
    see(schedule, table, [0], 20)
    assert (table.begin[0], table.in_interval[0]) == (20, 1)
    assert schedule.needed_from(30) == 20


def test_what_was_seen_less_than_half_the_time_reaches_the_first_level_only() -> None:
    schedule, table = begun()
    for k in range(10):
        see(schedule, table, [0, 1, 2], k)
    table.is_gone[2] = True
    for level in (2, 3):
        found = [level_of(schedule, table, k, n, level) for k, n in enumerate([4, 5, 5])]
        assert found == [1, 2, level]


@pytest.mark.parametrize("after", [1, 4, 10, 100])
def test_what_is_not_stored_any_longer_does_not_stand_in_the_way_of_level_3(after: int) -> None:
    schedule, table = begun(after)
    for k in range(6 * max(after, LONGEST_INTERVAL)):
        see(schedule, table, [0], k)
    assert level_of(schedule, table, 0, LONGEST_INTERVAL, 3) == 3


def test_one_merged_into_another_goes_on_in_its_place() -> None:
    schedule, table = begun()
    for k in range(12):
        see(schedule, table, [1] if k >= 8 else [0], k)
    table.merge(np.array([1]), np.array([0]))
    schedule.merge(np.array([1]), np.array([0]))
    assert schedule.in_view.tolist() == [0]
    assert schedule.gone.tolist() == []
    assert (table.begin[0], table.in_interval[0]) == (8, 4)
    assert schedule.next_due() == (0, 1)


def test_one_in_view_is_there_once_after_a_merge() -> None:
    schedule, table = begun()
    see(schedule, table, [0], 0)
    see(schedule, table, [1], 1)
    table.merge(np.array([1]), np.array([0]))
    schedule.merge(np.array([1]), np.array([0]))
    assert schedule.in_view.tolist() == [0]


def test_one_in_view_stays_there_if_one_that_is_done_is_merged_into_it() -> None:
    schedule, table = begun()
    for k in range(20):
        see(schedule, table, [0, 1] if k == 2 else [0], k)
    schedule.begin_anew(np.array([1]), 20)
    table.merge(np.array([1]), np.array([0]))
    schedule.merge(np.array([1]), np.array([0]))
    assert schedule.in_view.tolist() == [0]
    left = [one for k in range(20, 27) for one in see(schedule, table, [], k)]
    assert left == schedule.gone.tolist() == [0]


def test_one_in_view_stays_there_if_one_that_has_left_is_merged_into_it() -> None:
    schedule, table = begun()
    for k in range(20):
        see(schedule, table, [0, 1] if k < 3 else [0], k)
    assert (schedule.in_view.tolist(), schedule.gone.tolist()) == ([0], [1])
    table.merge(np.array([1]), np.array([0]))
    schedule.merge(np.array([1]), np.array([0]))
    assert (schedule.in_view.tolist(), schedule.gone.tolist()) == ([0], [])
    assert see(schedule, table, [0], 20) == []
    left = [one for k in range(21, 27) for one in see(schedule, table, [], k)]
    assert left == schedule.gone.tolist() == [0]


def test_one_merged_before_it_leaves_has_left_once() -> None:
    schedule, table = begun()
    for k, seen in enumerate([[0], [], [], [], [1], [], []]):
        see(schedule, table, seen, k)
    table.merge(np.array([1]), np.array([0]))
    schedule.merge(np.array([1]), np.array([0]))
    assert see(schedule, table, [], 7) == [0]
    assert schedule.gone.tolist() == [0]
