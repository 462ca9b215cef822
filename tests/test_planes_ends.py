"""Static ends of walls, by the four midpoint pairs of Fig. 4 over an interval."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.evaluation.sources import truth_of
from relmap.evaluation.walls import match_corners
from relmap.planes.scans.corners import CORNER, CUT, UNKNOWN, compared_ends
from relmap.simulation import simulate_building
from tests.worlds import ate_m, fed, finished, turn

WALLS = np.array(
    [[[4.0, -2.0], [4.0, 2.0]], [[4.0, 2.0], [-1.0, 2.0]], [[-1.0, -2.0], [4.0, -2.0]]]
)


def seen_on_the_way(moving: Floats, n: int = 12) -> Floats:
    """Return three walls (n, 3, 2, 2) as a robot on its way sees them; some ends move along."""
    scans = []
    for k in range(n):
        ends = WALLS.copy()
        along = WALLS[:, 1] - WALLS[:, 0]
        ends += k * moving[:, :, None] * (along / np.linalg.norm(along, axis=1)[:, None])[:, None]
        scans.append((ends - [0.1 * k, 0.05 * k]) @ turn(0.03 * k))
    return np.array(scans)


def compared(moving: Floats, kind: NDArray[np.int8]) -> Any:
    scans = seen_on_the_way(moving)
    n = len(scans)
    rows = np.repeat(np.arange(n), 3), np.tile(np.arange(3), n), scans.reshape(-1, 2, 2)
    return compared_ends(*rows, np.zeros(3 * n), np.tile(kind, (n, 1)))


def test_ends_of_unknown_type_are_classified_by_the_lowest_deviation() -> None:
    moving = np.array([[0.05, 0.0], [0.0, -0.08], [0.03, -0.04]])
    _, static, moved = compared(moving, np.full((3, 2), UNKNOWN, dtype=np.int8))
    np.testing.assert_array_equal(static, moving == 0)
    assert not moved.any()


def test_an_end_cut_by_the_view_is_not_tested() -> None:
    kind = np.full((3, 2), UNKNOWN, dtype=np.int8)
    kind[0, 1] = CUT
    _, static, _ = compared(np.zeros((3, 2)), kind)
    np.testing.assert_array_equal(static, kind == UNKNOWN)


def test_a_corner_that_moves_relative_to_others_is_detected() -> None:
    moving = np.zeros((3, 2))
    moving[1, 1] = -0.12
    _, _, moved = compared(moving, np.full((3, 2), CORNER, dtype=np.int8))
    np.testing.assert_array_equal(moved, moving != 0)


def test_a_standing_robot_gives_no_evidence() -> None:
    still = np.tile(WALLS, (12, 1, 1, 1)).reshape(-1, 2, 2)
    rows = np.repeat(np.arange(12), 3), np.tile(np.arange(3), 12), still
    _, static, _ = compared_ends(*rows, np.zeros(36), np.full((36, 2), UNKNOWN, dtype=np.int8))
    assert not static.any()


@pytest.mark.parametrize("named", [False, True])
def test_walls_without_types_of_ends_are_mapped(named: bool) -> None:
    """Of a building without noise, by "unknown" ends, or by ends without types at all."""
    building = simulate_building(points=10, sigma=0.0, seed=1)
    mapper = PlaneMapper()
    for scan in building.scans:
        seen = SimpleNamespace(ends=scan.seen.ends)
        if named:
            seen.end_type = np.full(scan.seen.end_type.shape, "unknown")
        mapper.update(seen)
    mapper.finish()
    mapper.refine()
    said = mapper.history.corner >= 0
    static = np.concatenate([scan.seen.end_type == "corner" for scan in building.scans])
    assert (said & static).sum() >= 0.95 * said.sum()
    assert (said & static).sum() >= 0.4 * static.sum()
    truth = truth_of(building)
    matched = match_corners(mapper.planes, truth, mapper.trajectory, building.trajectory)
    off = np.linalg.norm(matched.position @ matched.R.T + matched.t - matched.truth, axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.02
    due = np.flatnonzero(truth.corner_scans.ravel() >= 10)
    assert np.isin(due, 2 * matched.wall + matched.end).mean() >= 0.55


@pytest.mark.parametrize("seed", [2, 5])
def test_refining_walls_without_types_of_ends_makes_no_path_worse(seed: int) -> None:
    """Where few ends have a type, an apparent loop may be wrong."""
    building = simulate_building(points=10, sigma=0.0, seed=seed)
    mapper = finished(
        PlaneMapper(), (SimpleNamespace(ends=scan.seen.ends) for scan in building.scans)
    )
    chained_m = ate_m(mapper.trajectory, building.trajectory)
    mapper.refine()
    assert ate_m(mapper.trajectory, building.trajectory) <= chained_m + 1e-9


def test_an_end_that_is_typed_a_corner_but_moves_is_left_out() -> None:
    """A passing shadow ends the middle wall; its type says corner."""
    mapper = PlaneMapper()
    for k in range(40):
        walls = WALLS.copy()
        walls[1, 1, 0] += 0.08 * k
        ends = (walls - [0.03 * k, 0.0]) @ turn(0.01 * k)
        mapper.update(SimpleNamespace(ends=ends, end_type=np.full((3, 2), "corner")))
    mapper.finish()
    mapper.refine()
    corners = mapper.map.positions[:, :2]
    apart = np.linalg.norm(corners[:, None] - WALLS.reshape(-1, 2), axis=2).min(axis=1)
    assert len(corners) >= 5
    assert apart.max() < 0.01


def test_a_run_without_types_of_ends_is_saved_and_resumed_the_same(tmp_path: Path) -> None:
    building = simulate_building(points=10, sigma=0.0, seed=1, iterations=60)
    mapper = PlaneMapper(journal=tmp_path / "run.sqlite")
    for k, scan in enumerate(building.scans):
        mapper.update(SimpleNamespace(ends=scan.seen.ends))
        if k == 30:
            mapper.save(tmp_path / "run.npz")
    mapper.close()
    loaded = PlaneMapper.load(tmp_path / "run.npz")
    fed(loaded, (SimpleNamespace(ends=scan.seen.ends) for scan in building.scans[31:]))
    corners = mapper.history.corner
    assert (corners >= 0).any()
    for other in (loaded, PlaneMapper.resume(tmp_path / "run.sqlite")):
        np.testing.assert_array_equal(other.history.corner, corners)
        np.testing.assert_array_equal(other.map.positions, mapper.map.positions)
