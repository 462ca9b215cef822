"""Runs of laser scans: where they cannot be linked, or a link is wrong, the map breaks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import segment_scan, segmenter_for
from relmap.evaluation.sources import log_of
from relmap.planes.submaps.submap import torn_in
from relmap.segmentation.scanline import lines
from relmap.segmentation.scanline.lines import beam_noise
from relmap.simulation import simulate_building
from relmap.simulation.floor_plan import World
from tests.worlds import refined, submap_ate_m


def driven(log: ScanLog, scans: list[Floats]) -> PlaneMapper:
    """Map scans with the sensor of a log, without refinement."""
    mapper, segmenter = PlaneMapper(), segmenter_for(log.sensor)
    for points in scans:
        mapper.update(segment_scan(segmenter, points, log.sensor), beams=points)
    mapper.finish()
    return mapper


def scans_of(
    seed: int, step_m: float = 0.2, world: World = "building"
) -> tuple[ScanLog, list[Floats]]:
    """Return a laser log of a building, and its scans."""
    run = simulate_building(
        361, 0.01, sampling="laser", seed=seed, iterations=60, step_m=step_m, world=world
    )
    log = log_of(run)
    return log, [scan.points_robot for scan in log.scans()]


@pytest.mark.parametrize("seed", range(5))
def test_scans_of_another_world_begin_a_submap(seed: int) -> None:
    """Corridors of two buildings may look alike; those among panels look like no other."""
    (log, first), (_, second) = scans_of(seed), scans_of(seed, world="panels")
    mapper = driven(log, first[:25] + second[:25])
    assert sorted(submap.span for submap in mapper.submaps) == [(0, 25), (25, 50)]


def test_a_scan_that_fits_nothing_stays_alone() -> None:
    (log, scans), (_, foreign) = scans_of(3), scans_of(3, world="panels")
    scans[30] = foreign[50]
    mapper = driven(log, scans)
    largest, alone = mapper.submaps
    assert (largest.n_scans, alone.n_scans) == (59, 1)
    assert alone.span == (30, 31)
    assert np.isnan(mapper.trajectory[30]).all()
    known = np.delete(np.arange(60), 30)
    off = np.linalg.inv(log.poses[known[:-1]]) @ log.poses[known[1:]]
    found = np.linalg.inv(mapper.trajectory[known[:-1]]) @ mapper.trajectory[known[1:]]
    np.testing.assert_allclose(found[:, :2, 3], off[:, :2, 3], atol=0.1)
    mapper.refine()
    assert np.isnan(mapper.trajectory[30]).all()
    np.testing.assert_allclose(mapper.submaps[0].poses[31, :2, 3], mapper.trajectory[31, :2, 3])


def test_ties_last_in_saved_states_and_journals(tmp_path: Path) -> None:
    (log, scans), (_, foreign) = scans_of(3), scans_of(3, world="panels")
    scans[30] = foreign[50]
    mapper = driven(log, scans)
    mapper.save(tmp_path / "mapper.npz")
    again = PlaneMapper.load(tmp_path / "mapper.npz")
    for each in (mapper, again):
        each.refine()
    np.testing.assert_array_equal(again.trajectory, mapper.trajectory)
    np.testing.assert_array_equal(again.planes.ends, mapper.planes.ends)


@pytest.mark.parametrize("seed", [0, 4])
def test_long_steps_through_a_building(seed: int) -> None:
    """Steps of 1 m: every submap is right, and the largest holds most of the scans."""
    run = simulate_building(361, 0.01, sampling="laser", seed=seed, step_m=1.0)
    log = log_of(run)
    mapper = driven(log, [scan.points_robot for scan in log.scans()])
    assert mapper.submaps[0].n_scans > 0.6 * len(log)
    for submap in mapper.submaps:
        if submap.n_scans > 2:
            assert submap_ate_m(submap, log.poses) < 0.3


def test_a_run_with_beams_is_the_same_again() -> None:
    log, scans = scans_of(6, 0.6)
    first, second = (driven(log, scans[:40]) for _ in range(2))
    np.testing.assert_array_equal(first.trajectory, second.trajectory)


def test_a_map_torn_at_a_link_is_cut_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a third of the noise is known, some links, not corrected along walls, are wrong."""
    monkeypatch.setattr("relmap.planes.linking.scan_comparison.CROSSINGS", 0.0)
    monkeypatch.setattr("relmap.planes.linking.scan_comparison.EXCLUDED", np.inf)
    monkeypatch.setattr(lines, "beam_noise", lambda xy: 0.35 * beam_noise(xy))
    run = simulate_building(361, 0.05, sampling="laser", seed=8, step_m=0.1)
    log = log_of(run)
    mapper = driven(log, [scan.points_robot for scan in log.scans()])
    before = len(mapper.submaps)
    mapper.refine()
    assert len(mapper.submaps) > before
    assert not len(torn_in(mapper.submaps, mapper.history))
    for submap in mapper.submaps:
        assert submap_ate_m(submap, log.poses) < 1.0


@pytest.mark.parametrize(
    ("world", "beams", "step_m", "seed", "least"),
    [("oblique", 60, 1.0, 2, 46), ("building", 90, 0.1, 7, 600)],
)
def test_a_coarse_laser_breaks_rather_than_err(
    world: World, beams: int, step_m: float, seed: int, least: int
) -> None:
    """A doubtful tie would displace 48 scans by half a metre; a corridor was 3 m too short."""
    run = simulate_building(
        points=beams, sigma=0.01, sampling="laser", world=world, step_m=step_m, seed=seed
    )
    mapper = refined(PlaneMapper(), (scan.points[:, :2] for scan in run.scans))
    own = [submap for submap in mapper.submaps if submap.n_scans >= 10]
    assert sum(submap.n_scans for submap in own) >= least
    for submap in own:
        assert submap_ate_m(submap, run.trajectory) < 0.3
