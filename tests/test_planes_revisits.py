"""Maps that contradict themselves, by the beams of two visits of a place."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.datasets.scans import planar_poses
from relmap.planes.submaps.contradictions import contradicted_revisits
from relmap.simulation import simulate_building
from tests.worlds import fed

FIRST = 20
NEAR_M = 1.5
"""Largest distance of a cut from where the map was bent."""


@pytest.fixture(scope="module")
def run() -> tuple[PlaneMapper, Floats]:
    """Return the map of a laser on two rounds of a building, and the true poses of its scans."""
    building = simulate_building(points=181, sigma=0.01, sampling="laser", step_m=0.3, loops=2)
    mapper = fed(PlaneMapper(), (scan.points[:, :2] for scan in building.scans))
    return mapper, building.trajectory


def cut(run: tuple[PlaneMapper, Floats], poses: Floats, first: int = 0) -> list[int]:
    links = run[0].engine.association.registration.links  # type: ignore[attr-defined]
    found: list[int] = contradicted_revisits(poses, first, links.scans).tolist()
    return found


def bent(poses: Floats, k: int, turn_deg: float, shift_m: float) -> Floats:
    """Return poses of which those from a row on are turned about it, and shifted."""
    bend = planar_poses(*(np.array([value]) for value in (shift_m, 0.0, np.deg2rad(turn_deg))))
    there = poses[k] @ bend @ np.linalg.inv(poses[k])
    return np.concatenate([poses[:k], there @ poses[k:]])


def test_a_right_map_is_left(run: tuple[PlaneMapper, Floats]) -> None:
    assert cut(run, run[1]) == []
    assert cut(run, np.full_like(run[1], np.nan)) == []
    assert cut(run, bent(run[1], len(run[1]) // 2, 0.3, 0.05)) == []
    apart = run[1].copy()
    apart[::3] = np.nan
    assert cut(run, apart) == []


@pytest.mark.parametrize(("turn_deg", "shift_m"), [(6.0, 0.0), (-6.0, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize("share", [0.4, 0.6])
def test_a_map_that_was_bent_between_two_visits_is_cut(
    run: tuple[PlaneMapper, Floats], share: float, turn_deg: float, shift_m: float
) -> None:
    poses = run[1]
    k = int(share * len(poses))
    wrong = bent(poses, k, turn_deg, shift_m)
    for first in (0, FIRST):
        [found] = cut(run, wrong[first:], first)
        assert np.hypot(*(poses[found, :2, 3] - poses[k, :2, 3])) < NEAR_M


def test_a_map_that_was_bent_twice_is_cut_twice(run: tuple[PlaneMapper, Floats]) -> None:
    rows = [int(share * len(run[1])) for share in (0.5, 0.8)]
    wrong = run[1]
    for row in rows:
        wrong = bent(wrong, row, 6.0, 0.0)
    found = cut(run, wrong)
    away = run[1][found, :2, 3] - run[1][rows, :2, 3]
    assert (np.hypot(*away.T) < NEAR_M).all()


def test_a_scan_without_a_pose_is_not_cut(run: tuple[PlaneMapper, Floats]) -> None:
    """It may belong to another map, which the cut would divide."""
    poses = run[1]
    k = len(poses) // 2
    wrong = bent(poses, k, 6.0, 0.0)
    [whole] = cut(run, wrong)
    wrong[whole] = np.nan
    for found in cut(run, wrong):
        assert np.isfinite(wrong[found]).all()
        assert abs(found - whole) < 5
