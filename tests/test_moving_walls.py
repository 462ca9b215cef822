"""Doors that swing and panels that slide: simulated, and mapped by the plane mapper."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from relmap import PlaneMapper, RelmapError
from relmap.evaluation.truth import Truth
from relmap.evaluation.walls import match_corners
from relmap.simulation import Building, simulate_building
from relmap.simulation.floor_plan import World, make_floor_plan, make_moving
from tests.segments import crossings

SEEN = 10
"""Minimum number of scans that saw a wall, for it to be checked."""


@pytest.mark.parametrize("world", ["building", "panels"])
def test_movers_are_rigid_and_hit_nothing(world: World) -> None:
    for seed in range(12):
        plan = make_floor_plan(world, np.random.default_rng(seed))
        plan, movers = make_moving(plan, world, 6, np.random.default_rng(seed))
        assert len(movers.row) >= 6
        moves = np.isin(np.arange(len(plan.walls)), movers.row)
        lengths = []
        for iteration in range(0, 60, 5):
            walls = movers.at(plan.walls, iteration)
            np.testing.assert_array_equal(walls[~moves], plan.walls[~moves])
            lengths.append(np.linalg.norm(walls[moves, 2:4] - walls[moves, :2], axis=1))
            assert crossings(walls[moves], walls[~moves]) == 0
            assert crossings(walls[moves], walls[moves]) == 0
        np.testing.assert_allclose(lengths, np.tile(lengths[0], (len(lengths), 1)), atol=1e-12)


def test_the_rest_of_the_world_is_the_same() -> None:
    still, moved = (simulate_building(points=10, seed=3, iterations=5, moving=n) for n in (0, 4))
    assert not still.moving.any()
    assert moved.moving.sum() == 8
    np.testing.assert_array_equal(moved.walls[~moved.moving], still.walls)
    np.testing.assert_array_equal(moved.trajectory, still.trajectory)


def test_a_negative_number_of_movers_is_refused() -> None:
    with pytest.raises(RelmapError, match="moving is -1"):
        simulate_building(moving=-1)


def test_two_walls_that_share_their_only_corner_stand_still() -> None:
    """Their corners and midpoints keep all distances but one, so the rest seems to move."""
    rng, mapper = np.random.default_rng(0), PlaneMapper()
    for k in range(40):
        turn = np.array([-2.2, 2.3]) + 0.01 * k + rng.normal(0.0, 0.003, 2)
        corner = np.array([3.0 - 0.02 * k, 0.01 * k]) + rng.normal(0.0, 0.005, 2)
        right, left = corner + np.column_stack([np.cos(turn), np.sin(turn)]) * [[2.0], [3.0]]
        seen = SimpleNamespace(
            ends=np.array([[right, corner], [corner, left]]),
            end_type=np.array([["view", "corner"], ["corner", "view"]]),
            n_points=np.array([100, 100]),
            noise=np.array([0.02, 0.02]),
        )
        mapper.update(seen)
    mapper.finish()
    assert mapper.planes.status.tolist() == ["static", "static"]
    assert 0.002 < mapper.noise_m < 0.02


@pytest.mark.parametrize(
    ("world", "moving", "seed"),
    [("building", 6, 20), ("building", 6, 22), ("panels", 2, 24), ("panels", 2, 27)],
)
def test_moving_walls_leave_the_map(world: World, moving: int, seed: int) -> None:
    building = simulate_building(points=10, sigma=0.0, seed=seed, world=world, moving=moving)
    mapper = PlaneMapper()
    numbers = [mapper.update(scan.seen) for scan in building.scans]
    mapper.finish()
    mapper.refine()
    wall = np.concatenate([scan.seen.wall for scan in building.scans])
    number = mapper.landmarks_of(np.concatenate(numbers))
    status = dict(zip(mapper.planes.plane.tolist(), mapper.planes.status.tolist(), strict=True))
    movers = [w for w in np.flatnonzero(building.moving) if (wall == w).sum() >= SEEN]
    assert movers
    for mover in movers:
        found = {status[n] for n in number[wall == mover].tolist()}
        assert "dynamic" in found
        assert "static" not in found
    for n, kind in status.items():
        if kind == "dynamic":
            assert building.moving[np.bincount(wall[number == n]).argmax()]
    assert_exact(mapper, building)


def assert_exact(mapper: PlaneMapper, building: Building) -> None:
    """The walls that stand still are mapped as if nothing moved."""
    still = ~building.moving
    ends = building.walls[still, :4].reshape(-1, 2, 2)
    due = building.times_seen()[still, 1:] >= SEEN
    truth = Truth(ends=ends, corner_scans=due.astype(np.int64))
    matched = match_corners(mapper.planes, truth, mapper.trajectory, building.trajectory)
    off = matched.position @ matched.R.T + matched.t - matched.truth
    assert np.abs(off).max() <= 1e-9
    found = np.isin(np.flatnonzero(due), 2 * matched.wall + matched.end)
    assert found.mean() >= 0.9
    assert matched.n_false == 0
