"""Few landmarks that two parts of a map share: in unlike worlds they tie, in regular ones not."""

from __future__ import annotations

import numpy as np
import pytest

from relmap.core.arrays import Floats, Ints
from relmap.core.association.reobservation.crossing import Part
from relmap.core.association.reobservation.sharing import FewShared
from relmap.core.association.reobservation.tying import is_regular
from relmap.simulation import WorldSpec
from tests.worlds import mapped_world

SIGMA_M, APART = 0.03, 1000


def covariance(rows: Ints) -> Floats:
    """Return the covariance of independent positions."""
    return SIGMA_M**2 / 8 * np.eye(2 * len(rows))


def in_space(rows: Ints) -> Floats:
    """Return the covariance of independent positions in space."""
    return 0.03**2 / 8 * np.eye(3 * len(rows))


def part_of(
    posts: Floats, ids: Ints, rng: np.random.Generator, way: Floats, iterations: Ints
) -> Part:
    """Return a part that shows some posts (n, 2), turned and moved, with the robot's way."""
    turn, shift = rng.uniform(-np.pi, np.pi), rng.uniform(-20, 20, 2)
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    at = (posts[ids] - shift) @ R + rng.normal(0, SIGMA_M / 3, (len(ids), 2))
    turns = np.repeat(R.T[None], len(way), axis=0)
    return Part(ids, at, covariance, SIGMA_M, iterations, (way - shift) @ R, turns)


def two_parts(
    seed: int, n_shared: int, *, gap: int = 100, period_m: float = 0.0
) -> tuple[Part, Part]:
    """Return two parts of a street, with some posts in common, and a time between them."""
    rng = np.random.default_rng(seed)
    posts = np.column_stack([rng.uniform(0, 160, 40), rng.uniform(-8, 8, 40)])
    posts = posts[np.argsort(posts[:, 0])]
    if period_m:
        grid = np.column_stack(np.divmod(np.arange(40), 2)) * [period_m, 6.0]
        posts = grid + rng.normal(0, 0.03, (40, 2))
    there = np.arange(26)
    here = np.arange(26 - n_shared, 32)
    x = posts[25, 0]
    first = np.column_stack([np.arange(x - 40, x - 10, 1.5), np.zeros(20)])
    second = np.column_stack([np.arange(x - 8.5, x + 6.5, 1.5), np.zeros(10)])
    one = part_of(posts, there, rng, first, np.arange(20))
    two = part_of(posts, here, rng, second, 19 + gap + np.arange(10))
    renumbered = Part(
        two.landmarks + APART,
        two.positions,
        two.covariance,
        two.noise_m,
        two.iterations,
        two.places,
        two.turns,
    )
    return one, renumbered


def test_four_shared_landmarks_tie_two_submaps() -> None:
    n_regular = 0
    for seed in range(8):
        one, two = two_parts(seed, 4)
        shared = FewShared([one, two], [])
        n_regular += is_regular([(part.positions, part.noise_m) for part in (one, two)])
        (tie,) = shared.ties()
        assert sorted(tie.pairs[:, 1].tolist()) == [22, 23, 24, 25]
        assert np.array_equal(tie.pairs[:, 0], tie.pairs[:, 1] + APART)
        moved = tie.placement.apply(two.positions[:4])
        assert np.abs(moved - one.positions[22:26]).max() < 4 * SIGMA_M
    assert n_regular <= 2


def test_three_tie_only_where_the_robot_goes_from_one_into_the_other() -> None:
    """The robot's reach leaves so few placements that three landmarks suffice."""
    near = [FewShared([*two_parts(seed, 3, gap=1)], []).ties() for seed in range(8)]
    far = [FewShared([*two_parts(seed, 3, gap=100)], []).ties() for seed in range(8)]
    pairs = [tie.pairs for ties in near for tie in ties]
    assert len(pairs) >= 6
    assert all(np.array_equal(of[:, 0], of[:, 1] + APART) for of in pairs)
    assert sum(map(len, far)) <= 1


def test_other_places_are_not_tied() -> None:
    ties = [
        FewShared([*two_parts(seed, 0, gap=gap)], []).ties() for seed in range(8) for gap in (1, 9)
    ]
    assert not any(ties)


@pytest.mark.parametrize(("off_m", "n_tied"), [(0.01, 0), (2.0, 4)])
def test_a_row_in_space_ties_nothing(off_m: float, n_tied: int) -> None:
    """Parts that share four lamps in a row may be turned about it."""
    found = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        row = [rng.uniform(0, 20, 4), *off_m * rng.normal(0, 1, (2, 4))]
        parts = []
        for k, (near, far) in enumerate(
            [((-40, -10, 0), (-5, 10, 6)), ((25, -10, 0), (60, 10, 6))]
        ):
            at = np.concatenate([np.transpose(row), rng.uniform(near, far, (10, 3))])
            at += rng.normal(0, 0.01, at.shape)
            iterations, turns = 1000 * k + np.arange(10), np.repeat(np.eye(3)[None], 10, axis=0)
            places, ids = rng.uniform(0, 1, (10, 3)), APART * k + np.arange(len(at))
            parts.append(Part(ids, at, in_space, 0.03, iterations, places, turns))
        found += FewShared(parts, []).ties()
    assert len(found) == n_tied


def test_large_parts_are_not_compared() -> None:
    """Their landmarks would form millions of pairs."""
    rng, n = np.random.default_rng(0), 1100
    posts, way = rng.uniform(0, 400, (n, 2)), np.zeros((10, 2))
    one, two = (part_of(posts, np.arange(n), rng, way, k + np.arange(10)) for k in (0, 12))
    assert not is_regular([(part.positions, part.noise_m) for part in (one, two)])
    assert not FewShared([one, two], []).ties()


def test_where_a_pattern_repeats_nothing_is_tied() -> None:
    """Along two rows of posts a part fits any number of periods away."""
    for seed in range(4):
        parts = two_parts(seed, 4, period_m=6.0)
        assert is_regular([(part.positions, part.noise_m) for part in parts])


def test_a_scan_of_three_landmarks_is_matched_to_what_is_nearby() -> None:
    found = []
    for seed in range(8):
        one, two = two_parts(seed, 3, gap=1)
        scan = Part(
            two.landmarks[:3],
            two.positions[:3],
            two.covariance,
            SIGMA_M,
            two.iterations[:1],
            two.places[:1],
            two.turns[:1],
        )
        found += FewShared([one], [scan]).matches()
    assert len(found) >= 6
    assert all(np.array_equal(of[:, 0], of[:, 1] + APART) for of in found)


def test_submaps_of_few_landmarks_in_view_are_tied() -> None:
    """Submaps that share four landmarks stayed apart, and 4 % of the landmarks were double."""
    mapper, off_m = mapped_world(WorldSpec(spacing_m=7.0, seed=5))
    assert len(mapper.submaps) == 1
    assert off_m < 0.022


def test_unmatched_scans_are_matched_to_what_is_seen_before_and_after() -> None:
    """Scans of three landmarks were left out, and the map was 0.042 m off."""
    assert mapped_world(WorldSpec(spacing_m=7.0, seed=9))[1] < 0.036
