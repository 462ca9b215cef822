"""Mappers that refine: how far, how often, in which frame, and how sure they are."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.readout import labels
from relmap.simulation import simulate_figure_eight
from tests.worlds import aligned_rmse, driven, limit_of, mapped, walk

both_dimensions = pytest.mark.parametrize("d", [2, 3])


def test_mapper_refines_to_the_limit() -> None:
    for seed in (20, 21):
        world = simulate_figure_eight(seed=seed)
        mapper = driven(world.log)
        mapper.refine()
        assert len(mapper.map.positions) == len(world.landmarks_map)
        rmse = aligned_rmse(mapper.map.positions, world.landmarks_map)
        assert rmse <= 1.02 * limit_of(world.log, world.landmarks_map)


def test_refinement_keeps_what_it_cannot_improve() -> None:
    mapper = mapped(walk(3, 5).scans)
    before = mapper.map.positions
    mapper.refine()
    np.testing.assert_allclose(mapper.map.positions, before, atol=1e-9)
    empty = PointMapper()
    empty.refine()
    assert len(empty.map.positions) == 0


def test_refining_twice_or_on_the_way_changes_nothing() -> None:
    world = walk(3, 6, sigma=0.05)
    once = mapped(world.scans)
    once.refine()
    often = PointMapper()
    for k, (ids, points) in enumerate(world.scans):
        often.update(points, ids)
        if k % 50 == 49:
            often.refine()
    often.finish()
    often.refine()
    often.refine()
    np.testing.assert_allclose(often.map.positions, once.map.positions, atol=1e-4)


@both_dimensions
def test_mapper_provides_covariances_of_the_map(d: int) -> None:
    world = walk(d, 8, sigma=0.05)
    mapper = mapped(world.scans)
    before = mapper.map.covariances
    mapper.refine()
    found, table = mapper.map, mapper.landmarks
    assert before.shape == found.covariances.shape == (len(found.positions), 3, 3)
    assert (np.linalg.eigvalsh(found.covariances[:, :d, :d]) > 0).all()
    assert (found.covariances[:, d:] == 0).all()
    sd = table.sd[table.level > 0]
    variance = np.trace(found.covariances, axis1=1, axis2=2) / d
    np.testing.assert_allclose(sd, np.sqrt(variance))
    # Landmarks farther from the first pose are less certain.
    far = np.linalg.norm(found.positions, axis=1)
    assert sd[far > 15].min() > sd[far < 5].max()
    mapper.update(world.scans[-1][1], world.scans[-1][0])
    np.testing.assert_allclose(mapper.map.covariances, before, rtol=0.2)


@both_dimensions
def test_the_frame_is_that_of_the_first_iteration(d: int) -> None:
    world = walk(d, 9, sigma=0.05)
    mapper = mapped(world.scans)
    mapper.refine()
    np.testing.assert_allclose(mapper.trajectory[0], np.eye(4), atol=1e-3)


@both_dimensions
def test_a_landmark_displaced_for_a_while_does_not_bend_the_map(d: int) -> None:
    """As under a wrong id: its own segment is consistent, so only other segments show it."""
    errors: list[float] = []
    sound: list[float] = []
    for seed in range(3):
        world = walk(d, seed, sigma=0.02)
        scans = [(ids, points.copy()) for ids, points in world.scans]
        for ids, points in scans[56:66]:
            points[ids == 10] += 3.0
        for log, found in ((scans, errors), (world.scans, sound)):
            mapper = mapped(log)
            mapper.refine()
            others = mapper.map.landmark_ids != 10
            ids, positions = mapper.map.landmark_ids[others], mapper.map.positions[others, :d]
            found.append(aligned_rmse(positions, world.landmarks[ids]))
    assert max(errors) < 2 * max(sound)


@both_dimensions
def test_a_landmark_that_nothing_ties_to_the_others_is_not_refined_with_them(d: int) -> None:
    world = walk(d, 4, sigma=0.02)
    (ids, points), *rest = world.scans
    once = np.append(ids, 10_000), np.vstack([points, np.full((1, d), 4.0)])
    mapper = mapped([once, *rest])
    engine = mapper.engine
    number = np.flatnonzero(labels(engine) == 10_000)
    engine.map.place(engine.map.first, number, np.full((1, d), 4.0), np.ones(1))
    assert 10_000 in mapper.map.landmark_ids
    mapper.refine()
    assert 10_000 not in mapper.map.landmark_ids
    assert len(mapper.refined[0].landmarks) == len(mapper.map)
