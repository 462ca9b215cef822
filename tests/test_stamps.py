"""The times of scans that are given to mappers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from relmap import Plane3dMapper, PlaneMapper, PointMapper, RelmapError, map_log
from relmap.core.arrays import Floats
from relmap.io.files import read_tum
from relmap.simulation import simulate_building, simulate_figure_eight
from tests.journals import changed

pytestmark = pytest.mark.usefixtures("unrendered")

BEGAN_S, N = 1.7e9, 20
AnyKind = type[PointMapper] | type[PlaneMapper]


def scans_for(kind: AnyKind) -> list[Any]:
    if kind is PlaneMapper:
        return [scan.seen for scan in simulate_building(seed=0, points=20, iterations=N).scans]
    return [scan.points_robot for scan in simulate_figure_eight(iterations=N).log.scans()]


def fed(mapper: Any, stamps_s: list[float | None]) -> Any:
    for scan, stamp_s in zip(scans_for(type(mapper)), stamps_s, strict=False):
        mapper.update(scan, stamp_s=stamp_s)
    return mapper


def trajectory_of(mapper: Any, folder: Path) -> Floats:
    mapper.finish()
    mapper.save_results(folder)
    known = np.isfinite(mapper.trajectory[:, 0, 3])
    assert known.sum() > N / 2
    found = np.full(mapper.n_iterations, np.nan)
    found[known] = read_tum(folder / "trajectory.tum")[0]
    return found


@pytest.mark.parametrize("kind", [PointMapper, PlaneMapper])
def test_the_trajectory_has_the_times_that_were_given(tmp_path: Path, kind: AnyKind) -> None:
    stamps_s = (BEGAN_S + 0.1 * np.arange(N) ** 1.5).tolist()
    mapper = fed(kind(journal=tmp_path / "journal"), stamps_s)
    mapper.close()
    mapper.save(tmp_path / "mapper.npz")
    resumed, loaded = kind.resume(tmp_path / "journal"), kind.load(tmp_path / "mapper.npz")
    for number, same in enumerate((mapper, resumed, loaded)):
        assert_array_equal(same.stamps_s, stamps_s)
        found = trajectory_of(same, tmp_path / str(number))
        known = np.isfinite(found)
        assert_array_equal(found[known], np.array(stamps_s)[known])


def test_iterations_are_numbered_if_a_scan_has_no_time(tmp_path: Path) -> None:
    stamps_s = [None, 7.0, None, *[None] * (N - 3)]
    mapper = fed(PointMapper(journal=tmp_path / "journal"), stamps_s)
    mapper.close()
    resumed = PointMapper.resume(tmp_path / "journal")
    for number, same in enumerate((mapper, resumed)):
        assert_array_equal(same.stamps_s[:3], [np.nan, 7.0, np.nan])
        found = trajectory_of(same, tmp_path / str(number))
        known = np.flatnonzero(np.isfinite(found))
        assert_array_equal(found[known], known)


@pytest.mark.parametrize("kind", [PointMapper, PlaneMapper, Plane3dMapper])
def test_impossible_times_are_refused_and_change_nothing(kind: type[Any]) -> None:
    mapper, scan = kind(), np.empty((0, 2))
    if kind is Plane3dMapper:
        scan = np.random.default_rng(0).uniform(0, 1, (300, 3)) * [1, 1, 0]
    mapper.update(scan, stamp_s=3)
    for wrong, message in (
        (2.0, "stamp_s is 2.0, and an earlier scan had 3.0: give scans in the order of time"),
        (3.0, "order of time"),
        (np.nan, "stamp_s is nan; it must be one finite number of seconds"),
        (np.inf, "finite"),
        (1.7e18, "stamp_s is 1.7e[+]18; it must be one finite number of seconds, at most 1e[+]12"),
        ([1.0, 2.0], "one finite"),
        ("now", "stamp_s must be one finite number of seconds"),
    ):
        with pytest.raises(RelmapError, match=message):
            mapper.update(scan, stamp_s=wrong)
    mapper.update(scan)
    mapper.update(scan, stamp_s=np.float32(4))
    assert_array_equal(mapper.stamps_s, [3, np.nan, 4])


def test_a_refused_scan_leaves_no_time_and_no_odometry() -> None:
    points = np.random.default_rng(0).uniform(-5, 5, (20, 2))
    mapper = PointMapper()
    mapper.update(points, stamp_s=0.5)
    mapper.update(points, odometry=[0.1, 0, 0], stamp_s=1.0)
    with pytest.raises(RelmapError, match="ids did not come"):
        mapper.update(points, ids=np.arange(20), odometry=[0.2, 0, 0], stamp_s=2.0)
    mapper.update(points, odometry=[0.3, 0, 0], stamp_s=1.5)
    assert_array_equal(mapper.stamps_s, [0.5, 1.0, 1.5])
    assert_array_equal(mapper.engine.motions.over(3)[:, 0, 3], [np.nan, 0.1, 0.3])


def test_a_changed_time_in_a_journal_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    fed(PointMapper(journal=path), list(range(N))).close()
    changed(path, "UPDATE stamps SET stamp = 4.5 WHERE iteration = 4")
    with pytest.raises(RelmapError, match="damaged at iteration 4: its checksum"):
        PointMapper.resume(path)
    changed(path, "UPDATE stamps SET stamp = 'late' WHERE iteration = 4")
    with pytest.raises(RelmapError, match="damaged at iteration 4"):
        PointMapper.resume(path)
    changed(path, "UPDATE stamps SET stamp = 4 WHERE iteration = 4")
    changed(path, "INSERT INTO stamps VALUES (99, 9.5)")
    with pytest.raises(RelmapError, match="without a scan"):
        PointMapper.resume(path)


def test_mappers_get_the_times_of_logs_unless_another_log_was_later(tmp_path: Path) -> None:
    log = replace(simulate_figure_eight(iterations=N).log, stamps_s=BEGAN_S + np.arange(float(N)))
    mapper = PointMapper()
    map_log(log, mapper)
    found = trajectory_of(mapper, tmp_path)
    known = np.isfinite(found)
    assert_array_equal(found[known], log.stamps_s[known])
    map_log(log.between(0, 5), mapper)
    assert_array_equal(mapper.stamps_s, np.append(log.stamps_s, np.full(5, np.nan)))
    map_log(replace(log, stamps_s=log.stamps_s + N), mapper)
    assert_array_equal(mapper.stamps_s[N + 5 :], log.stamps_s + N)
