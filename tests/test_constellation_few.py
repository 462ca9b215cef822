"""Registration by constellation where few points are seen: two may suffice, if all agrees."""

from __future__ import annotations

import numpy as np
import pytest

from tests.test_constellation import scattered, seen_at, settled


@pytest.mark.parametrize(("d", "n"), [(2, 1), (3, 1), (3, 2)])
def test_too_few_points_to_tie_are_new_and_leave_the_tracks_alone(d: int, n: int) -> None:
    rng = np.random.default_rng(d)
    world = scattered(12, d, rng)
    registration, labels = settled(world, 0.02, rng)
    few = registration.match(seen_at(world[:n], 10), None)
    assert few.tolist() == list(range(12, 12 + n))
    assert registration.match(np.empty((0, d)), None).tolist() == []
    np.testing.assert_array_equal(registration.match(seen_at(world, 12), None), labels)


def test_two_familiar_landmarks_tie_a_planar_scan_but_two_strangers_do_not() -> None:
    rng = np.random.default_rng(2)
    world = scattered(12, 2, rng)
    registration, labels = settled(world, 0.01, rng)
    assert registration.match(seen_at(world[4:6], 10), None).tolist() == [4, 5]
    np.testing.assert_array_equal(registration.match(seen_at(world, 11), None), labels)
    strange = seen_at(world[4:6], 12) + np.array([[0.0, 0.0], [0.7, 0.7]])
    assert (registration.match(strange, None) >= 12).all()
    np.testing.assert_array_equal(registration.match(seen_at(world, 13), None), labels)


def test_two_familiar_landmarks_must_be_nearer_after_nearly_empty_scans() -> None:
    """The robot may have moved on: two others may be as far apart as those seen before."""
    rng = np.random.default_rng(2)
    world = scattered(12, 2, rng)
    moved = seen_at(world[4:6], 9) + np.array([0.3, 0.0])
    registration, labels = settled(world, 0.01, rng)
    for _ in range(2):
        assert registration.match(np.array([[20.0, 20.0]]), None) >= 12
    assert (registration.match(moved, None) >= 12).all()
    registration, labels = settled(world, 0.01, rng)
    assert registration.match(moved, None).tolist() == labels[4:6].tolist()


@pytest.mark.parametrize("seed", range(6))
def test_two_landmarks_that_look_like_others_do_not_place_a_scan_of_four(seed: int) -> None:
    """The robot moves so far that two landmarks are where two others were, which left the view."""
    rng = np.random.default_rng(seed)
    moved = np.array([6.0, 0.0])
    world = scattered(4, 2, rng)
    world = np.concatenate([world, world[:2] + moved])
    registration, labels = settled(world, 0.01, rng)
    found = registration.match(seen_at(world[2:] - moved, 9), None)
    assert found.tolist() == labels[2:].tolist()
