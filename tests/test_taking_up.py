"""A run of scans is added to a map of walls where its submaps show the same place."""

from __future__ import annotations

from pathlib import Path

from relmap import PlaneMapper
from relmap.evaluation.feeding import feed, preparation
from relmap.evaluation.sources import log_of
from relmap.simulation import simulate_building
from tests.savedmaps import told


def test_the_next_corner_of_a_corridor_is_not_taken_for_the_mapped_one() -> None:
    """Its four sides are the same: single scans are localised in wrong places."""
    world = simulate_building(181, 0.01, sampling="laser", world="corridor", iterations=230)
    log = log_of(world)
    mapper = PlaneMapper()
    feed(mapper, log.between(0, 90), "nearest")
    prepare, found = preparation(mapper, log), 0
    for scan in log.between(140, 230).scans():
        walls = prepare(scan.points_robot)
        if scan.iteration % 5 == 0:
            found += mapper.locate(walls, scan.points_robot).n_places == 1
        if scan.iteration == 140:
            mapper.take_up(walls, scan.points_robot)
        mapper.update(walls, beams=scan.points_robot)
    mapper.finish()
    mapper.refine()
    assert found >= 1
    assert mapper.tied_at is None
    assert mapper.submaps[0].n_scans == 90


def test_a_log_that_is_half_added_is_saved_as_such(tmp_path: Path) -> None:
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
        if scan.iteration in (60, 70):
            saved.take_up(walls, scan.points_robot)  # which changes nothing before `finish`
    for each in (mapper, saved):
        each.finish()
        assert each.tied_at is None
        each.refine()
    assert saved.tied_at == mapper.tied_at == 80
    assert told(saved) == told(mapper)
