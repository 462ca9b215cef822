"""Registration by constellation where the robot would leap: another place may look alike."""

from __future__ import annotations

import numpy as np
import pytest

from tests.test_constellation import both_dimensions, scattered, seen_at, settled


@both_dimensions
@pytest.mark.parametrize("seed", range(3))
def test_a_room_like_the_one_before_is_another_one(d: int, seed: int) -> None:
    """The robot turns from one room to the next, whose equal furniture lies 20 m farther."""
    rng = np.random.default_rng(seed)
    world = scattered(12, d, rng)
    registration, _ = settled(world, 0.01, rng)
    other = world.copy()
    other[9:] += 1.5  # Three of the twelve were moved.
    other[:, 0] += 20.0
    found = registration.match(seen_at(other, 10) + 0.01 * rng.standard_normal(world.shape), None)
    assert found.tolist() == list(range(12, 24))
    again = registration.match(seen_at(other, 11), None)
    assert again.tolist() == found.tolist()


@both_dimensions
def test_a_robot_that_starts_to_move_is_followed(d: int) -> None:
    """After a rest any step is far longer than those before."""
    rng = np.random.default_rng(d)
    world = scattered(40, d, rng)
    registration, labels = settled(world, 0.01, rng)
    step = np.eye(d)[0]
    for k in range(5):
        there = seen_at(world - (k + 1) * step, 10)
        np.testing.assert_array_equal(registration.match(there, None), labels)


def test_a_robot_that_stays_fast_is_followed_after_some_scans() -> None:
    rng = np.random.default_rng(4)
    world = scattered(40, 2, rng)
    registration, _ = settled(world, 0.01, rng)
    labels = [
        registration.match(seen_at(world, 9) - (k + 1) * np.array([20.0, 0.0]), None)
        for k in range(20)
    ]
    assert (labels[0] >= 40).all()
    np.testing.assert_array_equal(labels[-1], labels[-2])
