"""Who is due for grouping, and when."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relmap.core.levels import GroupLevels
from relmap.core.schedule import LONGEST_INTERVAL, PASSES, WAIT, GroupingSchedule
from relmap.core.sightings import Sightings

AFTER, MISSED = 4, 2


def begun(after: int = AFTER, missed: int = MISSED) -> tuple[GroupingSchedule, GroupLevels]:
    levels = GroupLevels()
    return GroupingSchedule(after, missed, Sightings(), levels), levels


def see(
    schedule: GroupingSchedule, levels: GroupLevels, landmarks: list[int], iteration: int
) -> list[int]:
    seen = np.array(landmarks, dtype=np.int64)
    left = schedule.see(seen, iteration)
    levels.resize(len(schedule.counts))
    schedule.note_due(seen)
    return sorted(left.tolist())


def test_the_passes_are_due_after_multiples_of_the_first() -> None:
    schedule, levels = begun()
    due = {}
    for k in range(AFTER * PASSES[-1] + 1):
        see(schedule, levels, [0], k)
        while (now := schedule.next_due()) is not None:
            assert now[0] == 0
            due[now[1]] = k + 1
            levels._levels.values[0] = now[1]
    assert due == {level: AFTER * n for level, n in zip((1, 2, 3), PASSES, strict=True)}


def test_one_that_found_no_group_is_due_again_after_as_many_more() -> None:
    schedule, levels = begun()
    tried = []
    for k in range(3 * AFTER - 1):
        see(schedule, levels, [0], k)
        if schedule.next_due() is not None:
            tried.append(k + 1)
    assert tried == [AFTER, 2 * AFTER]


def test_lower_levels_come_first_and_then_those_seen_longest() -> None:
    schedule, levels = begun()
    for k in range(3 * AFTER):
        landmarks = [0, 1]
        landmarks += [2] * (k >= AFTER) + [3] * (k >= 2 * AFTER)
        see(schedule, levels, landmarks, k)
    levels._levels.values[[0, 1]] = 1
    assert [schedule.next_due() for _ in range(5)] == [(2, 1), (3, 1), (0, 2), (1, 2), None]


@given(st.lists(st.sets(st.integers(0, 4)), min_size=1, max_size=40), st.integers(0, 3))
def test_who_is_in_view_and_who_has_left(scans: list[set[int]], missed: int) -> None:
    schedule, levels = begun(missed=missed)
    last: dict[int, int] = {}
    in_view: set[int] = set()
    for k, scan in enumerate(scans):
        left = see(schedule, levels, sorted(scan), k)
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
    schedule, levels = begun()
    for k in range(3):
        see(schedule, levels, [0, 1], k)
    for k in range(3, 3 + 2 * MISSED):
        see(schedule, levels, [1], k)
    assert schedule.gone.tolist() == [0]
    see(schedule, levels, [0, 1], 9)
    assert (schedule.begin[0], schedule.counts[0]) == (0, 4)
    assert schedule.gone.tolist() == []


def test_one_back_after_its_last_pass_begins_another_interval() -> None:
    schedule, levels = begun()
    see(schedule, levels, [0], 0)
    for k in range(1, 9):
        see(schedule, levels, [], k)
    schedule.begin_anew(np.array([0]), 9)
    see(schedule, levels, [0], 20)
    assert (schedule.begin[0], schedule.counts[0]) == (20, 1)
    assert schedule.oldest_needed == 20


def test_what_was_seen_less_than_half_the_time_reaches_the_first_level_only() -> None:
    schedule, levels = begun()
    for k in range(10):
        see(schedule, levels, [0, 1, 2], k)
    schedule.is_gone[2] = True
    landmarks, n = np.array([0, 1, 2]), np.array([4, 5, 5])
    assert schedule.reached(landmarks, n, 3).tolist() == [1, 2, 3]
    assert schedule.reached(landmarks, n, 2).tolist() == [1, 2, 2]


@pytest.mark.parametrize("after", [1, 4, 10, 100])
def test_what_is_not_stored_any_longer_does_not_stand_in_the_way_of_level_3(after: int) -> None:
    schedule, levels = begun(after)
    for k in range(PASSES[-1] * max(after, LONGEST_INTERVAL)):
        see(schedule, levels, [0], k)
    stored = np.array([LONGEST_INTERVAL])
    assert schedule.reached(np.array([0]), stored, 3).tolist() == [3]


def test_one_merged_into_another_goes_on_in_its_place() -> None:
    schedule, levels = begun()
    for k in range(12):
        see(schedule, levels, [1] if k >= 8 else [0], k)
    schedule.merge(1, 0)
    assert schedule.in_view.tolist() == [0]
    assert schedule.gone.tolist() == []
    assert (schedule.begin[0], schedule.counts[0]) == (8, 4)
    assert schedule.next_due() == (0, 1)


def test_one_in_view_is_there_once_after_a_merge() -> None:
    schedule, levels = begun()
    see(schedule, levels, [0], 0)
    see(schedule, levels, [1], 1)
    schedule.merge(1, 0)
    assert schedule.in_view.tolist() == [0]
