"""Planes in space: where a scan is expected if the sensor moves on as before."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.planes3d.hypotheses import Held
from relmap.planes3d.placing import place
from relmap.planes3d.steadiness import predicted
from relmap.planes3d.submap import Submap
from relmap.segmentation.space import PatchSegmenter
from tests.test_planes3d_covariances import patches, wall


def along(places: Floats, turns: Floats) -> Submap:
    """Return a submap of scans at places (p, 3) that turn about the vertical."""
    part, seen = Submap(), patches(wall(0, 3.0))
    for k, (at, turn) in enumerate(zip(places, turns, strict=True)):
        part.add(k, seen, (Rotation.from_rotvec([0, 0, turn]).as_matrix(), at), np.arange(1))
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


def piece(axis: int, at: float, *spans: tuple[float, float]) -> Floats:
    """Return points (n, 3) of a wall across an axis; `spans` along the next two."""
    u, v = (x.ravel() for x in np.meshgrid(*(np.linspace(*span, 60) for span in spans)))
    off = 0.003 * np.random.default_rng(axis).standard_normal(len(u))
    return np.roll(np.column_stack([at + off, u, v]), axis, axis=1)


@pytest.mark.parametrize(("at", "way_m"), [(0.8, -0.5), (1.9, 0.0)])
def test_a_plane_that_may_be_another_outweighs_the_prediction_if_it_explains_as_much(
    at: float, way_m: float
) -> None:
    ends = piece(2, -1.0, (0.0, 3.0), (-2.0, 2.0)), piece(0, 3.0, (-2.0, 2.0), (-1.0, 1.0))
    there, seen = (
        PatchSegmenter().fit(np.concatenate([*ends, piece(1, y, (0.0, 0.8), (1.0, 2.0))])).patches_
        for y in (0.3, at)
    )
    placed = place(seen, there, (np.eye(3), np.zeros(3)), Held(np.zeros(3), 0.05))
    assert placed is not None
    np.testing.assert_allclose(placed.t, [0.0, way_m, 0.0], atol=0.02)
