"""Walls of two maps: how they are aligned, and which of them are one."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap.core.arrays import Floats
from relmap.core.geometry.motions import transforms
from relmap.merging.tables import joined_walls, moved_walls
from relmap.planes.places.wall_tie import wall_ties
from tests.tables import walls_of
from tests.worlds import turn

seeds = st.integers(0, 2**32 - 1)


def rooms(rng: np.random.Generator, n: int = 12) -> Floats:
    """Return walls (4 n, 2, 2) of rooms of all sizes and turns, fronts inside."""
    size = rng.uniform(2, 7, (n, 2))
    at = np.column_stack([9.0 * np.arange(n), rng.uniform(-6, 6, n)])
    corners = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    walls = []
    for k in range(n):
        place = (corners * size[k]) @ turn(rng.uniform(-0.4, 0.4)).T + at[k]
        walls += [[place[a], place[a - 3]] for a in range(4)]
    return np.array(walls)[:, ::-1]


# One of some thousand seeds (85095, angle 2.5) is ambiguous, which merging refuses.
@settings(max_examples=15, derandomize=True)
@given(seeds, st.floats(-np.pi, np.pi), st.sampled_from([0.0, 0.01]))
def test_walls_are_aligned_with_their_matches(seed: int, angle: float, sigma: float) -> None:
    """Of rooms in a row each map shows some; six are in both."""
    rng = np.random.default_rng(seed)
    world = rooms(rng)
    R, t = turn(angle), rng.uniform(-80, 80, 2)
    one, other = (part + rng.normal(0, sigma, part.shape) for part in (world[:36], world[12:]))
    best, rival, *_ = wall_ties((other - t) @ R, one)
    assert rival.length_m < 0.7 * best.length_m
    np.testing.assert_allclose(best.R, R, atol=1e-3 if sigma else 1e-9)
    reached = other.reshape(-1, 2)
    off = np.abs(((reached - t) @ R) @ best.R.T + best.t - reached).max()
    assert off < (0.1 if sigma else 1e-6)


def test_walls_of_a_corridor_slide() -> None:
    walls = np.array([[[0.0, -1.0], [30.0, -1.0]], [[30.0, 1.0], [0.0, 1.0]]])
    assert wall_ties(walls + np.array([0.3, 0.1]), walls)[0].across < 0.01


def test_two_walls_that_are_one_reach_as_far_as_both() -> None:
    one = walls_of(np.array([[[0.0, 0.0], [4.0, 0.0]]]), [[1, -1]])
    ends = np.array([[[2.0, 0.02], [6.0, 0.02]], [[9.0, 0.0], [9.0, 3.0]]])
    merged, corners = joined_walls(one, walls_of(ends, [[-1, 7], [8, -1]]))
    assert merged.plane.tolist() == [0, 2]
    np.testing.assert_allclose(merged.ends[0], [[0.0, 0.01], [6.0, 0.01]])
    assert merged.corner.tolist() == [[1, 7], [8, -1]]
    assert merged.observations.tolist() == [20, 10]
    assert corners.tolist() == []
    same, corners = joined_walls(one, walls_of(one.ends, [[5, -1]]))
    assert (len(same.plane), corners.tolist()) == (1, [[5, 1]])


def test_a_closed_door_does_not_close_an_open_one() -> None:
    """A wall that lies on two, with a gap between, stays two."""
    ends = np.array([[[0.0, 0.0], [3.0, 0.0]], [[3.5, 0.0], [8.0, 0.0]]])
    whole = walls_of(np.array([[[0.0, 0.0], [8.0, 0.0]]]), [[-1, -1]])
    merged, _ = joined_walls(walls_of(ends, [[-1, -1], [-1, -1]]), whole)
    assert len(merged.plane) == 2


def test_a_wall_that_others_cover_is_left_out() -> None:
    whole = walls_of(np.array([[[0.0, 0.0], [8.0, 0.0]]]), [[-1, -1]])
    ends = np.array([[[0.0, 0.0], [4.0, 0.0]], [[4.0, 0.0], [8.0, 0.0]]])
    merged, _ = joined_walls(whole, walls_of(ends, [[-1, -1], [-1, -1]]))
    assert merged.plane.tolist() == [0]


def test_walls_back_to_back_stay_two() -> None:
    front = np.array([[[0.0, 0.0], [4.0, 0.0]]])
    merged, _ = joined_walls(walls_of(front, [[-1, -1]]), walls_of(front[:, ::-1], [[-1, -1]]))
    assert len(merged.plane) == 2


def test_walls_move_with_their_fronts() -> None:
    table = walls_of(np.array([[[1.0, 0.0], [4.0, 0.0]]]), [[-1, -1]])
    turned = moved_walls(table, transforms(turn(np.pi / 2), np.array([1.0, 2.0])))
    np.testing.assert_allclose(turned.ends, [[[1.0, 3.0], [1.0, 6.0]]])
    np.testing.assert_allclose(turned.normal, [[-1.0, 0.0]], atol=1e-15)
