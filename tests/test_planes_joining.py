"""Which tracks of walls are joined in the refined map, and which corners are rejected."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from relmap import PlaneMapper
from relmap.core.arrays import Ints

ROOM = np.array([[[4.0, -3.0], [4.0, 3.0]], [[4.0, 3.0], [-2.0, 3.0]], [[-2.0, -3.0], [4.0, -3.0]]])
IN_ROOM = [["corner", "corner"], ["corner", "view"], ["view", "corner"]]
HALF = 20
"""Scans in which the robot sees the one, and then the other."""


def driven(*sights: tuple[list[list[float]], list[str], range]) -> tuple[PlaneMapper, list[int]]:
    """Map a room in which more walls are seen: ends, their types, and in which scans.

    Return the mapper and the number that each wall had when it was last seen.
    """
    mapper, last = PlaneMapper(), [-1] * len(sights)
    for k in range(2 * HALF):
        there = [row for row, (_, _, when) in enumerate(sights) if k in when]
        ends = np.concatenate([ROOM, *([sights[row][0]] for row in there)])
        kinds = [*IN_ROOM, *(sights[row][1] for row in there)]
        seen = SimpleNamespace(ends=ends - [0.05 * k, 0.0], end_type=np.array(kinds))
        for row, number in zip(there, mapper.update(seen)[len(ROOM) :].tolist(), strict=True):
            last[row] = number
    mapper.finish()
    return mapper, last


def refined(*sights: tuple[list[list[float]], list[str], range]) -> tuple[PlaneMapper, list[int]]:
    mapper, last = driven(*sights)
    mapper.refine()
    return mapper, last


def now(mapper: PlaneMapper, numbers: list[int]) -> Ints:
    return mapper.landmarks_of(np.array(numbers))


OPEN = ["view", "view"]
EARLY, LATE, ALWAYS = range(HALF - 4), range(HALF + 4, 2 * HALF), range(2 * HALF)


def test_corners_seen_again_are_merged_while_mapping() -> None:
    ends, kinds = [[3.0, -1.5], [3.0, 1.0]], ["corner", "corner"]
    mapper, numbers = driven((ends, kinds, EARLY), (ends, kinds, LATE))
    assert numbers[0] != numbers[1]
    assert len(np.unique(now(mapper, numbers))) == 1
    # Not with those of a wall that looks the other way.
    turned = [[3.0, -1.5], [3.9, -1.5]]
    mapper, numbers = driven((ends, kinds, EARLY), (turned, kinds, LATE))
    assert len(np.unique(now(mapper, numbers))) == 2


def test_a_wall_without_corners_seen_again_is_one() -> None:
    """Only its line is known: no corner of it was ever seen."""
    mapper, numbers = refined(
        ([[3.0, -1.5], [3.0, 1.0]], OPEN, EARLY), ([[3.0, -1.0], [3.0, 1.5]], OPEN, LATE)
    )
    assert numbers[0] != numbers[1]
    assert len(np.unique(now(mapper, numbers))) == 1
    row = mapper.planes.plane == now(mapper, numbers)[0]
    assert mapper.planes.observations[row] == len(EARLY) + len(LATE)


def test_walls_beside_one_another_on_a_line_are_two() -> None:
    mapper, numbers = refined(
        ([[3.0, -1.5], [3.0, -0.5]], OPEN, EARLY), ([[3.0, 0.5], [3.0, 1.5]], OPEN, LATE)
    )
    assert len(np.unique(now(mapper, numbers))) == 2


def test_of_walls_a_hand_apart_those_seen_side_by_side_are_two() -> None:
    near, far = [[3.0, -1.5], [3.0, 1.5]], [[3.1, -1.5], [3.1, 1.5]]
    mapper, numbers = refined((near, OPEN, EARLY), (far, OPEN, LATE))
    assert len(np.unique(now(mapper, numbers))) == 1
    mapper, numbers = refined((near, OPEN, ALWAYS), (far, OPEN, ALWAYS))
    assert len(np.unique(now(mapper, numbers))) == 2


def test_a_corner_beyond_which_its_wall_goes_on_is_none() -> None:
    """As where something stood before the wall for a while, and its edge was taken for the end."""
    cut, whole = [[3.0, -1.5], [3.0, 0.5]], [[3.0, -1.5], [3.0, 2.0]]
    mapper, numbers = refined(
        (cut, ["view", "corner"], range(12)), (whole, ["view", "corner"], range(12, 2 * HALF))
    )
    assert len(np.unique(now(mapper, numbers))) == 1
    (row,) = np.flatnonzero(mapper.planes.plane == now(mapper, numbers)[0])
    assert mapper.planes.corner[row, 0] == -1
    corners = mapper.map.positions[:, :2]
    assert np.linalg.norm(corners - [3.0, 2.0], axis=1).min() < 1e-6
    assert np.linalg.norm(corners - [3.0, 0.5], axis=1).min() > 1.0
