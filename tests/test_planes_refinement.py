"""The joint least squares over walls, against scipy and dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from relmap.core.arrays import Floats
from relmap.planes.refinement.closing import Loop, votes
from relmap.planes.refinement.solving import refined_to_the_noise
from relmap.planes.refinement.system import SPREAD, WallSystem, wall_residuals
from relmap.planes.walls.assembly import WallEquations, WallNumbers, Walls, assemble
from relmap.planes.walls.history import PlaneHistory
from tests.tables import poses_along
from tests.worlds import turn


@pytest.fixture(name="room")
def make_room() -> tuple[WallEquations, Walls]:
    """Three walls and two corners seen with noise on a short way, and their true positions."""
    rng = np.random.default_rng(3)
    ends = np.array(
        [[[4.0, -3.0], [4.0, 3.0]], [[4.0, 3.0], [-2.0, 3.0]], [[1.0, 5.0], [2.0, 7.0]]]
    )
    n = 40
    yaw, t = (
        np.linspace(0.0, 0.6, n),
        np.column_stack([np.linspace(0, 1, n), np.linspace(0, 0.5, n)]),
    )
    seen = np.einsum("iba,iweb->iwea", turn(yaw), ends[None] - t[:, None, None])
    seen = seen.reshape(-1, 2, 2) + rng.normal(scale=0.02, size=(3 * n, 2, 2))
    iteration, wall = np.repeat(np.arange(n), 3), np.tile(np.arange(3), n)
    # One corner is seen for a short while only.
    row = np.flatnonzero((wall == 0) | ((wall == 1) & (iteration < 8)))
    equations = WallEquations(
        iteration,
        wall,
        seen,
        rng.uniform(0.01, 0.03, 3 * n),
        row,
        np.where(wall[row] == 0, 1, 0),
        wall[row],
        rng.uniform(0.02, 0.05, len(row)),
        np.zeros(len(row)),
    )
    along = ends[:, 1] - ends[:, 0]
    angle = np.arctan2(along[:, 0], -along[:, 1])
    places = np.array([1.0, -1.0]) * np.linalg.norm(along[:2], axis=1) / 2
    return equations, Walls(yaw, t, ends.mean(axis=1), angle, np.zeros(3), places)


def test_walls_are_refined_to_the_least_squares(room: tuple[WallEquations, Walls]) -> None:
    equations, truth = room
    n, first = len(truth.yaw) - 1, (truth.yaw[:1], truth.t[:1])

    def state_of(x: Floats) -> Walls:
        poses, rest = x[: 3 * n].reshape(n, 3), x[3 * n :]
        return Walls(
            np.append(first[0], poses[:, 0]),
            np.concatenate([first[1], poses[:, 1:]]),
            truth.centre,
            rest[:3],
            rest[3:6],
            rest[6:],
        )

    def misfit(x: Floats) -> Floats:
        state = state_of(x)
        R = turn(state.yaw[equations.iteration])
        middle = equations.ends.mean(axis=1, keepdims=True)
        points = middle + SPREAD * np.array([[-1.0], [1.0]]) * np.diff(equations.ends, axis=1)
        corners = equations.ends[equations.corner_row, equations.corner_end][:, None]
        normal = np.column_stack([np.cos(state.angle), np.sin(state.angle)])
        along = np.column_stack([normal[:, 1], -normal[:, 0]])
        placed = np.einsum("nab,npb->npa", R, points) + state.t[equations.iteration][:, None]
        off = np.einsum(
            "npa,na->np", placed - state.centre[equations.wall][:, None], normal[equations.wall]
        )
        row, wall = equations.corner_row, equations.wall[equations.corner_row]
        placed = (
            np.einsum("nab,npb->npa", R[row], corners)[:, 0] + state.t[equations.iteration[row]]
        )
        reach = ((placed - state.centre[wall]) * along[wall]).sum(axis=1)
        own = wall_residuals(equations, state)
        np.testing.assert_allclose(own[0], off - state.across[equations.wall][:, None], atol=1e-12)
        np.testing.assert_allclose(own[1], reach - state.along[equations.corner], atol=1e-12)
        weighted = own[0] / (np.sqrt(2) * equations.sd[:, None]), own[1] / equations.corner_sd
        return np.concatenate([weighted[0].ravel(), weighted[1]])

    start = [
        np.column_stack([truth.yaw, truth.t])[1:].ravel(),
        truth.angle,
        truth.across,
        truth.along,
    ]
    best = least_squares(misfit, np.concatenate(start), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    found = WallSystem(equations).refine(truth, 20, 1e9)
    own = [
        np.column_stack([found.yaw, found.t])[1:].ravel(),
        found.angle,
        found.across,
        found.along,
    ]
    np.testing.assert_allclose(np.concatenate(own), best, atol=1e-5)


def test_each_scan_of_the_later_visit_has_one_vote() -> None:
    none = np.empty((0, 2), dtype=np.int64)

    def loop(later: int, earlier: int, shift_m: float = 0.0) -> Loop:
        return 0.1 * later, 0.1 * earlier, np.array([0.0, 2.0 + shift_m, 0.0]), none

    deceptive = [loop(500, 10), loop(500, 60), loop(500, 90), loop(512, 60)]
    assert [votes(each, deceptive) for each in deceptive] == [2, 2, 2, 2]
    # Others do not agree on the drift, or are of another visit.
    others = [loop(504, 60, 0.5), loop(700, 60), loop(508, 300)]
    assert votes(deceptive[0], deceptive + others) == 2
    assert votes(deceptive[0], [*deceptive, loop(504, 60, 0.1)]) == 3


def test_walls_are_assembled_without_any_corner() -> None:
    n = 8
    ends = np.tile([[2.0, -1.0], [2.0, 1.0]], (n, 1, 1)) - np.arange(n)[:, None, None] * [0.1, 0.0]
    history = PlaneHistory(
        iteration=np.arange(n),
        plane=np.zeros(n, dtype=np.int64),
        ends=ends,
        sd=np.full(n, 0.01),
        z_extent=np.zeros((n, 2)),
        corner=np.full((n, 2), -1),
        motion=np.tile([0.0, -0.1, 0.0], (n, 1)),
        submap=np.zeros(n, dtype=np.int64),
    )
    poses = poses_along(0.1 * np.arange(n))
    none = np.empty(0, dtype=np.int64)
    numbers = WallNumbers(np.zeros(1, dtype=np.int64), none)
    assembled = assemble(history, numbers, poses, np.zeros(1, dtype=np.bool_))
    np.testing.assert_allclose(assembled.state.centre, [[2.0, 0.0]], atol=1e-12)
    assert len(assembled.corners) == len(assembled.given.corner) == 0


def seen_from_a_corridor(x: float) -> Floats:
    """Return two walls that meet at (6, 2), the first with a free end at (3, 2); (2, 2, 2)."""
    return np.array([[[6.0, 2.0], [3.0, 2.0]], [[6.0, -1.0], [6.0, 2.0]]]) - [x, 0.0]


def test_a_corner_is_known_to_the_distance_between_the_points_there() -> None:
    n, spacing_rad = 6, np.deg2rad(0.5)
    x = np.array([0.0, 1.0, 2.0, 2.5, 2.9, 3.0])
    history = PlaneHistory(
        iteration=np.repeat(np.arange(n), 2),
        plane=np.tile([0, 1], n),
        ends=np.concatenate([seen_from_a_corridor(each) for each in x]),
        sd=np.full(2 * n, 1e-4),
        z_extent=np.zeros((2 * n, 2)),
        corner=np.tile([[1, 0], [-1, 2]], (n, 1)),
        motion=np.zeros((n, 3)),
        submap=np.zeros(n, dtype=np.int64),
        spacing_rad=spacing_rad,
    )
    poses = poses_along(x)
    numbers = WallNumbers(np.arange(2), np.arange(3))
    assembled = assemble(history, numbers, poses, np.zeros(2, dtype=np.bool_))
    sd = assembled.given.corner_sd.reshape(n, 3)
    corner = assembled.given.corner.reshape(n, 3)[0]
    # Beams half a degree apart, on the line y = 2, near the end of the wall at x = 3.
    bearing = np.arctan2(2.0, 3.0 - x)
    apart_m = 2 / np.tan(bearing - spacing_rad / 2) - 2 / np.tan(bearing + spacing_rad / 2)
    expected_m = np.hypot(0.01, 0.5 * apart_m)
    np.testing.assert_allclose(sd[:, corner == 0][:, 0], expected_m, rtol=1e-3)
    np.testing.assert_allclose(sd[:, corner != 0], 0.01, rtol=1e-3)
    # However accurate the walls are, the beams are as far apart.
    sd = refined_to_the_noise(assembled, 0.0).given.corner_sd.reshape(n, 3)
    assert (sd[:, corner == 0][:, 0] >= 0.499 * apart_m).all()
    assert (sd[:, corner != 0] < 0.001).all()
    # Where the first wall meets one that moves, its own points are all that is known.
    alone = assemble(history, numbers, poses, np.array([False, True]))
    assert (alone.given.corner_sd > 1.1 * 0.01).all()
