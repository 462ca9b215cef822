"""Landmarks in a pattern that repeats: no scan is matched to another a period away."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.association import Constellation
from relmap.core.association.search import search
from relmap.core.association.search_kernels import shortest_period
from tests.worlds import purity_of

REACH_M, WIDTH_M = 20.0, 8.0
SIGMA_M = 0.03
WINDOW = [(0.0, 0.0), (1.2, 0.0), (1.2, 1.5), (0.0, 1.5)]


def avenue(
    period_m: float, jitter_m: float, missing: float, rng: np.random.Generator
) -> tuple[Floats, Ints]:
    """Return posts (n, 2) on both sides of a road of 150 m, and their ids."""
    x = np.arange(-12, 162, period_m)
    sides = [np.column_stack([x, np.full(len(x), y)]) for y in (-WIDTH_M / 2, WIDTH_M / 2)]
    posts = np.concatenate(sides)
    posts = posts[rng.random(len(posts)) >= missing]
    posts += rng.normal(0, jitter_m, posts.shape)
    return posts, np.arange(len(posts))


def scans_along(
    posts: Floats, ids: Ints, step_m: float, rng: np.random.Generator
) -> list[tuple[Floats, Ints]]:
    """Return the posts in view ahead, robot frame, of each scan along the road, and their ids."""
    scans = []
    for x in np.arange(0, 130, step_m):
        points = posts - [x, 0]
        seen = np.linalg.norm(points, axis=1) <= REACH_M
        seen &= np.abs(np.arctan2(points[:, 1], points[:, 0])) <= np.pi / 3
        order = rng.permutation(np.flatnonzero(seen))
        scans.append((points[order] + rng.normal(0, SIGMA_M, (len(order), 2)), ids[order]))
    return scans


@pytest.mark.parametrize(
    ("period_m", "jitter_m", "missing"), [(6.0, 0.05, 0.0), (6.0, 0.05, 0.1), (3.0, 0.1, 0.2)]
)
@pytest.mark.parametrize("seed", range(3))
def test_tracks_along_an_avenue_are_pure(
    period_m: float, jitter_m: float, missing: float, seed: int
) -> None:
    """Also where a scan matches none at first, and its neighbour may be a period away."""
    rng = np.random.default_rng(seed)
    registration, labels, true = Constellation(5), [], []
    scans = scans_along(*avenue(period_m, jitter_m, missing, rng), period_m / 3, rng)
    for k, (points, ids) in enumerate(scans):
        if k % 10 == 9:  # a scan of which most is hidden
            points, ids = points[:2], ids[:2]
        labels.append(registration.match(points, None))
        true.append(ids)
    label, landmark = np.concatenate(labels), np.concatenate(true)
    n_pure = sum(
        np.unique(landmark[label == one], return_counts=True)[1].max() for one in set(label)
    )
    assert n_pure / len(label) > 0.98
    assert registration.tied_share > 0.6


@pytest.mark.parametrize("step_m", [0.0, 0.3, 1.2])
@pytest.mark.parametrize(
    ("sides", "jitter_m"), [(1, 0.0), (1, 0.02), (2, 0.0), (2, 0.02), (5, 0.0), (5, 0.05)]
)
def test_short_steps_along_exact_rows_are_matched(
    step_m: float, sides: int, jitter_m: float
) -> None:
    """A step of less than half of the period is assumed, also while the noise is unknown."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(-40, 80, 4.0), np.arange(sides) * 5.0 + 1)
    posts = np.column_stack([x.ravel(), y.ravel()]) + rng.normal(0, jitter_m, (x.size, 2))
    registration, seen, labels = Constellation(5), set[int](), set[int]()
    for k in range(20):
        points = posts - [k * step_m, 0]
        ids = rng.permutation(np.flatnonzero(np.linalg.norm(points, axis=1) < REACH_M))
        found = registration.match(points[ids] + rng.normal(0, 0.02, (len(ids), 2)), None)
        seen |= set(ids.tolist())
        labels |= set(found.tolist())
    assert registration.tied_share == 1.0
    assert len(labels) == len(seen)


