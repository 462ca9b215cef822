"""Submaps that are adjacent in time are tied by several scans on either side of a break."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.planes.linking.adjoining import Break, tied_across
from relmap.planes.linking.judging import NO_CANDIDATES, NO_MATCH, Found
from relmap.planes.linking.link_record import BY_BEAMS, LinkRecord
from relmap.planes.linking.search import Search
from relmap.planes.linking.tying import Scans
from relmap.planes.motions import from_matrices
from relmap.planes.scans.beams import GivenBeams
from relmap.simulation import simulate_building
from relmap.simulation.floor_plan import World
from relmap.simulation.sensor import Sensor
from tests.worlds import fed

STEP_M = 0.5
MOST_M, MOST_RAD = 2.0, np.deg2rad(60.0)


def scanned(world: World) -> tuple[Scans, Floats]:
    """Return the scans of a simulated laser, not yet tied, and their true poses."""
    building = simulate_building(
        points=361, sigma=0.01, sampling="laser", iterations=60, world=world, step_m=STEP_M
    )
    mapper = fed(PlaneMapper(), (scan.points[:, :2] for scan in building.scans))
    links = mapper.engine.association.registration.links  # type: ignore[attr-defined]
    none = np.empty(0, dtype=np.int64)
    motions, measured = links.motions.copy(), links.measured
    scans = Scans(links.store, links.beams, motions, measured, lambda *_: None, none)
    return scans, building.trajectory


def across(scan: int, poses: Floats) -> Floats:
    """Return the true motion into a scan."""
    return np.asarray(from_matrices((np.linalg.inv(poses[scan]) @ poses[scan - 1])[None])[0])


@pytest.mark.parametrize("scan", [12, 20, 33])
def test_a_break_is_tied_by_the_scans_around_it(scan: int) -> None:
    scans, poses = scanned("building")
    submaps = (np.arange(len(poses)) >= scan).astype(np.int64)
    scans.motions[scan] = np.nan
    link = tied_across(scans, submaps, scan)
    assert (link.earlier, link.later) == (scan - 1, scan)
    np.testing.assert_allclose(link.motion, across(scan, poses), atol=0.05)
    assert len(link.walls)


@pytest.mark.parametrize("scan", [12, 20, 33])
def test_the_beams_suggest_a_motion_that_walls_do_not_imply(
    scan: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans, poses = scanned("building")
    submaps = (np.arange(len(poses)) >= scan).astype(np.int64)
    scans.motions[scan] = np.nan
    monkeypatch.setattr(Search, "candidates", lambda *_: NO_CANDIDATES)
    assert tied_across(scans, submaps, scan) is None
    link = tied_across(scans, submaps, scan, set())
    np.testing.assert_allclose(link.motion, across(scan, poses), atol=0.05)
    assert len(link.walls)


@pytest.mark.parametrize("by_beams", [False, True])
def test_corridors_without_features_are_not_tied(by_beams: bool) -> None:
    scans, poses = scanned("bare-corridor")
    for scan in range(8, 20):
        submaps = (np.arange(len(poses)) >= scan).astype(np.int64)
        assert tied_across(scans, submaps, scan, set() if by_beams else None) is None


def test_a_break_at_which_nothing_is_certain_is_not_examined_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scans, poses = scanned("bare-corridor")
    submaps, failed = (np.arange(len(poses)) >= 12).astype(np.int64), set[tuple[int, ...]]()
    assert tied_across(scans, submaps, 12, failed) is None
    monkeypatch.setattr(Break, "link_by_beams", None)
    assert tied_across(scans, submaps, 12, failed) is None


def test_scans_of_another_place_are_not_tied() -> None:
    scans, poses = scanned("oblique")
    for first in range(4, 36, 4):
        later = first + 20 + np.arange(4)
        elsewhere = Break(scans, np.arange(first - 4, first), later)
        assert np.linalg.norm(poses[later[0], :2, 3] - poses[first - 1, :2, 3]) > MOST_M
        assert elsewhere.link(MOST_M, MOST_RAD) is None
        assert elsewhere.link_by_beams(MOST_M, MOST_RAD) is None


def test_a_longer_step_than_usual_is_not_accepted() -> None:
    scans, _ = scanned("building")
    between = Break(scans, np.arange(8, 12), np.arange(12, 16))
    assert between.link(MOST_M, MOST_RAD) is not None
    assert between.link(STEP_M / 2, MOST_RAD) is None


def test_ties_remain_when_a_map_is_finished_again() -> None:
    building, other = (
        simulate_building(
            points=361, sigma=0.01, sampling="laser", iterations=60, step_m=STEP_M, seed=seed
        )
        for seed in (0, 7)
    )
    mapper, first = PlaneMapper(), list[list[int]]()
    for k, scan in enumerate(building.scans):
        mapper.update((other.scans[k] if k in (15, 30, 31, 45) else scan).points[:, :2])
    for _ in range(3):
        mapper.finish()
        first.append([submap.first_iteration for submap in mapper.submaps])
    assert first[0] == first[1] == first[2]


def test_a_map_that_is_finished_again_keeps_its_cuts() -> None:
    mapper, firsts = PlaneMapper(), list[list[int]]()
    corridor = simulate_building(
        points=91,
        sigma=0.02,
        sampling="laser",
        iterations=60,
        world="corridor",
        step_m=0.6,
        sensor=Sensor(8.0, np.pi),
    )
    for scan in corridor.scans:
        mapper.update(scan.points[:, :2])
    for call in (mapper.finish, mapper.finish, mapper.refine, mapper.finish):
        call()
        firsts.append([submap.first_iteration for submap in mapper.submaps])
    assert len(firsts[0]) > 1
    assert firsts[0] == firsts[1]
    assert firsts[2] == firsts[3]


def test_a_torn_map_is_cut_where_only_the_beams_tied_it() -> None:
    record, still = LinkRecord(1.0), np.zeros(3)
    none: Any = SimpleNamespace(beams=GivenBeams.checked(np.empty((0, 2)), np.zeros(2)))
    for k in range(20):
        if k % 10 == 0:
            record.begin_submap()
        evidence = BY_BEAMS if k % 10 == 4 else 30.0
        record.append(none, still, True, Found(still, NO_MATCH, True, evidence), False)
    record.cut_torn(np.array([7, 8]))
    assert np.flatnonzero(np.diff(record.submaps)).tolist() == [3, 9]
    record.cut_torn(np.array([8]))
    assert np.flatnonzero(np.diff(record.submaps)).tolist() == [3, 7, 9]
