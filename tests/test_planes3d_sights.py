"""Planes in space: what scans saw through, before or after, is dynamic."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.planes3d.sights import is_dynamic
from tests.test_planes3d_covariances import patches, wall


def mapped(*screens: Floats | None) -> Plane3dMapper:
    """Return a mapper that saw a room, and in each scan a screen or none."""
    room, mapper = [wall(axis, 3.0) for axis in range(3)], Plane3dMapper()
    for screen in screens:
        mapper.update(patches(*room, *(() if screen is None else (screen,))))
    mapper.finish()
    return mapper


def hall_scan(x: float) -> Floats:
    """Return what 32 rings see in a long hall, 1.3 m above its floor."""
    azimuth, height = np.meshgrid(
        np.deg2rad(np.arange(0.0, 360.0, 0.9)), np.deg2rad(np.linspace(-25.0, 15.0, 32))
    )
    level = np.cos(height)
    ray = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(height)], axis=-1)
    ray = ray.reshape(-1, 3)
    ray[np.abs(ray) < 1e-9] = 1e-9
    low, high = np.array([-x, -8.0, -1.3]), np.array([30.0 - x, 9.0, 7.0])
    range_m = np.where(ray < 0, low / ray, high / ray).min(axis=1)
    return np.asarray(ray * range_m[:, None])


STANDS = wall(0, 2.0, (-0.5, 0.5))


@pytest.mark.parametrize("screens", [[None] * 4 + [STANDS] * 4, [STANDS] * 4 + [None] * 4])
def test_a_plane_that_scans_saw_through_before_or_after_is_dynamic(
    screens: list[Floats | None],
) -> None:
    assert mapped(*screens).planes.status.tolist() == ["static"] * 3 + ["dynamic"]


@pytest.mark.parametrize(
    ("scans", "looks", "dynamic"),
    [
        (6, (88, 12), True),
        (6, (92, 8), False),
        (6, (30, 6), False),
        (7, (88, 12), False),
        (7, (78, 22), True),
        (7, (0, 4), True),
        (7, (0, 3), False),
    ],
)
def test_a_plane_that_few_scans_saw_is_dynamic_if_fewer_looks_go_through(
    scans: int, looks: tuple[int, int], dynamic: bool
) -> None:
    part = mapped(*[STANDS] * scans, *[None] * 4).submaps[0]
    part.sights[3] = np.array(looks)
    assert is_dynamic(part).tolist() == [False] * 3 + [dynamic]


def test_a_plane_that_is_always_there_is_static() -> None:
    assert (mapped(*[STANDS] * 8).planes.status == "static").all()


def test_a_plane_that_slides_along_itself_is_dynamic() -> None:
    # Of a sensor that stands still, only rays that change count: this one moves.
    mapper, way = Plane3dMapper(), np.array([0.2, 0.1, 0.05])
    for k, at in enumerate(np.linspace(-0.7, 0.3, 8)):
        walls = [wall(axis, 3.0) for axis in range(3)] + [wall(0, 2.0, (at, at + 0.6))]
        mapper.update(patches(*(each - k * way for each in walls)))
    mapper.finish()
    # All scans see it, but not all of it.
    assert mapper.planes.observations.tolist() == [8] * 4
    assert mapper.planes.status.tolist() == ["static"] * 3 + ["dynamic"]
    mapper.refine()
    assert mapper.planes.status.tolist() == ["static"] * 3 + ["dynamic"]


def test_a_narrow_plane_is_not_seen_through_beside_it() -> None:
    # At such steps most rays are those of the scan before; those that change are at its edges.
    mapper, way = Plane3dMapper(), np.array([0.005, 0.018, 0.007])
    for k in range(40):
        walls = [wall(axis, 3.0) for axis in range(3)] + [wall(0, 2.0, (-0.2, 0.2))]
        mapper.update(patches(*(each - k * way for each in walls)))
    mapper.finish()
    there, through = np.sum(list(mapper.submaps[0].sights.values()), axis=0)
    assert there > 200
    assert through == 0


def test_a_floor_that_rays_graze_farther_away_is_static() -> None:
    mapper = Plane3dMapper()
    for x in np.linspace(4.0, 20.0, 20):
        mapper.update(hall_scan(x))
    mapper.finish()
    there, through = np.sum(list(mapper.submaps[0].sights.values()), axis=0)
    assert there > 500
    assert through == 0
    assert len(mapper.planes) == 5
    assert (mapper.planes.status == "static").all()


@pytest.mark.parametrize(("aside", "status"), [(0.03, "unmapped"), (0.3, "static")])
def test_a_plane_through_the_sensor_is_not_mapped(aside: float, status: str) -> None:
    # As of points between the edge of a cupboard and the wall behind it, while a camera rests.
    veil = wall(1, aside, (-0.5, 0.5)) + np.array([1.8, 0.0, 0.0])
    assert mapped(*[veil] * 4).planes.status.tolist() == ["static"] * 3 + [status]
