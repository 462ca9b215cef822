"""Long walls that are not straight are solved in pieces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import feed
from relmap.evaluation.metrics import ate
from relmap.planes.refinement.refined_map import PIECE_M, UNEVEN, in_pieces
from relmap.planes.walls.assembly import Assembled, WallNumbers, assemble
from relmap.planes.walls.history import PlaneHistory
from tests.tables import poses_along

STEP_M, SEEN_M, BULGE_M = 0.5, 4.0, 0.2


def beside(length_m: float, noise: float) -> tuple[Assembled, PlaneHistory]:
    """Return a wall of two bends, its noise given in that of the observations, and a straight one.

    Seen from a path along them, with a corner at either end.
    """
    x = np.arange(0.0, length_m + STEP_M, STEP_M)
    n, reach = len(x), x[:, None] + SEEN_M * np.array([1.0, -1.0])
    bent = np.stack([reach - x[:, None], 2.0 + BULGE_M * np.sin(2 * np.pi * reach / length_m)], 2)
    straight = np.stack([x[:, None] - reach, np.full((n, 2), -2.0)], axis=2)
    corner = np.full((n, 2, 2), -1)
    corner[:5, 0, 0], corner[-5:, 0, 1] = 0, 1
    history = PlaneHistory(
        iteration=np.repeat(np.arange(n), 2),
        plane=np.tile([0, 1], n),
        ends=np.stack([bent, straight], axis=1).reshape(-1, 2, 2),
        sd=np.full(2 * n, 0.004),
        z_extent=np.zeros((2 * n, 2)),
        corner=corner.reshape(-1, 2),
        motion=np.tile([0.0, -STEP_M, 0.0], (n, 1)),
        submap=np.zeros(n, dtype=np.int64),
    )
    numbers = WallNumbers(np.arange(2), np.arange(2))
    found = assemble(history, numbers, poses_along(x), np.zeros(2, dtype=np.bool_))
    assert found is not None
    factor = np.where(found.given.wall == 0, noise, 1.0)
    return replace(found, given=replace(found.given, sd=factor * found.given.sd)), history


def off_m(assembled: Assembled) -> Floats:
    """Return how far the observations are from their walls."""
    given, state = assembled.given, assembled.state
    middle = given.ends.mean(axis=1) + state.t[given.iteration] - state.centre[given.wall]
    normal = np.column_stack([np.cos(state.angle), np.sin(state.angle)])[given.wall]
    return np.asarray(np.abs((middle * normal).sum(axis=1) - state.across[given.wall]))


def test_a_long_wall_that_is_not_straight_is_solved_in_pieces() -> None:
    whole, history = beside(80.0, 3 * UNEVEN)
    pieces = in_pieces(whole, history)
    assert pieces is not None
    wall, of = pieces.given.wall, whole.given.wall
    assert len(np.unique(wall[of == 0])) == 1 + 80.0 / PIECE_M
    assert len(np.unique(wall[of == 1])) == 1
    assert off_m(pieces)[of == 0].max() < 0.7 * off_m(whole)[of == 0].max()
    # Both have the noise of their observations again, and the corners are those of two pieces.
    np.testing.assert_array_equal(pieces.given.sd, whole.given.sd[of == 1][0])
    assert pieces.corner_wall[0] != pieces.corner_wall[1]
    np.testing.assert_array_equal(pieces.given.corner, whole.given.corner)


@pytest.mark.parametrize(("length_m", "noise"), [(80.0, 1.5 * UNEVEN), (15.0, 3 * UNEVEN)])
def test_other_walls_stay_whole(length_m: float, noise: float) -> None:
    """Those that deviate by less than 5 cm, and short ones."""
    assert in_pieces(*beside(length_m, noise)) is None


def test_walls_stay_whole_where_their_observations_are_as_inaccurate() -> None:
    whole, history = beside(80.0, 3 * UNEVEN)
    assert in_pieces(whole, replace(history, sd=5 * history.sd)) is None


def test_walls_drawn_by_hand_do_not_bend_the_path(
    real_scans: Callable[[str], ScanLog],
) -> None:
    """Of MRPT's simulation, where some that are nearly in line are joined to one of 77 m."""
    log, mapper = real_scans("mrpt-sim-laser2d/simul.scans.csv.gz"), PlaneMapper()
    feed(mapper, log, "nearest", refine=True)
    assert log.poses is not None
    assert len(mapper.submaps) == 1
    off = ate(mapper.trajectory, log.poses, planar=True)
    assert off is not None
    assert off < 0.05
