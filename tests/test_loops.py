"""Places that a map shows twice are found, and the drift between is spread; look-alikes are not."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.association.reobservation import loops
from relmap.core.association.reobservation.evidence import Evidence, chosen
from relmap.core.association.reobservation.loops import LoopFinder
from relmap.core.association.search import search
from relmap.core.map.globalmap import GlobalMap
from relmap.core.state.table import LandmarkState
from relmap.simulation import WorldSpec, simulate_world
from tests.worlds import purity_of, random_rotation, stands_for, without_ids

SIGMA = 0.02


def seen_twice(shift_m: float) -> tuple[LandmarkState, int]:
    """Return a road of landmarks whose end is its beginning again, mapped elsewhere; and its size.

    Each landmark is in view for ten iterations, one after the other.
    """
    rng = np.random.default_rng(0)
    n = 120
    road = np.column_stack([np.arange(n) * 1.0, rng.uniform(-5, 5, n)])
    again = road[:40] + [shift_m, 0.0] + SIGMA * rng.standard_normal((40, 2))
    table = LandmarkState()
    table.resize(n + 40, 0, 2)
    everyone = np.arange(n + 40)
    global_map = GlobalMap(table)
    positions = np.vstack([road, again])
    # Positions as noisy as one observation.
    global_map.place(global_map.new_submap(), everyone, positions, np.ones(n + 40))
    table.first[:] = table.since[:] = 2 * everyone
    table.last[:] = 2 * everyone + 30
    return table, n


def test_a_place_seen_twice_is_found_where_the_map_has_drifted() -> None:
    table, n = seen_twice(shift_m=0.35)
    loop = LoopFinder(table, SIGMA).next()
    assert loop is not None
    pairs, _ = loop
    assert len(pairs) >= 10
    np.testing.assert_array_equal(pairs[:, 0] - n, pairs[:, 1])


def test_a_place_farther_off_than_a_map_drifts_is_another() -> None:
    table, _ = seen_twice(shift_m=60.0)
    assert LoopFinder(table, SIGMA).next() is None


def test_a_scan_is_found_among_landmarks_that_stand_in_pairs() -> None:
    """As the two edges of posts do: a spacing of 0.05 m says little of how they lie."""
    rng = np.random.default_rng(0)
    posts, edge = rng.uniform(-30.0, 30.0, (80, 2)), rng.uniform(0.0, 2 * np.pi, 80)
    world = np.vstack([posts, posts + 0.05 * np.column_stack([np.cos(edge), np.sin(edge)])])

    def seen(at: Floats, yaw: float) -> tuple[Floats, Ints]:
        c, s = np.cos(yaw), np.sin(yaw)
        points = (world - at) @ np.array([[c, -s], [s, c]])
        near = np.flatnonzero(np.linalg.norm(points, axis=1) < 20.0)
        return points[near] + SIGMA * rng.standard_normal((len(near), 2)), near

    mapper = PointMapper()
    for yaw in np.linspace(0.0, 2 * np.pi, 80):
        points, ids = seen(12.0 * np.array([np.cos(yaw), np.sin(yaw)]), yaw)
        mapper.update(points, ids=ids)
    mapper.refine()
    begin = np.array([12.0, 0.0])  # in the first scan, which has the frame of the map
    for _ in range(5):
        at = rng.uniform(-14.0, 14.0, 2)
        place = mapper.locate(seen(at, rng.uniform(0.0, 2 * np.pi))[0])
        assert place.n_places == 1
        np.testing.assert_allclose(place.T_map_robot[:2, 3], at - begin, atol=0.1)


@pytest.mark.parametrize("shift_m", [6.0, 30.0])
def test_likelihood_does_not_take_another_place_for_one_within_the_drift(shift_m: float) -> None:
    for shift, expected in ((0.35, True), (shift_m, False)):
        table, _ = seen_twice(shift)
        table.observations[:] = table.weight[:] = 10
        found = LoopFinder(table, SIGMA, is_blurred=True).next() is not None
        assert found == expected


def test_a_map_without_loops_has_none() -> None:
    table, n = seen_twice(shift_m=2.0)
    table.submap[n:] = -1
    assert LoopFinder(table, SIGMA).next() is None


def test_landmarks_that_were_all_in_view_at_once_are_not_searched(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With thousands of landmarks in view the search would take minutes."""
    table, _ = seen_twice(shift_m=0.35)
    table.since[:], table.last[:] = 0, 5
    searched: list[object] = []
    monkeypatch.setattr(loops, "PlaceFinder", lambda *given: searched.append(given))
    assert LoopFinder(table, SIGMA).next() is None
    assert not searched


