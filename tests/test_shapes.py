"""Places in two submaps agree if the covariances of both explain how they differ."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats
from relmap.core.association.reobservation.recognition import PlaceFinder
from relmap.core.association.reobservation.shapes import Shapes
from relmap.core.refinement.joint import Refined
from relmap.simulation import WorldSpec, simulate_world
from tests.worlds import purity_of, refined, without_ids

SIGMA_M, POSTS = 0.05, 24


def posts_along(rng: np.random.Generator) -> Floats:
    """Return posts (n, 2) along a path, about 3 m apart."""
    x = 3.0 * np.arange(POSTS) + rng.uniform(-1, 1, POSTS)
    return np.column_stack([x, rng.uniform(-4, 4, POSTS)])


def driven_past(posts: Floats, rng: np.random.Generator, first: int = 0) -> Refined:
    """Return the refined map of posts (n, 2), seen few at a time, with numbers from `first`."""
    scans = []
    for x in np.arange(-3.0, posts[:, 0].max(), 0.8):
        points = posts - [x, 0.0]
        ids = np.flatnonzero((points[:, 0] > 0) & (points[:, 0] < 12))
        scans.append((points[ids] + rng.normal(0, SIGMA_M, (len(ids), 2)), ids))
    mapper = refined(PointMapper(), scans)
    (found,) = mapper.engine.refined
    ids = np.concatenate([ids for _, ids in scans])
    assert np.array_equal(mapper.submaps[0].landmark_ids, np.unique(ids))
    assert found.has_joint_covariances
    return replace(found, landmarks=first + np.arange(POSTS))


def two_maps(seed: int) -> tuple[Refined, Refined]:
    """Return two maps of the same posts; the second one is numbered from `POSTS`."""
    rng = np.random.default_rng(seed)
    posts = posts_along(rng)
    return driven_past(posts, rng), driven_past(posts, rng, POSTS)


EVERY = np.arange(POSTS)


def test_two_maps_of_a_place_agree_however_far_they_drift() -> None:
    """Averaged positions agree less closely than independent ones would."""
    close = []
    for seed in range(6):
        first, second = two_maps(seed)
        shapes = Shapes([first, second])
        assert shapes.know(EVERY)
        assert shapes.agree(EVERY, POSTS + EVERY)
        assert shapes.agree(POSTS + EVERY, EVERY)
        finder = PlaceFinder(second.positions, SIGMA_M)
        close.append(finder.is_close(first.positions, EVERY, np.full((2, POSTS), 12.0), n_maps=2))
    assert sum(close) <= 2


def test_the_accepted_probability_is_met(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of pairs of maps of the same place, half differ by more than the median of chi-squared."""
    monkeypatch.setattr("relmap.core.association.reobservation.shapes.UNLIKELY", 0.5)
    agree = [bool(Shapes(two_maps(seed)).agree(EVERY, POSTS + EVERY)) for seed in range(100, 160)]
    assert 20 <= sum(agree) <= 40


@pytest.mark.parametrize("row", [6, 12, 18])
def test_another_place_does_not_agree(row: int) -> None:
    """A post stands 0.35 m aside; elsewhere another stretch is compared."""
    first, second = two_maps(row)
    moved = second.positions.copy()
    moved[row, 1] += 0.35
    assert not Shapes([first, replace(second, positions=moved)]).agree(EVERY, POSTS + EVERY)
    shapes, some = Shapes([first, second]), np.arange(8)
    assert shapes.agree(some, POSTS + some)
    assert not shapes.agree(some, POSTS + some + row % 5 + 1)


def test_without_joint_covariances_nothing_is_known() -> None:
    first, second = two_maps(0)
    assert Shapes([first]).agree(EVERY, POSTS + EVERY) is None
    assert not Shapes([replace(first, converged=False)]).know(EVERY)
    assert Shapes([first, second]).agree(EVERY, POSTS + EVERY - 1) is None  # of both submaps
    assert Shapes().agree(EVERY, POSTS + EVERY) is None
    exact = [replace(one, noise_m=1e-9) for one in (first, second)]
    assert Shapes(exact).agree(EVERY, POSTS + EVERY) is None  # covariances of rounding


@pytest.mark.parametrize(
    "spec",
    [
        WorldSpec(spacing_m=7.0, seed=16),
        WorldSpec(spacing_m=6.0, missed=0.2, seed=1),
        WorldSpec(spacing_m=6.0, missed=0.2, spurious=0.1, seed=3),
        WorldSpec(spacing_m=6.0, space=True, seed=14),
    ],
)
def test_submaps_of_few_landmarks_in_view_are_joined(spec: WorldSpec) -> None:
    """They were two or three submaps, each right."""
    world = simulate_world(spec)
    mapper, labels = without_ids(world.log)
    mapper.refine()
    labels = mapper.landmarks_of(labels)
    n_seen = len(np.unique(world.true_ids[world.true_ids >= 0]))
    assert 0.9 * n_seen <= len(mapper.submaps[0].landmark_ids) <= 1.02 * n_seen
    assert purity_of(labels, world.true_ids) > 0.998


def test_a_loaded_map_in_submaps_is_finished_and_refined_again(tmp_path: Path) -> None:
    """Loaded maps have no joint covariances until they are refined."""
    world = simulate_world(WorldSpec(spacing_m=7.0, seed=14))
    mapper, _ = without_ids(world.log)
    mapper.refine()
    sizes = [len(submap.landmark_ids) for submap in mapper.submaps]
    assert len(sizes) > 1
    mapper.save(tmp_path / "mapper.npz")
    loaded = PointMapper.load(tmp_path / "mapper.npz")
    loaded.finish()
    loaded.refine()
    assert [len(submap.landmark_ids) for submap in loaded.submaps] == sizes
