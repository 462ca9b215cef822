"""A run of a mapper over a log, and its summary."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import relmap
from relmap import MapperConfig, PlaneMapper, PointMapper, RelmapError
from relmap.core.arrays import Ints
from relmap.datasets.base import Scan
from relmap.evaluation.feeding import stamps_of
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import BuildingSource
from relmap.evaluation.summary import timing_of
from relmap.simulation import simulate_figure_eight
from tests.judged import K, make_log


def test_run_reports_its_counts() -> None:
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
    assert timing_of(durations_s) == pytest.approx(
        {"median_ms": 2, "p95_ms": 3, "first_100_median_ms": 1, "last_100_median_ms": 3}
    )
    assert set(timing_of(np.empty(0)).values()) == {None}


class Told(PointMapper):
    """Keeps the odometry that it is given."""

    told: list[object]

    def update(self, *arguments: object, **more: Any) -> Ints:
        self.told = [*getattr(self, "told", []), more.get("odometry")]
        return super().update(*arguments, **more)  # type: ignore[arg-type]


def test_odometry_is_passed_on_request() -> None:
    log = simulate_figure_eight(density=10, iterations=12).log
    odometry = np.tile(np.eye(4), (12, 1, 1))
    odometry[:, 0, 3] = np.arange(12)
    log = replace(log, odometry=odometry)
    mapper = Told()
    run_mapper(mapper, log.between(2, 9), odometry=True)
    assert mapper.told[0] is None, "what was before the first scan is not in the log"
    assert [T[0, 3] for T in mapper.told[1:]] == [3, 4, 5, 6, 7, 8]  # type: ignore[index]
    run_mapper(mapper, log.between(9, 12), odometry=True)
    assert mapper.told[7] is None
    assert len([T for T in mapper.told if T is not None]) == 8
    without = Told()
    run_mapper(without, log)
    assert without.told == [None] * 12


def test_a_continued_run_has_the_motion_since_the_last_scan() -> None:
    log = simulate_figure_eight(density=10, iterations=12).log
    log = replace(log, odometry=np.tile(np.eye(4), (12, 1, 1)))
    mapper = Told()
    seen = [mapper.update(scan.points_robot) for scan in log.between(0, 5).scans()]
    run_mapper(mapper, log, seen=seen, odometry=True)
    assert [T is None for T in mapper.told] == [True] * 5 + [False] * 7


def test_a_callback_gets_the_progress_of_a_run() -> None:
    """It maps as `run_mapper` does, whatever the kind of the log."""
    world = simulate_figure_eight(iterations=12, seed=0)
    told = list[tuple[int, ...]]()
    run = relmap.map_log(world.log, progress=lambda *now: told.append(now))
    assert told == [(done, 12) for done in range(1, 13)]
    alone = run_mapper(PointMapper(), world.log, refine=True)
    np.testing.assert_array_equal(run.result.landmarks.position, alone.result.landmarks.position)
    building = BuildingSource(iterations=3).load().log
    mapper = PlaneMapper()
    relmap.map_log(building, mapper, refine=False, progress=lambda *now: told.append(now))
    assert told[-1] == (3, 3)
    assert mapper.n_iterations == 3
