"""Groups, refinement residuals and labels of a plane mapper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap import PlaneMapper, PlaneSegmenter, RelmapError
from relmap.core.arrays import Floats
from relmap.planes.refinement.solving import corner_covariances
from relmap.simulation import Building, simulate_building
from tests.worlds import finished

ITERATIONS = 64


def mapped(seed: int) -> tuple[Building, PlaneMapper]:
    """Map a building from clouds, or if there is a seed from laser scans."""
    sampling = {"points": 361, "sampling": "laser"} if seed else {"points": 250}
    building = simulate_building(sigma=0.05, seed=seed, iterations=ITERATIONS, **sampling)
    mapper = finished(
        PlaneMapper(segmenter=PlaneSegmenter()),
        (scan.points[:, :2] if seed else scan.points for scan in building.scans),
    )
    return building, mapper


@pytest.fixture(scope="module")
def runs() -> list[tuple[Building, PlaneMapper]]:
    found = [mapped(seed) for seed in range(3)]
    for _, mapper in found[1:]:
        mapper.refine()
    return found


def errors(building: Building, mapper: PlaneMapper) -> Floats:
    """Return how far corners (c, 2) are from the nearest true ones, seen from the first pose."""
    T = building.trajectory[0] @ np.linalg.inv(mapper.trajectory[0])
    there = mapper.map.positions[:, :2] @ T[:2, :2].T + T[:2, 3]
    off = building.walls[:, :4].reshape(-1, 2) - there[:, None]
    nearest = np.argmin(np.linalg.norm(off, axis=2), axis=1)
    return np.asarray(off[np.arange(len(there)), nearest] @ T[:2, :2])


def test_groups_are_of_landmarks_that_are_handed_out(
    runs: list[tuple[Building, PlaneMapper]],
) -> None:
    for _, mapper in runs:
        groups, labels = mapper.groups, mapper.landmarks.landmark
        assert any(len(group.landmarks) >= 3 for group in groups)
        for group, walls in zip(groups, mapper.group_walls, strict=True):
            assert np.isin(group.landmarks, labels).all()
            assert group.relative_map.shape == (len(group.landmarks), 2)
            assert len(group.n_observations) == len(group.landmarks)
            assert np.isin(walls, mapper.planes.plane).all()


def test_covariances_match_the_errors(runs: list[tuple[Building, PlaneMapper]]) -> None:
    squares = []
    for building, mapper in runs[1:]:
        covariances = mapper.map.covariances
        assert covariances.shape == (len(mapper.map.landmark_ids), 3, 3)
        off = errors(building, mapper)
        weighed = np.linalg.solve(covariances[:, :2, :2], off[..., None])[..., 0]
        squares.append((weighed * off).sum(axis=1))
        table = mapper.landmarks
        at = np.searchsorted(table.landmark, mapper.map.landmark_ids)
        sd_m = np.sqrt(np.trace(covariances, axis1=1, axis2=2) / 2)
        np.testing.assert_allclose(table.sd[at], sd_m, rtol=1e-12)
    assert 0.3 < np.median(np.concatenate(squares)) / 1.386 < 3.0  # chi-square of 2 freedoms


def test_covariances_cover_the_residuals(runs: list[tuple[Building, PlaneMapper]]) -> None:
    submap = runs[1][1].submaps[0].assembled
    assert submap is not None
    given = submap.given
    # The noise is given too small by half: the covariances would be by three quarters.
    less = replace(given, sd=given.sd / 2, corner_sd=given.corner_sd / 2)
    found = corner_covariances(replace(submap, given=less))
    sizes = np.trace(found, axis1=1, axis2=2) / np.trace(
        corner_covariances(submap), axis1=1, axis2=2
    )
    assert 0.6 < np.median(sizes) < 1.5


def test_residuals_are_what_the_noise_explains(runs: list[tuple[Building, PlaneMapper]]) -> None:
    for _, mapper in runs[1:]:
        (refined,) = mapper.refined
        np.testing.assert_array_equal(refined.landmarks, mapper.map.landmark_ids)
        np.testing.assert_array_equal(refined.covariances, mapper.map.covariances[:, :2, :2])
        segments = refined.segments
        assert segments.first_iteration.tolist() == list(range(0, ITERATIONS, 8))
        assert 0.7 < np.median(segments.residual) < 1.4
        assert np.isfinite(segments.middle).all()
        assert np.isin(refined.merges.landmark, refined.landmarks).all()
        assert not np.isin(refined.merges.track, refined.landmarks).any()


def test_unrefined_maps_have_no_residuals(runs: list[tuple[Building, PlaneMapper]]) -> None:
    mapper = runs[0][1]
    assert mapper.refined == []
    assert mapper.map.covariances.shape == (0, 3, 3)
    assert PlaneMapper().map.covariances.shape == (0, 3, 3)
    assert PlaneMapper().groups == []


@pytest.mark.parametrize("label", [-1, 10**6])
def test_walls_never_numbered_are_refused(
    runs: list[tuple[Building, PlaneMapper]], label: int
) -> None:
    for _, mapper in runs:
        with pytest.raises(RelmapError, match=f"labels holds {label}, which no update"):
            mapper.landmarks_of([0, label])
    assert PlaneMapper().landmarks_of([]).tolist() == []
