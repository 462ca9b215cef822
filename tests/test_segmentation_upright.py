"""Clouds that show floors, ceilings or tilted walls are refused: they would be taken for walls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap import PlaneMapper, PlaneSegmenter, RelmapError
from relmap.core.arrays import Floats
from relmap.datasets import open_scans
from relmap.segmentation.space.levelling import tilted_share
from relmap.simulation import simulate_building
from relmap.simulation.building import building_scene
from relmap.simulation.floor_plan import World
from relmap.simulation.sensor import Sampling


def room(rng: np.random.Generator, height_m: float = 3.0) -> Floats:
    """Return points on the walls, the floor and the ceiling of a room of 8 m by 6 m."""
    x, y, z = (rng.uniform(-0.5, 0.5, 6000) * side for side in (8.0, 6.0, height_m))
    faces = np.tile([0, 1, 2], 2000)
    side = np.where(np.arange(6000) < 3000, -0.5, 0.5)
    x, y = np.where(faces == 0, 8 * side, x), np.where(faces == 1, 6 * side, y)
    z = np.where(faces == 2, height_m * side, z)
    return np.column_stack([x, y, z]) + rng.normal(0, 0.02, (6000, 3))


def turned(xyz: Floats, tilt_deg: float) -> Floats:
    """Return points as a sensor that is pitched sees them."""
    c, s = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
    return np.asarray(xyz @ [[c, 0, -s], [0, 1, 0], [s, 0, c]])


def test_floor_and_ceiling_are_refused_and_a_band_between_is_not() -> None:
    xyz = room(np.random.default_rng(0))
    expected = r"^3\d% of a scan's points lie on surfaces that are not upright.* expected walls: "
    with pytest.raises(RelmapError, match=expected):
        PlaneSegmenter().fit(xyz)
    with pytest.raises(RelmapError, match=expected):
        PlaneMapper().update(xyz)
    band = xyz[np.abs(xyz[:, 2]) < 1.2]
    assert len(PlaneSegmenter().fit(band).planes_) == 4
    with pytest.raises(RelmapError, match="not upright"):
        PlaneSegmenter().fit(turned(band, 30.0))


def test_only_the_first_scans_decide() -> None:
    """A ramp in the middle of a long run does not end it."""
    xyz = room(np.random.default_rng(0))[::2]
    segmenter = PlaneSegmenter("ransac")
    for _ in range(5):
        segmenter.fit(xyz[np.abs(xyz[:, 2]) < 1.2])
    segmenter.fit(xyz)


@pytest.mark.parametrize("world", ["building", "panels", "long-wall"])
@pytest.mark.parametrize("sampling", ["surface", "rays"])
@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.3])
def test_simulated_walls_are_upright(world: World, sampling: Sampling, sigma: float) -> None:
    run = simulate_building(500, sigma, seed=0, world=world, sampling=sampling, step_m=3.0)
    shares = [tilted_share(scan.points) for scan in run.scans if len(scan.points)]
    assert len(shares) > 10
    assert max(shares) == 0


def test_what_has_no_height_is_not_a_floor() -> None:
    scan = building_scene(0, 361, 0.01, sampling="laser").points
    for height_m in (0.0, 0.01, 0.1):
        z = np.random.default_rng(0).uniform(0, 1, len(scan)) * height_m
        assert tilted_share(np.column_stack([scan[:, :2], z])) == 0
    PlaneSegmenter().fit(scan)


def test_the_hall_is_refused(shared_data: Path) -> None:
    log = open_scans(shared_data / "lidar3d-hall")
    with pytest.raises(RelmapError, match="not upright"):
        PlaneSegmenter().fit(log.points_of(0))