def test_a_ring_is_closed_over_a_drift_of_metres() -> None:
    spec = WorldSpec(kind="ring", length_m=1000.0, iterations=600, seed=3)
    world = simulate_world(spec)
    mapper, labels = without_ids(world.log)
    mapper.refine()
    now = mapper.landmarks_of(labels)
    assert purity_of(now, world.true_ids) >= 0.998
    id_of = stands_for(now, world.true_ids)
    true = [id_of[label] for label in mapper.map.landmark_ids]
    assert len(true) <= 1.02 * len(set(true))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_half_a_scan_is_found_after_any_turn(d: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-10, 10, (30, d))
    R, t = random_rotation(d, 3.0, rng), rng.uniform(-5, 5, d)
    there = rng.uniform(-10, 10, (30, d)) @ R.T + t
    there[:15] = points[:15] @ R.T + t + SIGMA * rng.standard_normal((15, d))
    found = search(points, rng.permutation(there), 0.1, 3)
    placement, rival = found
    assert placement.n_agreeing >= 13
    assert rival <= 8
    assert np.abs(placement.apply(points[:15]) - there[:15]).max() <= 0.2


def test_a_lattice_has_rivals() -> None:
    lattice = np.stack(np.meshgrid(np.arange(5.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    found = search(lattice, lattice + 0.3, 0.05, 3)
    assert found[1] >= 0.6 * found[0].n_agreeing


def evidence(n_tied: int, n_new: int) -> Evidence:
    """Return what is known where so many in view were seen when the older ones were, or not."""
    first = np.repeat([0, 50], [n_tied, n_new])
    return Evidence(first, 0.01, 0.35, np.full(40, 10.0), np.full(40, 20), np.arange(40), None)


def test_a_coincident_pair_needs_support() -> None:
    position = np.random.default_rng(0).uniform(0, 50, (40, 2))
    position[20] = position[0] + 0.01
    pair = np.array([[20, 0]])
    assert len(chosen(position, pair, 0.15, evidence(0, 15))) == 0
    assert chosen(position, pair, 0.15, evidence(5, 15)).tolist() == [[20, 0]]
    position[21:25] = position[1:5] + 0.01
    several = np.column_stack([np.arange(20, 25), np.arange(5)])
    assert len(chosen(position, several, 0.15, evidence(0, 15))) == 5


def test_a_constellation_that_fits_two_older_ones_is_merged_with_neither() -> None:
    position = np.random.default_rng(0).uniform(0, 50, (40, 2))
    shift = np.array([1.0, 0.5])
    position[5:10], position[20:25] = position[:5] + 3 * shift, position[:5] + shift
    one, other = (np.column_stack([np.arange(20, 25), np.arange(k, k + 5)]) for k in (0, 5))
    assert chosen(position, one, 0.15, evidence(0, 15)).tolist() == one.tolist()
    assert len(chosen(position, np.concatenate([one, other]), 0.15, evidence(0, 15))) == 0
    # Three of the other five are a rival of less than 0.8 of the matches.
    assert len(chosen(position, np.concatenate([one, other[:3]]), 0.15, evidence(0, 15))) == 5


def test_the_share_of_tied_scans_falls_where_a_scan_fits_nothing() -> None:
    scans = [scan.points_robot for scan in simulate_world(WorldSpec(iterations=400)).log.scans()]
    whole, broken = PointMapper(), PointMapper()
    rng = np.random.default_rng(0)
    for k, points in enumerate(scans[100:130]):
        whole.update(points)
        broken.update(rng.uniform(-20, 20, (15, 2)) if k == 20 else points)
    assert whole.tied_share == 1
    assert broken.tied_share == pytest.approx(1 - 1 / 29)
    assert whole.unique_share == 1
    assert broken.unique_share == pytest.approx(1 - 1 / 29)
    broken.update(np.empty((0, 2)))
    assert broken.tied_share == broken.unique_share == pytest.approx(1 - 1 / 29)
    single = PointMapper()
    for points in (scans[0], np.empty((0, 2))):
        single.update(points)
        assert single.tied_share is None
        assert single.unique_share is None
    with_ids = PointMapper()
    with_ids.update(scans[0], np.arange(len(scans[0])))
    assert with_ids.tied_share is None
    assert with_ids.unique_share is None
