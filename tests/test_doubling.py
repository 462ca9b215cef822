"""Stretches mapped beside the place that they show are found; the two faces of a wall are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from relmap import PointMapper
from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.reobservation.doubling import places_shown_twice
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.map.globalmap import GlobalMap
from relmap.core.state.table import LandmarkState
from relmap.simulation import WorldSpec, simulate_world

TOLERANCE_M = 0.1


class Seen(Sightings):
    """Sightings given as scans that show landmarks (s, m)."""

    def __init__(self, shown: Bools) -> None:
        self._shown = csr_array(shown.T.astype(np.int32))

    def met(self, landmarks: Ints) -> csr_array:
        rows = self._shown[landmarks]
        return (rows @ rows.T).astype(np.bool_)


def mapped(positions: Floats) -> LandmarkState:
    """Return a map of one submap."""
    table, everyone = LandmarkState(), np.arange(len(positions))
    table.resize(len(positions), 0, positions.shape[1])
    global_map = GlobalMap(table)
    global_map.place(global_map.new_submap(), everyone, positions, np.full(len(positions), 10.0))
    return table


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n_again", [0, 12])
def test_a_stretch_beside_the_place_that_it_shows_is_found(d: int, n_again: int) -> None:
    """Two visits of a field, far apart in time or not, the second shifted and turned."""
    rng = np.random.default_rng(4)
    field = rng.uniform(0, 12, (60, d))
    again = np.argsort(np.linalg.norm(field - 6, axis=1))[:n_again]
    turn = Rotation.from_euler("z", 0.1).as_matrix()[:d, :d]
    shifted = (field[again] - 6) @ turn.T + 6 + np.full(d, 1.2) + rng.normal(0, 0.01, (n_again, d))
    table = mapped(np.vstack([field, shifted]))
    shown = np.zeros((2, 60 + n_again), dtype=np.bool_)
    shown[0, :60] = shown[1, 60:] = True
    shown[:, 0] = False  # in no segment
    found = list(places_shown_twice(table, Seen(shown), TOLERANCE_M))
    if not n_again:
        assert not found
        return
    later, older = found[0].T
    same = np.concatenate([np.arange(60), again])
    np.testing.assert_array_equal(same[later], same[older])
    assert len(later) >= 6
    R, t = fit_rigid(table.position[later], table.position[older])
    moved = table.position[later] @ R.T + t
    assert np.linalg.norm(moved - table.position[older], axis=1).max() <= TOLERANCE_M


def test_the_two_faces_of_a_wall_are_not_one() -> None:
    """Windows seen from a room, and the same ones from outside, 0.4 m away."""
    rng = np.random.default_rng(0)
    windows = np.sort(rng.uniform(0, 15, 25))
    inside, outside = (np.column_stack([windows, np.full(25, y)]) for y in (0.0, 0.4))
    room, yard = (
        np.column_stack([rng.uniform(0, 15, 15), rng.uniform(y, y + 8, 15)]) for y in (-9, 1.4)
    )
    table = mapped(np.vstack([inside, room, outside, yard]))
    shown = np.repeat(np.eye(2, dtype=np.bool_), 40, axis=1)
    assert not list(places_shown_twice(table, Seen(shown), TOLERANCE_M))


def test_a_stretch_that_fits_after_several_shifts_is_left() -> None:
    """Part of a lattice amid another one, half a period off: it fits a period farther as well."""
    at = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2)
    amid = at[(np.abs(at - 3.5) < 2).all(axis=1)] + 0.5
    shown = np.repeat(np.eye(2, dtype=np.bool_), [len(at), len(amid)], axis=1)
    assert not list(places_shown_twice(mapped(np.vstack([at, amid])), Seen(shown), TOLERANCE_M))


def test_a_lattice_is_not_shifted_by_a_period() -> None:
    at = np.stack(np.meshgrid(np.arange(12.0), np.arange(8.0)), axis=-1).reshape(-1, 2)
    shown = np.array([at[:, 0] < 6, at[:, 0] >= 6])
    assert not list(places_shown_twice(mapped(at), Seen(shown), TOLERANCE_M))


def test_landmarks_that_were_seen_together() -> None:
    world, mapper = simulate_world(WorldSpec(length_m=200.0, iterations=80)), PointMapper()
    labels = [mapper.update(scan.points_robot) for scan in world.log.scans()]
    mapper.finish()
    engine = mapper.engine
    rows = engine.rows
    sightings = Sightings(rows, engine.table)
    own = np.flatnonzero(engine.table.weight > 0)
    shown = np.array([np.isin(own, mapper.landmarks_of(seen)) for seen in labels])
    together = (shown.T.astype(int) @ shown) > 0
    np.testing.assert_array_equal(sightings.met(own).toarray(), together)
    pairs = np.column_stack([np.arange(len(own) - 1), np.arange(1, len(own))])
    both = [together[one] & together[other] for one, other in pairs]
    expected = [b.sum() - b[one] - b[other] for b, (one, other) in zip(both, pairs, strict=True)]
    np.testing.assert_array_equal(sightings.seen_with_both(own[pairs], own), expected)
    for kept in (engine.table.now(rows.landmark) != own[-1], np.zeros(len(rows.landmark), bool)):
        columns = {name: getattr(rows, name)[kept] for name in ("landmark", "segment", "visible")}
        fewer = Sightings(replace(rows, **columns), engine.table).met(own).toarray()
        np.testing.assert_array_equal(fewer[:-1, :-1], together[:-1, :-1] & kept.any())
        assert not fewer[-1].any()