@pytest.mark.parametrize("seed", range(5))
def test_patterns_that_repeat_are_known(seed: int) -> None:
    """A lattice with gaps and two rows of posts repeat; scattered landmarks do not."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(5) * 3.0, np.arange(4) * 5.0)
    lattice = np.column_stack([x.ravel(), y.ravel()])
    lattice = lattice[rng.permutation(20)[:16]] + rng.normal(0, 0.05, (16, 2))
    assert shortest_period(lattice, 0.3, np.inf) == pytest.approx(3.0, abs=0.2)
    posts = avenue(6.0, 0.05, 0.0, rng)[0]
    assert shortest_period(posts, 0.3, np.inf) == pytest.approx(6.0, abs=0.2)
    with_bush = np.vstack([posts, posts.mean(axis=0) + 0.8])
    assert shortest_period(with_bush, 0.3, np.inf) == pytest.approx(6.0, abs=0.2)
    assert shortest_period(rng.uniform(0, 16, (20, 2)), 0.3, np.inf) == np.inf
    assert shortest_period(rng.uniform(0, 16, (20, 3)), 0.3, np.inf) == np.inf


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_points_do_not_repeat(n: int) -> None:
    """Two points have one distance."""
    assert shortest_period(np.zeros((n, 2)) + np.arange(n)[:, None], 0.1, np.inf) == np.inf


def test_the_other_way_round_is_a_rival() -> None:
    """In space, a planar pattern fits turned over, although points on the axis match as before."""
    row = np.array([[0.0, 4, 0], [7, 4.5, 0], [14, 4, 0], [7, -4, 0]])
    found = search(row, row - [0.5, 0, 0], 0.2, 3)
    placement, rival = found
    assert placement.n_agreeing == rival == len(row)


def test_posts_that_fit_the_other_way_round_are_followed() -> None:
    """Four corners of a rectangle fit turned over, but then the robot would be beyond them."""
    rng = np.random.default_rng(1)
    posts = np.array([[17.0, 0.0], [19.0, 0.0], [17.0, -3.0], [19.0, -3.0], [9.0, 1.0]])
    registration = Constellation(5)
    first = registration.match(posts, None)
    for x in (1.5, 3.0, 4.5):
        points = posts - [x, 0] + rng.normal(0, 0.01, posts.shape)
        assert (registration.match(points, None) == first).all()


def test_posts_that_fit_after_a_turn_are_not_followed_when_the_robot_may_have_turned() -> None:
    """Between the scans the robot was lost: it may have passed the posts."""
    rng = np.random.default_rng(1)
    posts = np.array([[17.0, 0.0], [19.0, 0.0], [17.0, -3.0], [19.0, -3.0], [9.0, 1.0]])
    registration = Constellation(5)
    first = registration.match(posts, None)
    registration.match(rng.uniform(-20, 20, (4, 2)), None)
    assert not np.isin(registration.match(posts - [1.5, 0], None), first).any()


@pytest.mark.parametrize("seed", [4, 9])
def test_no_more_noise_is_assumed_because_a_car_park_repeats(seed: int) -> None:
    """Whatever does not fit at first does with more, but then it fits a period away as well."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(0, 60, 2.5), [0.0, 5.0, 15.0, 20.0])
    posts = np.column_stack([x.ravel(), y.ravel()]) + rng.normal(0, 0.15, (x.size, 2))
    posts = np.vstack([posts, rng.uniform(0, 60, (10, 2)) * [1, 1 / 3]])
    registration, labels, true = Constellation(5), [], []
    for at in np.arange(-4, 60, 0.8):
        points = posts - [at, 10.0]
        seen = (np.linalg.norm(points, axis=1) < 12) & (points[:, 0] > 0)
        order = rng.permutation(np.flatnonzero(seen & (rng.random(len(posts)) > 0.25)))
        points = points[order] + rng.normal(0, 0.1, (len(order), 2))
        labels.append(registration.match(points, None))
        true.append(order)
    assert purity_of(np.concatenate(labels), np.concatenate(true)) > 0.98
    assert registration.tied_share > 0.5


def test_short_steps_past_the_windows_of_houses_are_matched() -> None:
    """With a noise of a twentieth of their distance, windows beside match nearly as well."""
    rng = np.random.default_rng(0)
    x, y, z = np.arange(0, 30, 4.0), (-6.0, 6.0), (1.0, 4.0, 7.0)
    corner = np.array([[a + da, b, c + dc] for a in x for b in y for c in z for da, dc in WINDOW])
    corner += rng.normal(0, 0.06, corner.shape)
    registration, labels, true = Constellation(5), [], []
    for at in np.arange(0, 7, 0.2):
        points = corner - [at, 0.0, 1.5]
        order = rng.permutation(np.flatnonzero(np.linalg.norm(points, axis=1) < 12))
        points = points[order] + rng.normal(0, 0.06, (len(order), 3))
        yaw = rng.normal(0, 0.02)
        points[:, :2] @= np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        labels.append(registration.match(points, None))
        true.append(order)
    assert purity_of(np.concatenate(labels), np.concatenate(true)) > 0.99
    assert registration.tied_share > 0.9


def test_scans_found_late_are_not_taken_for_another_part_of_an_avenue() -> None:
    """Submaps of a few posts show some of it only: a scan of another part may fit by chance."""
    rng, scans = np.random.default_rng(6), []
    posts, ids = avenue(8.0, 0.15, 0.0, rng)
    for x in np.arange(0, 150, 1.2):
        points = posts - [x, 0]
        seen = (np.linalg.norm(points, axis=1) <= REACH_M) & (rng.random(len(ids)) > 0.25)
        order = rng.permutation(np.flatnonzero(seen))
        scans.append((points[order] + rng.normal(0, 0.05, (len(order), 2)), ids[order]))
    mapper = PointMapper()
    labels = np.concatenate([mapper.update(points) for points, _ in scans])
    true = np.concatenate([of for _, of in scans])
    before = purity_of(labels, true)
    mapper.finish()
    mapper.refine()
    assert sum(len(submap.landmark_ids) for submap in mapper.submaps) > 30
    assert purity_of(mapper.landmarks_of(labels), true) > before - 0.005
