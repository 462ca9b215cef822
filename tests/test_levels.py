"""Which group a landmark's position comes from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap import PointMapper
from relmap.core import turns
from relmap.core.arrays import Bools, Ints
from relmap.core.grouping.completion import RelativeMap
from relmap.core.grouping.levels import GroupLevels
from relmap.core.mapper import RelativeMapper
from relmap.core.state.schedule import LONGEST_INTERVAL
from relmap.core.state.table import LandmarkState
from relmap.simulation import simulate_figure_eight
from tests.worlds import walk

N = 6
ints = st.integers
offers = st.lists(
    st.tuples(
        st.sampled_from(["group", "group", "group", "leave", "close"]),
        st.lists(st.tuples(ints(0, N - 1), ints(1, 3), ints(0, 5)), unique_by=lambda row: row[0]),
    ),
    max_size=25,
)


def begun(n: int) -> tuple[LandmarkState, GroupLevels]:
    table = LandmarkState()
    table.resize(n, 0, 2)
    return table, GroupLevels(table)


def numbers(levels: GroupLevels) -> list[int]:
    return [int(group.iterations[0]) for group in levels.groups]


def offered(
    table: LandmarkState, levels: GroupLevels, number: int, rows: list[tuple[int, int, int]]
) -> Bools:
    """Let a group offer positions, as the engine does; return which were accepted.

    A landmark reaches level 3 if it is gone, level 1 if the group has few of its observations.
    """
    landmarks, reached, n_averaged = np.array(rows, dtype=np.int64).reshape(-1, 3).T.copy()
    n, seen, none = len(rows), np.arange(5) < n_averaged[:, None], np.empty(0)
    places, iterations = np.zeros((n, 2)), np.arange(5)
    own = landmarks, places, none, none, seen, n_averaged, iterations, none, none
    relative = RelativeMap(*own, common_interval=np.array([number]))
    table.is_gone[landmarks] = reached == 3
    table.in_interval[landmarks] = np.where(reached == 1, 2 * n_averaged + 1, 0)
    whole = levels.take(relative, 0, places, (3, np.inf, LONGEST_INTERVAL))
    taken = table.group[landmarks] == levels.n_groups - 1
    assert whole.tolist() == landmarks[taken & (reached == 3)].tolist()
    return np.asarray(taken)


@settings(max_examples=100)
@given(offers)
def test_the_highest_level_wins_and_of_equal_ones_the_one_with_more(
    steps: list[tuple[str, list[tuple[int, int, int]]]],
) -> None:
    table, levels = begun(N)
    present = dict.fromkeys(range(N), (0, 0))
    group_of: dict[int, int] = {}
    settled: set[int] = set()
    highest = [0] * N
    for number, (what, rows) in enumerate(steps):
        landmarks = np.array([row[0] for row in rows], dtype=np.int64)
        if what == "group":
            taken = offered(table, levels, number, rows)
            for (landmark, reached, n), wins in zip(rows, taken.tolist(), strict=True):
                assert wins == (n > 0 and (reached, n) > present[landmark])
                if wins:
                    present[landmark], group_of[landmark] = (reached, n), number
                    highest[landmark] = max(highest[landmark], reached)
        else:
            getattr(levels, what)(landmarks)
            for landmark in landmarks.tolist():
                group = group_of.pop(landmark, None)
                if what == "close" and group is not None:
                    settled.add(group)
                if what == "leave":
                    highest[landmark] = 0
                present[landmark] = (0, 0)
        assert table.level.tolist() == [present[k][0] for k in range(N)]
        assert table.highest_level.tolist() == highest
        assert numbers(levels) == sorted(settled | set(group_of.values()))


def test_a_lower_group_goes_when_the_last_of_its_members_is_in_a_higher_one() -> None:
    table, levels = begun(3)
    offered(table, levels, 0, [(0, 1, 4), (1, 1, 4), (2, 1, 4)])
    offered(table, levels, 1, [(0, 2, 9), (1, 2, 9)])
    assert numbers(levels) == [0, 1]
    offered(table, levels, 2, [(2, 2, 3)])
    assert numbers(levels) == [1, 2]


def test_one_merged_into_another_goes_on_with_its_group() -> None:
    table, levels = begun(2)
    offered(table, levels, 0, [(0, 3, 30)])
    levels.close(np.array([0]))
    offered(table, levels, 1, [(1, 1, 10)])
    table.merge(np.array([1]), np.array([0]))
    assert (table.level[0], table.highest_level[0]) == (1, 3)
    assert not offered(table, levels, 2, [(0, 1, 9)])[0]
    assert offered(table, levels, 3, [(0, 2, 20)])[0]
    assert numbers(levels) == [0, 3]


def test_a_landmark_goes_through_the_levels_in_order_each_from_the_start_of_its_interval(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mapper, world = PointMapper(), walk(3, 7, sigma=0.05, iterations=300)
    engine = mapper.engine
    group, found = engine.group, turns.found_submap
    passes: dict[int, list[int]] = {}

    def noted(seed: int, level: int) -> None:
        # Iterations that were condensed already are needed by no group to come.
        first = int(engine.table.first[seed])
        if engine.table.begin[seed] == first:
            passes.setdefault(seed, []).append(level)
            assert engine.chart(seed).iterations[0] == first

    def grouped(seed: int, level: int) -> Ints:
        noted(seed, level)
        return group(seed, level)

    def founded(engine: RelativeMapper, seed: int, level: int) -> None:
        noted(seed, level)
        found(engine, seed, level)

    monkeypatch.setattr(engine, "group", grouped)
    monkeypatch.setattr(turns, "found_submap", founded)
    level_was = np.zeros(0, dtype=np.int8)
    for ids, points in world.scans:
        mapper.update(points, ids)
        level = engine.table.highest_level
        assert (level[: len(level_was)] >= level_was).all()
        level_was = level.copy()
    mapper.finish()
    assert len(passes) > 5
    assert all(levels == sorted(levels) for levels in passes.values())
    assert {level for levels in passes.values() for level in levels} == {1, 2, 3}
    often = mapper.landmarks.observations >= 20
    assert set(mapper.landmarks.level[often]) == {3}


def test_who_has_left_the_view_is_grouped_over_the_whole_interval_before_the_end() -> None:
    mapper, world = PointMapper(), walk(3, 7, sigma=0.05, iterations=300)
    for ids, points in world.scans[::2]:  # too few observations of each for level 3 in view
        mapper.update(points, ids)
    table = mapper.landmarks  # nothing is finished
    left = (table.last_iteration < 100) & (table.observations >= 20)
    assert left.sum() > 10
    assert set(table.level[left]) == {3}
    assert len(mapper.engine.schedule.gone) <= 10


def test_there_are_no_more_groups_than_landmarks() -> None:
    world, mapper = simulate_figure_eight(density=25, iterations=500, seed=4), PointMapper()
    made = 0
    for scan in world.log.scans():
        mapper.update(scan.points_robot, scan.ids)
        assert len(mapper.engine.levels.groups) <= max(len(mapper.engine.table), 1)
        made = mapper.engine.levels.n_groups
    mapper.finish()
    assert len(mapper.groups) <= 0.7 * made
    used = {label for group in mapper.groups for label in group.landmarks.tolist()}
    assert set(mapper.map.landmark_ids.tolist()) <= used
