"""Simulated storeys and houses: scans lie on the true faces, boxes move, and the map is right."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from relmap import Plane3dMapper, RelmapError
from relmap.core.arrays import Floats, Ints
from relmap.simulation.storey import Storey, simulate_storey
from tests.worlds import ate_m, refined


@pytest.fixture(scope="module")
def house() -> Storey:
    return simulate_storey("lidar", 0.01, 60, 2, storeys=2)


def off_faces(world: Storey, points: Floats, face: Ints) -> Floats:
    """Return how far points in the map frame are off the rectangles of their faces."""
    corner, *others = world.corners[face].transpose(1, 0, 2)
    sides = np.stack([others[0] - corner, others[2] - corner], axis=1)
    share = np.einsum("nki,ni->nk", sides, points - corner) / (sides**2).sum(axis=2)
    nearest = corner + np.einsum("nk,nki->ni", np.clip(share, 0, 1), sides)
    return np.asarray(np.linalg.norm(points - nearest, axis=1))


def in_map(world: Storey, k: int) -> Floats:
    pose = world.trajectory[k]
    return np.asarray(world.scans[k] @ pose[:3, :3].T + pose[:3, 3])


@pytest.mark.parametrize("sensor", ["lidar", "depth"])
def test_points_lie_on_the_faces_of_the_house(sensor: Any) -> None:
    world = simulate_storey(sensor, 0.0, 8, storeys=2)
    for k in range(8):
        assert len(world.scans[k])
        assert off_faces(world, in_map(world, k), world.faces[k]).max() < 1e-9


def test_the_sensor_is_carried_up_the_stairs_and_touches_nothing(house: Storey) -> None:
    height = house.trajectory[:, 2, 3]
    assert height[-1] - height[0] == pytest.approx(3.1, abs=0.1)
    assert min(np.linalg.norm(scan, axis=1).min() for scan in house.scans) > 0.2
    assert np.linalg.norm(np.diff(house.trajectory[:, :3, 3], axis=0), axis=1).max() < 0.55


def test_boxes_move_and_belong_to_no_face() -> None:
    still = simulate_storey("lidar", 0.0, 6)
    world = simulate_storey("lidar", 0.0, 6, moving=2)
    places = []
    for k in range(6):
        on_box = world.faces[k] < 0
        # Everything else is as it is without boxes.
        np.testing.assert_array_equal(world.scans[k][~on_box], still.scans[k][~on_box])
        box = in_map(world, k)[on_box & (in_map(world, k)[:, 0] < 6.0)]
        places.append(box[:, 1].min())
    assert (np.abs(np.diff(places)) > 0.05).sum() >= 4
    assert world.corners.shape == still.corners.shape


def test_no_point_is_behind_the_sensor_however_large_the_noise() -> None:
    assert (simulate_storey("depth", 5.0, 2).scans[1][:, 0] >= 0).all()


def test_settings_out_of_range_are_refused() -> None:
    for settings in ({"storeys": 3}, {"storeys": 0}, {"moving": -1}):
        with pytest.raises(RelmapError, match="storeys must be 1 or 2"):
            simulate_storey("lidar", iterations=1, **settings)
    with pytest.raises(RelmapError, match="seed is -1; it must not be negative"):
        simulate_storey(seed=-1)


def test_a_house_is_mapped_over_the_stairs(house: Storey) -> None:
    mapper = refined(Plane3dMapper(), house.scans)
    assert len(mapper.submaps[0].iteration) == 60
    assert ate_m(mapper.trajectory, house.trajectory, planar=False) < 0.005


def test_planes_of_a_box_that_moves_are_dynamic() -> None:
    world = simulate_storey("lidar", 0.01, 40, 4, moving=1)
    mapper = refined(Plane3dMapper(), world.scans)
    planes, pose = mapper.planes, world.trajectory[0]
    centre = planes.centre @ pose[:3, :3].T + pose[:3, 3]
    # The box is moved along x = 4 to 4.6; nothing else is there between the walls and below 1.2 m.
    x, y, z = centre.T
    of_box = (x > 3.8) & (x < 4.8) & (y > 0.3) & (y < 6.5) & (z > 0.2) & (z < 1.2)
    moved = planes.status == "dynamic"
    assert (of_box & moved).sum() >= 1
    assert not (moved & ~of_box).any()
    assert not (of_box & (planes.status == "static") & (planes.area_m2 > 0.5)).any()
