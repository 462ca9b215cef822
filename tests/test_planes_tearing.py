"""Steps that the refinement changed, evaluated by the beams of both scans."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.datasets.scans import planar_poses
from relmap.planes.submaps.tearing import contradicted_steps
from relmap.simulation import simulate_building

FIRST, BENT = 3, 12
"""The first of the scans that are refined, and the one at which the map is torn."""


@pytest.fixture(scope="module")
def run() -> tuple[PlaneMapper, Floats]:
    """Return the map of a laser in a building, and the true poses of its scans."""
    building = simulate_building(points=361, sigma=0.01, sampling="laser", iterations=24)
    mapper = PlaneMapper()
    for scan in building.scans:
        mapper.update(scan.points[:, :2])
    return mapper, building.trajectory[FIRST:]


def torn(run: tuple[PlaneMapper, Floats], before: Floats, now: Floats) -> list[int]:
    links = run[0].engine.association.registration.links  # type: ignore[union-attr]
    found: list[int] = contradicted_steps(before, now, FIRST, run[0].history, links.beams).tolist()
    return found


def bent(poses: Floats, scan: int, turn_deg: float, shift_m: float) -> Floats:
    """Return poses of which those from a scan on are turned about it, and shifted."""
    k = scan - FIRST
    bend = planar_poses(*(np.array([value]) for value in (shift_m, 0.0, np.deg2rad(turn_deg))))
    there = poses[k] @ bend @ np.linalg.inv(poses[k])
    return np.concatenate([poses[:k], there @ poses[k:]])


@pytest.mark.parametrize(("turn_deg", "shift_m"), [(5.0, 0.0), (-5.0, 0.0), (0.0, 0.3)])
def test_a_bend_that_the_beams_contradict_is_found(
    run: tuple[PlaneMapper, Floats], turn_deg: float, shift_m: float
) -> None:
    true = run[1]
    wrong = bent(true, BENT, turn_deg, shift_m)
    assert torn(run, true, wrong) == [BENT]
    assert torn(run, wrong, true) == [], "the refinement corrected it"


def test_small_changes_and_those_of_one_scan_alone_are_left(
    run: tuple[PlaneMapper, Floats],
) -> None:
    true = run[1]
    assert torn(run, true, true) == []
    assert torn(run, true, bent(true, BENT, 2.0, 0.1)) == []
    alone = true.copy()
    alone[BENT - FIRST] = bent(true, BENT, 5.0, 0.0)[BENT - FIRST]
    assert torn(run, true, alone) == []


def test_steps_over_scans_without_a_pose_are_not_evaluated(
    run: tuple[PlaneMapper, Floats],
) -> None:
    wrong = bent(run[1], BENT, 5.0, 0.0)
    wrong[BENT - FIRST] = np.nan
    assert torn(run, run[1], wrong) == []
    assert torn(run, np.full_like(wrong, np.nan), wrong) == []
