from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats
from tests.worlds import fed, random_rotation

Scans = list[Floats]


def seen_from(world: Floats, steps: int = 40, sigma: float = 0.01) -> Scans:
    rng = np.random.default_rng(1)
    d = world.shape[1]
    scans = []
    for k in range(steps):
        t = np.zeros(d)
        t[0] = 0.05 * k
        noise = sigma * rng.standard_normal(world.shape)
        scans.append((world - t) @ random_rotation(d, 0.05, rng) + noise)
    return scans


def finite(mapper: PointMapper) -> bool:
    """Refine; return whether all results of the map are finite."""
    mapper.finish()
    mapper.refine()
    found, table = mapper.map, mapper.landmarks
    fit = [np.isfinite(found.positions).all(), np.isfinite(found.covariances).all()]
    fit += [np.isfinite(table.sd[table.level > 0]).all()]
    return all(fit)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("d", [2, 3])
def test_landmarks_on_a_line(d: int) -> None:
    world = np.zeros((8, d))
    world[:, 0] = np.arange(8) * 2.0
    mapper = fed(PointMapper(), ((seen_from(world, 1, 0.0)[0], ids) for ids in [np.arange(8)] * 40))
    assert finite(mapper)
    # In space a line leaves the rotation about itself free: nothing is mapped.
    assert len(mapper.map.positions) == (8 if d == 2 else 0)
    assert (mapper.landmarks.status == ("static" if d == 2 else "unmapped")).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("d", [2, 3])
def test_fewer_than_fix_a_pose(d: int) -> None:
    world = np.random.default_rng(0).uniform(-5, 5, (d - 1, d))
    mapper = fed(PointMapper(), ((points, np.arange(d - 1)) for points in seen_from(world)))
    assert finite(mapper)
    assert len(mapper.map.positions) == 0
    assert np.isnan(mapper.trajectory).all()
    assert mapper.refined == []


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("d", [2, 3])
def test_two_submaps_that_never_meet(d: int) -> None:
    rng = np.random.default_rng(0)
    here, there = rng.uniform(-5, 5, (12, d)), rng.uniform(-5, 5, (9, d))
    mapper = fed(PointMapper(), ((points, np.arange(12)) for points in seen_from(here)))
    for points in seen_from(there):
        mapper.update(points, np.arange(100, 109))
    assert finite(mapper)
    assert [len(submap.landmark_ids) for submap in mapper.submaps] == [12, 9]
    assert all(np.isfinite(submap.positions).all() for submap in mapper.submaps)
    assert sorted(len(submap.landmarks) for submap in mapper.refined) == [9, 12]
    assert mapper.map.covariances.shape == (12, 3, 3)


@pytest.mark.filterwarnings("error")
def test_views_that_share_a_single_landmark() -> None:
    rng = np.random.default_rng(0)
    world = rng.uniform(-5, 5, (11, 2))
    mapper = fed(PointMapper(), ((points, np.arange(6)) for points in seen_from(world[:6])))
    for points in seen_from(world[5:]):
        mapper.update(points, np.arange(5, 11))
    assert finite(mapper)
