"""Unsupported or implausible motions break a run of walls into submaps."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.planes.refinement import refined_map
from relmap.planes.refinement.system import WallSystem
from relmap.planes.submaps.submap import disagreement, stitched
from relmap.planes.walls.assembly import Walls
from relmap.simulation import simulate_building
from relmap.simulation.visibility import seen_walls
from tests.test_planes import CORRIDOR, ROOM, seen_from
from tests.worlds import finished, refined

NOTHING = SimpleNamespace(ends=np.empty((0, 2, 2)), end_type=np.empty((0, 2), dtype=str))
ELSEWHERE = np.array(
    [[[5.0, -1.0], [3.0, 4.0]], [[1.5, 3.5], [0.0, 3.8]], [[1.0, -2.5], [2.5, -2.0]]]
)
"""Another room, which no motion lays onto the first."""


def drive(mapper: PlaneMapper, scans: int, walls: Floats = ROOM, noise_m: float = 0.0) -> None:
    """Go a little ahead in a room."""
    for k in range(scans):
        seen = seen_from(-1.5 + 0.05 * k, 0.0, 0.01 * k, walls, half_view=1.5)
        one = np.ones(len(seen.ends))
        about = {"ends": seen.ends, "end_type": seen.end_type, "noise": noise_m * one}
        mapper.update(SimpleNamespace(**about, n_points=one))


def test_a_scan_that_nothing_supports_begins_a_submap() -> None:
    mapper = PlaneMapper()
    drive(mapper, 20)
    drive(mapper, 14, ELSEWHERE)
    mapper.finish()
    for _ in range(2):
        assert [submap.span for submap in mapper.submaps] == [(0, 20), (20, 34)]
        there = np.isfinite(mapper.trajectory[:, 0, 0])
        assert np.flatnonzero(there).tolist() == list(range(20))
        for submap in mapper.submaps:
            steps = np.linalg.norm(np.diff(submap.poses[:, :2, 3], axis=0), axis=1)
            np.testing.assert_allclose(steps, 0.05, atol=1e-6)
        mapper.refine()
    assert 20 not in mapper.weak_links
    assert len(mapper.submaps) == 2
    assert set(mapper.landmarks.submap.tolist()) >= {0, 1}


def test_the_longest_submap_is_the_first() -> None:
    mapper = PlaneMapper()
    drive(mapper, 14, ELSEWHERE)
    drive(mapper, 20)
    mapper.finish()
    assert [submap.span for submap in mapper.submaps] == [(14, 34), (0, 14)]


def test_a_long_bridge_ends_the_submap() -> None:
    """Few scans without walls are bridged; after many the motion into each is unknown."""
    mapper = PlaneMapper()
    drive(mapper, 20)
    for _ in range(30):
        mapper.update(NOTHING)
    drive(mapper, 15)
    mapper.finish()
    (first, second) = mapper.submaps
    assert first.span == (0, 20)
    assert second.span == (50, 65)


def test_an_implausible_jump_is_rejected() -> None:
    """Walls 2.5 m further look alike; a robot that goes 0.1 m a scan hardly went there.

    It did here, by 1.3 m: the usual step takes its place, and is named as weak.
    """
    row = np.array([[[3.0, 0.2 + 2.5 * k], [3.0, 1.7 + 2.5 * k]] for k in range(-6, 7)])

    def seen(y: float) -> Any:
        return seen_walls(row - [0.0, y], 8.0, 0.9)

    mapper = finished(
        PlaneMapper(), (seen(0.1 * k if k < 20 else 0.1 * k + 1.2) for k in range(40))
    )
    (submap,) = mapper.submaps
    assert np.linalg.norm(np.diff(submap.poses[:, :2, 3], axis=0), axis=1).max() < 0.5
    assert mapper.weak_links.tolist() == [20]


def test_stop_and_go_along_a_wall_is_not_bridged_for_long() -> None:
    """Where the speed varied before, it is not known along a single partial wall."""
    mapper, x = PlaneMapper(), -1.0
    for k in range(120):
        x += 0.1 if k % 2 else 0.35
        mapper.update(seen_from(x, 0.0, 0.0, CORRIDOR, np.pi / 2, 5.0))
    mapper.finish()
    assert len(mapper.submaps) > 1
    assert len(mapper.weak_links) > 0


def test_a_torn_path_disagrees_with_its_links() -> None:
    motions = np.tile([0.0, -0.2, 0.0], (30, 1))
    poses = stitched([np.full((30, 4, 4), np.nan)], motions)
    n_torn, off_m = disagreement(poses, motions)
    assert n_torn == 0
    assert off_m < 1e-12
    torn = poses.copy()
    torn[15:, 1, 3] += 40.0
    assert disagreement(torn, motions)[0] == 1


def test_a_map_that_refining_tears_stays_as_chained(monkeypatch: pytest.MonkeyPatch) -> None:
    from relmap.planes.refinement import refined_map
    from relmap.planes.refinement.solving import refined

    mapper = PlaneMapper()
    drive(mapper, 30)
    mapper.finish()
    chained = mapper.trajectory

    def torn(assembled: Any, rounds: Any, held: float) -> Any:
        best = refined(assembled, rounds, held)
        best.state.t[10:] += 800.0
        return best

    monkeypatch.setattr(refined_map, "refined", torn)
    mapper.refine()
    np.testing.assert_array_equal(mapper.trajectory, chained)
    assert [submap.refined for submap in mapper.submaps] == [False]


def test_a_map_that_settles_late_is_refined(monkeypatch: pytest.MonkeyPatch) -> None:
    from relmap.planes.refinement import refined_map
    from relmap.planes.refinement.solving import LAST, refined

    last = list[bool]()

    def late(assembled: Any, rounds: Any, held: float) -> Any:
        best = refined(assembled, rounds, held)
        last.append(rounds == (LAST,) and held == 0)
        return replace(best, settled=best.settled and sum(last) > 1)

    monkeypatch.setattr(refined_map, "refined", late)
    mapper = PlaneMapper()
    drive(mapper, 30)
    mapper.finish()
    mapper.refine()
    assert [submap.refined for submap in mapper.submaps] == [True]
    assert sum(last) == 2


@pytest.mark.parametrize(("every", "off_m"), [(1, 800.0), (2, 0.002)], ids=["torn", "off-links"])
def test_a_map_that_lowering_the_noise_bends_stays_as_refined(
    monkeypatch: pytest.MonkeyPatch, every: int, off_m: float
) -> None:
    from relmap.planes.refinement import refined_map

    def bent(assembled: Any, _: float) -> Any:
        state = replace(assembled.state, t=assembled.state.t.copy())
        state.t[10::every] += off_m
        return replace(assembled, state=state)

    monkeypatch.setattr(refined_map, "refined_to_the_noise", bent)
    mapper = PlaneMapper()
    drive(mapper, 30, noise_m=0.003)
    mapper.finish()
    chained = mapper.trajectory
    mapper.refine()
    assert [submap.refined for submap in mapper.submaps] == [True]
    np.testing.assert_allclose(mapper.trajectory, chained, atol=0.001)


def test_steps_of_refinement_are_bounded() -> None:
    """A poorly connected part is not moved beyond the map."""
    from relmap.planes.walls.assembly import WallEquations

    walls = np.array([[[4.0, -3.0], [4.0, 3.0]], [[4.0, 3.0], [-2.0, 3.0]]])
    n = 20
    # The second wall's direction is known from a speck of it, which is quite wrong.
    ends = np.tile(walls, (n, 1, 1))
    ends[1::2, 1] = ends[1::2, 0] + np.array([1e-7, 3e-3])
    none = np.empty(0, dtype=np.int64)
    iteration = np.repeat(np.arange(n), 2)
    wall, sd, no_sd = np.tile([0, 1], n), np.full(2 * n, 0.01), np.empty(0)
    given = WallEquations(iteration, wall, ends, sd, none, none, none, no_sd, no_sd)
    state = Walls(
        np.zeros(n),
        np.column_stack([np.linspace(0.0, 500.0, n), np.zeros(n)]),
        walls.mean(axis=1),
        np.array([np.pi, -np.pi / 2]),
        np.zeros(2),
        np.empty(0),
    )
    system = WallSystem(given)
    for _ in range(5):
        after = system.refine(state, 1, 1e4)
        assert np.abs(after.t - state.t).max() <= 2 * 505.0
        assert np.abs(after.yaw - state.yaw).max() <= np.pi / 2 + 1e-12
        state = after
    assert np.isfinite(state.t).all()


@pytest.mark.parametrize(("lost", "torn"), [(1, 1), (2, 1), (3, 0)])
def test_a_path_follows_its_links_across_a_few_lost_scans(lost: int, torn: int) -> None:
    """A part behind a lost scan slid 31 m along a corridor when the map was refined."""
    motions = np.tile([0.1, -0.5, 0.02], (12, 1))
    poses = stitched([], motions)
    poses[5 : 5 + lost] = np.nan
    assert disagreement(poses, motions) == pytest.approx((0, 0.0), abs=1e-12)
    poses[5 + lost :, 0, 3] += 3.0
    assert disagreement(poses, motions)[0] == torn


def test_only_submaps_that_stay_as_chained_are_warned_of(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A submap that refinement tears is cut there, and its parts are refined."""
    run = simulate_building(points=181, sigma=0.01, sampling="laser", iterations=40)
    calls = count()

    def disagrees(poses: Floats, motions: Floats) -> tuple[float, float]:
        """The map, which comes first, disagrees with more links than the chain does."""
        return (-float(next(calls)), 0.0) if len(poses) > 30 else disagreement(poses, motions)

    monkeypatch.setattr(refined_map, "disagreement", disagrees)
    monkeypatch.setattr(refined_map, "torn_in", lambda *_: np.array([20]))
    mapper = refined(PlaneMapper(), (scan.points[:, :2] for scan in run.scans))
    assert [submap.n_scans for submap in mapper.submaps] == [20, 20]
    assert all(submap.refined for submap in mapper.submaps)
    assert "kept as chained" not in caplog.text
