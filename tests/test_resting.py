"""Landmarks that move in a solved map, and several that are one object."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from relmap.core.arrays import Floats
from relmap.core.association.reobservation.coinciding import gathered
from relmap.core.refinement.chain.resting import at_rest
from relmap.core.refinement.trend import drifting

N = 20
SIGMA_M = 0.1


def still(rng: np.random.Generator, sigma_m: float = SIGMA_M) -> Floats:
    """Return the places of N observations of a landmark that does not move."""
    return np.asarray(rng.uniform(-50, 50, 2) + rng.normal(0, sigma_m, (N, 2)))


def test_scatter_is_noise_and_a_trend_is_motion() -> None:
    rng = np.random.default_rng(0)
    usual = [still(rng, sigma_m) for sigma_m in np.linspace(0.5, 3, 10) * SIGMA_M]
    noisy = still(rng, 6 * SIGMA_M)
    walks = np.column_stack([np.linspace(0, 3, N), np.zeros(N)]) + rng.normal(0, 0.03, (N, 2))
    places = np.array([*usual, noisy, walks])
    landmark = np.repeat(np.arange(12), N)
    static = np.arange(12) < 10
    assert_array_equal(np.flatnonzero(drifting(landmark, places.reshape(-1, 2), 12)), [11])
    assert_array_equal(np.flatnonzero(~at_rest(landmark, places.reshape(-1, 2), static)), [11])


def test_landmarks_that_scatter_more_than_static_ones_are_not_at_rest() -> None:
    rng = np.random.default_rng(1)
    places = np.array([*(still(rng) for _ in range(10)), still(rng, 10 * SIGMA_M)])
    landmark = np.repeat(np.arange(11), N)
    assert not at_rest(landmark, places.reshape(-1, 2), np.arange(11) < 10)[10]


def test_noise_alone_is_hardly_ever_a_trend() -> None:
    rng = np.random.default_rng(2)
    landmark = np.repeat(np.arange(1000), N)
    assert drifting(landmark, rng.normal(size=(1000 * N, 2)), 1000).sum() <= 5


def test_pieces_seen_in_different_scans_are_one_landmark() -> None:
    places = np.array([[0.0, 0.0], [0.3, 0.0], [-0.2, 0.1], [10.0, 0.0]])
    scans = [np.arange(9), np.arange(20, 25), np.array([30]), np.arange(40, 44)]
    counts = np.array([len(seen) for seen in scans])
    assert_array_equal(gathered(places, counts, scans, 0.1, 5.0), [0, 0, 0, 3])


def test_what_one_scan_shows_apart_stays_apart() -> None:
    places = np.array([[0.0, 0.0], [0.3, 0.0], [0.35, 0.0]])
    scans = [np.arange(9), np.arange(8, 13), np.array([30])]
    counts = np.array([len(seen) for seen in scans])
    assert_array_equal(gathered(places, counts, scans, 0.1, 5.0), [0, 1, 1])


def test_pieces_are_not_gathered_from_farther_than_landmarks_are_apart() -> None:
    places = np.array([[0.0, 0.0], [0.3, 0.0]])
    scans = [np.arange(9), np.arange(20, 25)]
    assert_array_equal(gathered(places, np.array([9, 5]), scans, 0.1, 1.0), [0, 1])
