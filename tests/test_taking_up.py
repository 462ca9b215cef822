"""A run of scans is added to a map only if a stretch of it agrees in exactly one place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats, Ints
from relmap.evaluation.feeding import feed, preparation
from relmap.evaluation.sources import log_of
from relmap.planes.motions import matrices
from relmap.planes.places.taking_up import Placements
from relmap.simulation import simulate_building
from tests.savedmaps import told

N = 30
PATH = matrices(np.column_stack([np.linspace(0, 1, N), 0.5 * np.arange(N), np.zeros(N)]))
"""Poses half a metre apart."""
THERE, ELSEWHERE = matrices(np.array([[0.5, 3.0, 4.0], [2.0, -20.0, 5.0]]))


def placed(*parts: tuple[Floats, Ints]) -> Placements:
    """Return placements of some scans of the path, each part of them by a motion of the path."""
    of = np.concatenate([scans for _, scans in parts])
    T = np.concatenate([motion @ PATH[scans] for motion, scans in parts])
    order = np.argsort(of, kind="stable")
    return Placements(100 + np.arange(N), PATH, of[order], T[order])


def test_a_stretch_that_agrees_is_accepted() -> None:
    found = placed((THERE, np.arange(4, 24)), (ELSEWHERE, np.arange(8, 15))).accepted()
    scan, T_map_robot = found
    np.testing.assert_allclose(T_map_robot, THERE @ PATH[scan - 100])


def test_a_path_that_drifts_agrees_and_one_that_tears_does_not() -> None:
    scans = np.arange(4, 28)
    every = placed((THERE, scans))
    for off_m, is_accepted in ((0.02, True), (0.3, False)):
        drifted = every.T_map_robot.copy()
        drifted[:, 0, 3] += off_m * 0.5 * scans
        found = Placements(every.scan, every.T_run_robot, every.of, drifted).accepted()
        assert (found is not None) == is_accepted


@pytest.mark.parametrize(
    "parts",
    [
        [(THERE, np.array([9]))],
        [(THERE, np.arange(4, 16))],
        [(THERE, np.arange(0, 30, 3))],
        [(THERE, np.arange(0, 20)), (ELSEWHERE, np.arange(15, 30))],
        [(THERE, np.arange(0, 20)), (ELSEWHERE, np.arange(0, 20))],
        [(THERE, np.arange(0))],
    ],
    ids=["one", "short", "few", "elsewhere too", "twins", "none"],
)
def test_weaker_agreement_is_rejected(parts: list[tuple[Floats, Ints]]) -> None:
    assert placed(*parts).accepted() is None


def test_the_next_corner_of_a_corridor_is_not_taken_for_the_mapped_one() -> None:
    """Its four sides are the same: single scans are localised in wrong places."""
    world = simulate_building(181, 0.01, sampling="laser", world="corridor", iterations=230)
    log = log_of(world)
    mapper = PlaneMapper()
    feed(mapper, log.between(0, 106), "nearest")
    prepare, found = preparation(mapper, log), 0
    for scan in log.between(160, 230).scans():
        walls = prepare(scan.points_robot)
        if scan.iteration % 5 == 0:
            found += mapper.locate(walls, scan.points_robot).n_places == 1
        if scan.iteration == 160:
            mapper.take_up(walls, scan.points_robot)
        mapper.update(walls, beams=scan.points_robot)
    mapper.finish()
    assert found >= 1
    assert mapper.tied_at is None
    assert mapper.submaps[0].n_scans == 106


def test_a_log_that_is_half_added_is_saved_with_where_its_scans_fit(tmp_path: Path) -> None:
    log = log_of(simulate_building(181, 0.01, sampling="laser", iterations=90))
    mapper = PlaneMapper()
    feed(mapper, log.between(0, 80), "nearest")
    prepare = preparation(mapper, log)
    for scan in log.between(30, 90).scans():
        walls = prepare(scan.points_robot)
        if scan.iteration == 30:
            mapper.take_up(walls, scan.points_robot)
        if scan.iteration == 60:
            mapper.save(tmp_path / "half.npz")
            saved = PlaneMapper.load(tmp_path / "half.npz")
        mapper.update(walls, beams=scan.points_robot)
        if scan.iteration >= 60:
            saved.update(walls, beams=scan.points_robot)
    for each in (mapper, saved):
        each.finish()
    assert saved.tied_at == mapper.tied_at == 80
    assert told(saved) == told(mapper)
