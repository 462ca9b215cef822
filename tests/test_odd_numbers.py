"""Numbers that are legal and odd: tiny, huge, equal, repeated. Warnings are errors in the tests."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from relmap import MapperConfig, Plane3dMapper, PlaneMapper, PointMapper, RelmapError
from relmap.core.arrays import Floats
from relmap.core.association.metric import RayNoise
from relmap.core.association.rigidity import Rigidity
from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.geometry.spatialindex import SpatialIndex
from relmap.core.grouping.chart import PointChart
from relmap.core.state.table import LandmarkState
from relmap.segmentation.space import PatchSegmenter
from tests.worlds import refined

SCALES = [5e-324, 1e-300, 1e-160, 1e-20, 1e-8, 1e6]
OFFSETS = [0.0, 1e8, -1e5]
WORLD = np.random.default_rng(3).uniform(-8.0, 8.0, (12, 2))
SIDES = [axis.ravel() for axis in np.meshgrid(*[np.linspace(0.0, 3.0, 30)] * 2)]
ROOM = np.concatenate([np.insert(np.column_stack(SIDES), k, 0.0, axis=1) for k in range(3)])
WALLS = np.array([[[3.0, -2], [3, 2]], [[3, 2], [-1, 2]], [[-1, 2], [-1, -2]]])


def is_clean(trajectory: Floats) -> bool:
    """Return whether every pose is a rigid motion, or NaN throughout its upper rows."""
    known = np.isfinite(trajectory).all(axis=(1, 2))
    R = trajectory[known, :3, :3]
    rigid = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(initial=0.0) < 1e-6
    return bool(rigid and np.isnan(trajectory[~known, :3]).all())


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("odometry", [None, [1e8, 0.0, 1e-320]], ids=["none", "odometry"])
def test_points_of_any_size(scale: float, odometry: list[float] | None) -> None:
    for offset in OFFSETS:
        mapper = PointMapper()
        for k in range(8):
            points = WORLD * scale + offset - np.array([0.1 * k, 0.0]) * scale
            points = [points, np.repeat(points, 2, axis=0), points[:1], points * 0][max(k - 4, 0)]
            mapper.update(points, odometry=odometry)
        mapper.finish()
        assert is_clean(mapper.trajectory)
        mapper.refine()
        assert is_clean(mapper.trajectory)
        assert np.isfinite(mapper.map.positions).all()


@pytest.mark.parametrize("scale", SCALES)
def test_walls_of_any_size(scale: float) -> None:
    mapper = PlaneMapper()
    for k in range(8):
        ends = (WALLS - [0.1 * k, 0.0]) * scale
        mapper.update(SimpleNamespace(ends=ends), beams=ends.reshape(-1, 2))
    mapper.finish()
    mapper.refine()
    assert is_clean(mapper.trajectory)
    assert np.isfinite(mapper.map.positions).all()


@pytest.mark.parametrize("scale", SCALES)
def test_clouds_of_any_size(scale: float) -> None:
    mapper = refined(
        Plane3dMapper(PatchSegmenter()),
        ((ROOM - [1.0 + 0.1 * k, 1.0, 1.0]) * scale for k in range(3)),
    )
    assert is_clean(mapper.trajectory)


@pytest.mark.parametrize("kind", [PointMapper, PlaneMapper, Plane3dMapper])
def test_an_empty_list_is_an_empty_scan_and_a_mask_is_refused(kind: type[Any]) -> None:
    mapper = kind()
    mapper.update([])
    points = np.ma.MaskedArray(ROOM, mask=ROOM > 2.9)
    with pytest.raises(RelmapError, match="points has masked values; give only those that are"):
        mapper.update(points)
    mapper.update(np.ma.MaskedArray(ROOM[:0]))
    assert mapper.n_iterations == 2


def test_odometry_with_far_points_that_determine_no_motion() -> None:
    mapper = PointMapper()
    mapper.update([[1e8, 1e8], [1e8, 1e8]], odometry=[0.0, 0.0, 0.0])
    mapper.update([[0.0, 1e8]], odometry=[1e8, 0.0, 0.0])
    mapper.finish()
    assert is_clean(mapper.trajectory)


@pytest.mark.parametrize("row", [[0] * 7 + [*range(1, 6)], [*range(8)] * 3], ids=["one", "all"])
@pytest.mark.parametrize("registration", ["constellation", "nearest-previous"])
def test_scans_whose_points_mostly_coincide_are_mapped(registration: str, row: list[int]) -> None:
    mapper = PointMapper(MapperConfig(registration=registration))
    for k in range(20):
        mapper.update(WORLD[row] - [0.1 * k, 0.0])
    mapper.finish()
    mapper.refine()
    mapped = mapper.map.positions[:, None, :2] - WORLD[row]
    assert np.linalg.norm(mapped, axis=2).min(axis=0).max() < 1e-6


@pytest.mark.parametrize("d", [2, 3])
def test_a_crowded_scan_after_one_of_few_landmarks_far_away_is_another_place(d: int) -> None:
    mapper, rng = PointMapper(), np.random.default_rng(0)
    first = rng.normal(size=(10, d))
    mapper.update(100 * first / np.linalg.norm(first, axis=1)[:, None])
    labels = mapper.update(rng.uniform(-10.0, 10.0, (80, d)))
    assert labels.tolist() == list(range(10, 90))


def test_scans_that_never_agree_are_rejected_however_many_there_are() -> None:
    rigidity, rng, ids = Rigidity(), np.random.default_rng(0), np.arange(8)
    for _ in range(5):  # without noise
        rigidity.checked(ids, WORLD[:8])
    scans = rng.uniform(-8.0, 8.0, (1100, 8, 2))
    assert all(rigidity.checked(ids, scan) is None for scan in scans)


@pytest.mark.parametrize("d", [2, 3])
def test_landmarks_at_the_sensor_say_nothing_of_the_noise_by_distance(d: int) -> None:
    rays, zeros = RayNoise(), np.zeros((100, d))
    for _ in range(3):
        rays.learn(zeros, zeros, np.ones(100, dtype=np.int64))
    assert rays.is_unequal is None


def test_weights_of_hardly_any_noise_fit_as_others_do() -> None:
    source, at = WORLD * 1e6, np.zeros(12, dtype=np.int64)
    target = source @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + 1e9
    heavy, light = (fit_rigid_each(source, target, np.full(12, w), at, 1) for w in (1e300, 1.0))
    assert heavy[2].all()
    np.testing.assert_allclose(heavy[0], light[0], atol=1e-9)
    np.testing.assert_allclose(heavy[1], light[1])


def test_cells_beyond_whole_numbers_are_found() -> None:
    table = LandmarkState()
    table.resize(3, 0, 2)
    index = SpatialIndex(table, 1e-300)
    positions = np.array([[1e8, -1e8], [0.0, 0.0], [1e8, -1e8]])
    table.position[:], table.weight[:] = positions, 1.0
    index.add(np.arange(3))
    assert set(index.near(positions[:1], np.array([1]))[1].tolist()) >= {0, 2}


def test_landmarks_seen_too_rarely_for_a_group_take_no_time_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mapper, rng = PointMapper(), np.random.default_rng(0)
    for _ in range(3):
        mapper.update(rng.uniform(-50.0, 50.0, (200, 2)))
    charted: list[int] = []

    def around(seed: int, *rest: Any) -> PointChart:
        charted.append(seed)
        return whole(seed, *rest)

    whole = PointChart.around
    monkeypatch.setattr(PointChart, "around", around)
    mapper.finish()
    assert charted == []
    assert not len(mapper.map.positions)
