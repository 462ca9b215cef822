"""Valid and impossible input: a rejected update changes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from relmap import PointMapper, RelmapError
from relmap.core.arrays import Floats
from tests.savedmaps import state
from tests.worlds import aligned_rmse, finished, random_rotation, walk

few = settings(max_examples=60)


BAD_VALUES = st.sampled_from([np.nan, np.inf, -np.inf, 1e10, 1e300])
WRONG: st.SearchStrategy[tuple[Any, Any, str]] = st.one_of(
    st.tuples(
        st.integers(0, 4), st.integers(0, 2), BAD_VALUES, st.sampled_from([None, np.float32])
    ).map(lambda at: (spoilt(*at), None, "points row")),
    st.sampled_from([(3,), (4, 1), (4, 4), (2, 3, 3), (1, 2), ()]).map(
        lambda shape: (np.ones(shape), None, "points has")
    ),
    st.sampled_from(
        [
            "points",
            [["a", "b", "c"]],
            [["1", "2", "3"]],
            [[1j, 2, 3]],
            [[1, 2, 3], [1, 2]],
            None,
            [[None, 1, 2]],
            {"x": 1},
            [[10**400, 0, 0]],
            np.zeros((2, 3), dtype="datetime64[s]"),
        ]
    ).map(lambda points: (points, None, "points ")),
    st.sampled_from(
        [
            [1, 2],
            [1, 2, 2],
            [1.0, 2.0, 3.0],
            ["1", "2", "3"],
            [[1, 2, 3]],
            [[1], [2, 3]],
            3,
            [True, False, True],
            [1, 2, 2**63],
            [1, 2, 2**70],
            np.array([1, 1, 5], dtype=np.uint8),
        ]
    ).map(lambda ids: (np.eye(3), ids, "ids ")),
)


def spoilt(row: int, column: int, value: float, dtype: Any) -> NDArray[Any]:
    points = np.arange(15.0).reshape(5, 3).astype(dtype or np.float64)
    with np.errstate(over="ignore"):
        points[row, column] = value
    return points


@pytest.fixture(scope="module", params=["nothing", "nearest", "known"])
def begun(request: pytest.FixtureRequest) -> PointMapper:
    """A mapper that has seen nothing yet, or is in the midst of a run, with ids or without."""
    mapper = PointMapper()
    for ids, points in walk(3, 2, 0.02).scans[:50]:
        if request.param != "nothing":
            mapper.update(points, ids if request.param == "known" else None)
    return mapper


@few
@given(wrong=WRONG)
def test_a_rejected_update_changes_nothing(
    begun: PointMapper, wrong: tuple[Any, Any, str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    points, ids, named = wrong
    if begun.n_iterations == 0 and isinstance(points, np.ndarray) and points.shape == (1, 2):
        return  # a planar world could begin so
    folder = tmp_path_factory.getbasetemp()
    before = state(begun, folder)
    with pytest.raises(RelmapError, match=named) as caught:
        begun.update(points, ids)
    assert "\n" not in str(caught.value)
    assert state(begun, folder) == before


def test_a_rejected_update_is_not_in_the_journal(tmp_path: Path) -> None:
    scans = walk(3, 2, 0.02).scans[:30]
    mapper = PointMapper(journal=tmp_path / "run.journal")
    for _, points in scans:
        mapper.update(points)
        with pytest.raises(RelmapError):
            mapper.update(points * np.nan)
        with pytest.raises(RelmapError):
            mapper.update(points[:, :2])
    mapper.close()
    assert PointMapper.resume(tmp_path / "run.journal").n_iterations == 30


def given_as(points: Floats, how: int) -> Any:
    """Return the same points as a sensor might give them."""
    frozen = points.copy()
    frozen.flags.writeable = False
    wide = np.full((2 * len(points), 5), np.nan)
    wide[::2, 1:4] = points
    return [
        *(points, frozen, np.asfortranarray(points), wide[::2, 1:4], points.tolist()),
        *(points[::-1][::-1], points.astype(object), tuple(map(tuple, points))),
    ][how]


@settings(max_examples=15)
@given(data=st.data())
def test_memory_layout_does_not_change_the_result(data: st.DataObject) -> None:
    plain, tried = PointMapper(), PointMapper()
    for _, points in walk(3, 6, 0.02, iterations=25).scans:
        how = data.draw(st.integers(0, 7))
        np.testing.assert_array_equal(tried.update(given_as(points, how)), plain.update(points))
    assert tried.map.positions.tobytes() == plain.map.positions.tobytes()


def test_float32_is_taken_for_what_it_is() -> None:
    single, double = PointMapper(), PointMapper()
    for _, points in walk(3, 6, 0.02).scans:
        single.update(points.astype(np.float32))
        double.update(points.astype(np.float32).astype(np.float64))
    assert single.map.positions.tobytes() == double.map.positions.tobytes()


def stream(seed: int) -> list[Floats]:
    return [points for _, points in walk(3, seed, 0.01, iterations=160).scans]


@pytest.mark.parametrize("lost", [1, 4, 30])
def test_after_a_gap_known_landmarks_go_on(lost: int) -> None:
    """The robot sees nothing for a while and has hardly moved."""
    scans = stream(3)
    mapper = PointMapper()
    before = [mapper.update(points) for points in scans[:80]]
    for _ in range(lost):
        assert len(mapper.update([])) == 0
    after = [mapper.update(points) for points in scans[80:]]
    mapper.finish()
    kept = np.intersect1d(before[-1], after[0])
    assert len(kept) >= 0.8 * len(after[0])
    assert len(mapper.submaps) == 1
    assert sum(len(submap.landmark_ids) for submap in mapper.submaps) >= 25
    assert len(mapper.trajectory) == 160 + lost


def test_with_ids_a_gap_ties_by_itself() -> None:
    world = walk(3, 3, 0.0, iterations=160)
    mapper = PointMapper()
    for k, (ids, points) in enumerate(world.scans):
        gone = 60 <= k < 75
        mapper.update(points[:0] if gone else points, ids[:0] if gone else ids)
    mapper.finish()
    assert len(mapper.submaps) == 1
    found = mapper.map
    assert aligned_rmse(found.positions, world.landmarks[found.landmark_ids]) < 1e-6


def test_another_place_after_a_gap_is_a_separate_submap() -> None:
    here, there = stream(3)[:60], stream(11)[:60]
    mapper = finished(PointMapper(), [*here, *[np.empty((0, 3))] * 20, *there])
    assert len(mapper.submaps) == 2
    first, second = sorted(mapper.submaps, key=lambda submap: submap.first_iteration)
    assert (first.first_iteration, second.first_iteration) == (0, 80)
    assert first.last_iteration < 80


def test_one_landmark_and_duplicates_do_no_harm() -> None:
    scans = stream(5)
    plain, tried = PointMapper(), PointMapper()
    for k, points in enumerate(scans):
        plain.update(points)
        if k % 10 == 7:  # the sensor gives one of them twice
            points = np.concatenate([points, points[:1]])
        labels = tried.update(points)
        assert len(np.unique(labels)) == len(labels)
    alone = PointMapper()
    for k in range(40):
        assert len(alone.update([[1.0 + 0.01 * k, 2.0, 3.0]])) == 1
    for mapper in (plain, tried, alone):
        mapper.finish()
        mapper.refine()
    assert len(tried.map.landmark_ids) >= 0.95 * len(plain.map.landmark_ids)
    n = min(len(mapper.trajectory) for mapper in (plain, tried))
    there = np.isfinite(plain.trajectory[:n, 0, 0]) & np.isfinite(tried.trajectory[:n, 0, 0])
    assert there.mean() > 0.95
    apart = (tried.trajectory - plain.trajectory)[there][:, :3, 3]
    assert np.linalg.norm(apart, axis=1).max() < 0.1
    assert len(alone.map.landmark_ids) == 0


def test_thousands_of_points_in_a_scan() -> None:
    rng = np.random.default_rng(0)
    world = rng.uniform(-30, 30, (4000, 3))
    mapper = PointMapper()
    for k in range(12):
        R = random_rotation(3, 0.02, rng)
        labels = mapper.update((world - [0.05 * k, 0, 0]) @ R + rng.normal(0, 0.01, world.shape))
    assert np.mean(labels == np.arange(4000)) > 0.99
    mapper.finish()
    assert len(mapper.map.landmark_ids) > 3900
