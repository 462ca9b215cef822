"""Planes in space: where a scan is expected if the sensor moves on as before."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.planes3d.steadiness import predicted
from relmap.planes3d.submap import Submap
from tests.test_planes3d_covariances import patches, wall


def along(places: Floats, turns: Floats) -> Submap:
    """Return a submap of scans at places (p, 3) that turn about the vertical."""
    part, seen = Submap(), patches(wall(0, 3.0))
    for k, (place, turn) in enumerate(zip(places, turns, strict=True)):
        part.add(k, seen, (Rotation.from_rotvec([0, 0, turn]).as_matrix(), place), np.arange(1))
    return part


def test_a_sensor_that_turns_is_expected_to_turn_on() -> None:
    turns = np.linspace(0.0, 1.65, 12)
    ring = 2 * np.column_stack([np.sin(turns), 1 - np.cos(turns), 0 * turns])
    held = predicted(along(ring[:11], turns[:11]))
    np.testing.assert_allclose(held.place, ring[11], atol=1e-9)


def test_a_sensor_that_speeds_up_is_expected_to_go_on_as_lately() -> None:
    way = np.column_stack([0.01 * np.arange(14) ** 2, np.zeros((14, 2))])
    held = predicted(along(way[:13], np.zeros(13)))
    np.testing.assert_allclose(held.place, 2 * way[12] - way[11], atol=1e-9)


def test_a_sensor_that_looks_around_is_expected_on_its_way() -> None:
    turns = np.asarray(0.5 * np.sin(np.arange(12)), dtype=np.float64)
    way = np.column_stack([0.2 * np.arange(12), np.zeros((12, 2))])
    held = predicted(along(way[:11], turns[:11]))
    np.testing.assert_allclose(held.place, way[11], atol=1e-9)
    assert held.off_m == pytest.approx(0.2)


def test_noise_of_steps_is_averaged() -> None:
    rng = np.random.default_rng(0)
    off = []
    for _ in range(40):
        way = np.column_stack([0.2 * np.arange(15), np.zeros((15, 2))])
        way[:14] += 0.01 * rng.standard_normal((14, 3))
        off.append(predicted(along(way[:14], np.zeros(14))).place - way[14])
    # By the last step alone it would be 0.022 along each axis.
    assert np.sqrt(np.mean(np.square(off))) < 0.019


def test_steps_that_were_assumed_do_not_tell_how_the_sensor_moves() -> None:
    way = np.column_stack([0.2 * np.arange(4), np.zeros((4, 2))])
    part = along(way, np.zeros(4))
    part.held = {1, 2, 3}
    held = predicted(part)
    np.testing.assert_allclose(held.place, [0.8, 0, 0], atol=1e-9)
    assert held.off_m == np.inf
