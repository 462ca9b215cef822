"""Planes in space: edges show where a scan is along what its planes leave open."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.simulation.storey import COLUMNS, FOCAL, ROWS, cast_rays

FAR, HIGH = 40.0, 2.6
PLACES = [0.0, 0.05, 0.2, 0.2, 0.15, 0.25]
Face = tuple[Floats, Floats, Floats]


def face(corner: tuple[float, ...], a: tuple[float, ...], b: tuple[float, ...]) -> Face:
    return np.array(corner), np.array(a), np.array(b)


def before_a_wall(*openings: tuple[float, float]) -> list[Face]:
    """Return floor, ceiling, a wall with openings (start, end) 3 m ahead, and one 5 m ahead."""
    faces = [face((-FAR, -FAR, z), (2 * FAR, 0, 0), (0, 2 * FAR, 0)) for z in (-1.3, HIGH - 1.3)]
    faces.append(face((5, -FAR, -1.3), (0, 2 * FAR, 0), (0, 0, HIGH)))
    ends = [-FAR, *(y for opening in openings for y in opening), FAR]
    for start, end in zip(ends[::2], ends[1::2], strict=True):
        faces.append(face((3, start, -1.3), (0, end - start, 0), (0, 0, HIGH)))
    return faces


def mapped(faces: list[Face], places: list[float], finer: int = 1) -> Plane3dMapper:
    """Map what a depth camera, with as many times finer pixels, sees that moves along the wall."""
    rng, mapper = np.random.default_rng(0), Plane3dMapper()
    row, column = np.mgrid[: finer * ROWS, : finer * COLUMNS] / finer
    y, z = -(column - (COLUMNS - 1) / 2) / FOCAL, -(row - (ROWS - 1) / 2) / FOCAL
    rays = np.stack([np.ones_like(y), y, z], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    origin = np.array([corner for corner, *_ in faces])
    sides = np.array([[a, b] for _, a, b in faces])
    for at in places:
        range_m, _ = cast_rays(np.array([0.0, at, 0.0]), rays, origin, sides)
        range_m += 0.003 * rng.standard_normal(len(rays))
        mapper.update(range_m[:, None] * rays)
    return mapper


def test_a_door_shows_how_far_the_sensor_moved_along_its_wall() -> None:
    mapper = mapped(before_a_wall((-0.5, 0.5)), PLACES)
    assert len(mapper.submaps) == 1
    np.testing.assert_allclose(mapper.submaps[0].trajectory[:, 1, 3], PLACES, atol=0.03)
    mapper.finish()
    mapper.refine()
    np.testing.assert_allclose(mapper.trajectory[:, 1, 3], PLACES, atol=0.03)
    # No plane shows it.
    assert set(mapper.weak_links) == {1, 2, 3, 4, 5}


def pieces(at: Floats) -> list[Face]:
    """Return pieces of 0.06 m in front of a wall, too small to be planes, centred at (n, 3)."""
    a, b = np.array([0.02, 0.06, 0.0]), np.array([0.02, 0.0, 0.06])
    return [(each - (a + b) / 2, a, b) for each in at]


AT = np.random.default_rng(1).uniform([1.8, -1.0, -0.8], [2.6, 1.2, 0.8], (12, 3))


def test_small_objects_show_how_far_the_sensor_moved_along_a_wall() -> None:
    mapper = mapped([*before_a_wall(), *pieces(AT)], PLACES, finer=2)
    assert len(mapper.submaps) == 1
    assert len(mapper.submaps[0].planes(np.arange(3))) == len(mapper.submaps[0]) == 3
    np.testing.assert_allclose(mapper.submaps[0].trajectory[:, 1, 3], PLACES, atol=0.03)
    mapper.finish()
    # No plane shows it.
    assert set(mapper.weak_links) == {1, 2, 3, 4, 5}


@pytest.mark.parametrize("openings", [[], [(0.3 * k, 0.3 * k + 0.15) for k in range(-12, 13)]])
def test_a_wall_without_edges_or_with_many_alike_shows_nothing(
    openings: list[tuple[float, float]],
) -> None:
    mapper = mapped(before_a_wall(*openings), [0.0, 0.0, 0.08])
    part = mapper.submaps[0]
    assert part.iteration == [0, 1, 2]
    assert part.held == {1, 2}
    np.testing.assert_allclose(part.trajectory[:, 1, 3], 0.0, atol=0.01)
