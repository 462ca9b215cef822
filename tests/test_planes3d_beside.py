"""Planes in space: surfaces a few centimetres apart are not taken for one unnoticed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap.planes3d import refining
from relmap.planes3d.misled import lies_beside
from relmap.planes3d.refining import refined, unsure_steps
from relmap.planes3d.submap import Submap
from tests.test_planes3d_covariances import patches, wall

WRONG, OFF_M = 5, 0.12


def room(is_wrong: bool, agree: int = 2, turned: int | None = None) -> Submap:
    """Return scans of a room with a relief of 0.12 m on its front and its back wall.

    Later scans show the walls only. If wrong, scans from the sixth on take them for the reliefs.
    `agree`: how many of both walls they show; `turned`: seed of rotations of the map and the robot.
    """
    rotations = Rotation.identity(11) if turned is None else Rotation.random(11, turned)
    turns = rotations.as_matrix()
    part, x = Submap(), np.cumsum([0.0, 0.05, 0.2, 0.1, 0.25, 0.08, 0.2, 0.1, 0.22, 0.05])
    for k in range(len(x)):
        walls = [wall(0, 3.0 - x[k], (-2.0, -1.0)), wall(0, -3.0 - x[k], (-2.0, -1.0))][:agree]
        reliefs = [wall(0, 3.0 + OFF_M - x[k], (1.0, 2.0)), wall(0, OFF_M - 3.0 - x[k], (1.0, 2.0))]
        both, is_off = k < 2, is_wrong and k >= WRONG
        shown = [*walls, wall(1, 2.0), wall(2, -2.0), *(reliefs if both else [])]
        seen = patches(*(each @ turns[k] for each in shown))
        number = [*([4, 5] if is_off else [0, 1])[:agree], 2, 3, *([4, 5] if both else [])]
        t = turns[-1] @ [x[k] + OFF_M * is_off, 0, 0]
        part.add(k, seen, (turns[-1] @ turns[k], t), np.array(number))
    return part


def test_a_step_onto_surfaces_beside_those_of_the_scan_before_is_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert unsure_steps(room(False)) == {}
    part = room(True)
    assert sorted(unsure_steps(part)) == [WRONG]
    # All scans together agree with it.
    monkeypatch.setattr(refining, "lies_beside", lambda part, k: False)
    assert unsure_steps(part) == {}


@pytest.mark.parametrize("seed", range(4))
def test_it_is_listed_in_whatever_direction_the_robot_looks(seed: int) -> None:
    assert unsure_steps(room(False, turned=seed)) == {}
    assert sorted(unsure_steps(room(True, turned=seed))) == [WRONG]


@pytest.mark.parametrize(("agree", "found"), [(2, [WRONG]), (1, [])])
def test_one_plane_beside_another_may_be_new(agree: int, found: list[int]) -> None:
    part = room(True, agree)
    assert [k for k in range(1, 10) if lies_beside(part, k)] == found


@pytest.mark.parametrize("most", [refining.MOVED, np.inf])
def test_landmarks_that_would_move_a_step_are_not_joined(
    monkeypatch: pytest.MonkeyPatch, most: float
) -> None:
    # Two walls that are not parallel alone show how far later scans are. If one of them, which is
    # 12 mm behind that of the first scans, were the same, these would be 0.2 m farther back.
    monkeypatch.setattr(refining, "MOVED", most)
    part = Submap()
    for k in range(8):
        x = 0.1 * k
        turns = [Rotation.from_rotvec([0.0, 0.0, side * 0.03]).as_matrix() for side in (1, -1)]
        sides = wall(1, 2.0 + 0.012 * (k > 3)) @ turns[0], wall(1, -2.0) @ turns[1]
        walls = [*sides, wall(2, -2.0), *([wall(0, 3.0)] if k < 5 else [])]
        number = np.array([3 if k > 3 else 0, 1, 2, 4][: len(walls)])
        pose = np.eye(3), np.array([x, 0.0, 0.0])
        part.add(k, patches(*(each - [x, 0.0, 0.0] for each in walls)), pose, number)
    steps = np.diff(refined(part, 5)[0].trajectory[:, 0, 3])
    assert bool(np.abs(steps - 0.1).max() < 0.02) is (most < 1)
