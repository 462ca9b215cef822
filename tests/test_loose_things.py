"""Small free-standing objects, such as people: they link scans only if they stay in place."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.core.state.store import ObservationStore
from relmap.planes.linking.tying import Scans, share_at_rest
from relmap.planes.scans import loose_kernels
from relmap.planes.scans.beam_store import BeamStore
from relmap.planes.scans.beams import Beams, GivenBeams
from relmap.planes.scans.observation import checked_planes, journaled, of_journal
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import simulate_building
from tests.worlds import refined, submap_ate_m

BEARING = np.linspace(-np.pi / 2, np.pi / 2, 361)
BODY_M = 0.2
NO_WALLS = np.empty((0, 2, 2))
EVERY = 7
"""Of so many beams one hits clutter."""


def seen_from(x_m: float, person: tuple[float, float] | None) -> Floats:
    """Return a scan in a corridor with an end at 6 m, where a person may stand; robot frame."""
    ray = np.column_stack([np.cos(BEARING), np.sin(BEARING)])
    range_m = 1.2 / np.maximum(np.abs(ray[:, 1]), 1e-9)
    range_m = np.minimum(range_m, (6 - x_m) / np.maximum(ray[:, 0], 1e-9))
    if person is not None:
        at = np.array(person) - [x_m, 0.0]
        along = ray @ at
        left = along**2 - at @ at + BODY_M**2
        met = (left > 0) & (along > 0)
        range_m[met] = np.minimum(range_m[met], along[met] - np.sqrt(left[met]))
    return np.asarray(range_m[:, None] * ray)


def cluttered(points: Floats, seed: int = 0) -> Floats:
    """Return a scan in which some beams end at half of their range or less, at random."""
    points, rng = points.copy(), np.random.default_rng(seed)
    points[seed % EVERY :: EVERY] *= rng.uniform(0.2, 0.5, (len(points[seed % EVERY :: EVERY]), 1))
    return points


@pytest.mark.parametrize("person", [None, (2.0, 0.3), (4.0, -0.5)])
def test_points_on_a_person_are_loose_and_those_on_walls_are_not(
    person: tuple[float, float] | None,
) -> None:
    beams = Beams.of(GivenBeams.checked(seen_from(0.0, person), np.zeros(2)), NO_WALLS)
    on = np.zeros(len(beams), dtype=np.bool_)
    if person is not None:
        on = np.hypot(*(beams.points - person).T) < BODY_M + 1e-6
    np.testing.assert_array_equal(beams.loose, on)


@pytest.mark.parametrize("turn", [0.5 * np.pi, np.pi])
@pytest.mark.parametrize("clutter", [False, True])
def test_a_person_anywhere_round_the_sensor_is_loose(turn: float, clutter: bool) -> None:
    """Also straight behind it, where the bearings begin and end."""
    bearing = turn + np.deg2rad(np.arange(-180.0, 180.0, 0.5))
    on = np.abs(np.arange(720) - 360) < 20
    ranges = np.where(on, 2.0, 5.0)
    ranges[361 if clutter else 0 :: EVERY] *= 0.3 if clutter else 1.0
    points = ranges[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    beams = GivenBeams.checked(points, np.zeros(2))
    at = np.hypot(*beams.by_bearing[0].T)
    assert beams.loose[np.abs(at - 2.0) < 0.01].all()
    assert not beams.loose[np.abs(at - 5.0) < 0.01].any()
    np.testing.assert_array_equal(beams.clutter, (at < 1.9) & clutter)


def test_clutter_does_not_divide_a_person() -> None:
    points = seen_from(0.0, (2.0, 0.3))
    beams = GivenBeams.checked(cluttered(points), np.zeros(2))
    on = np.hypot(*(beams.by_bearing[0] - [2.0, 0.3]).T) < BODY_M + 1e-6
    assert on.sum() > 15
    assert beams.loose[on].all()
    on_wall = np.arange(len(points)) % EVERY != 0
    assert not beams.loose[on_wall & ~on].any()


def test_walls_on_a_person_are_loose_also_in_a_journal() -> None:
    points = seen_from(0.0, (2.0, 0.3))
    planes = PlaneSegmenter(view_rad=np.pi, range_m=20.0).fit(points).planes_
    seen = checked_planes(planes, points)
    near = np.hypot(*(seen.ends.mean(axis=1) - [2.0, 0.3]).T) < 0.3
    assert near.any()
    np.testing.assert_array_equal(seen.loose, near)
    assert seen.static[~near].any()
    np.testing.assert_array_equal(checked_planes(of_journal(journaled(seen))).kind, seen.kind)


def test_loose_points_of_a_scan_are_searched_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    given = GivenBeams.checked(cluttered(seen_from(0.0, (3.0, 0.3))), np.zeros(2))
    store = BeamStore()
    store.append(given)
    for name in ("isolated_points", "free_standing"):
        monkeypatch.delattr(loose_kernels, name)
    again = store.given(0)
    assert again.loose.any()
    assert again.clutter.any()
    np.testing.assert_array_equal(again.loose, given.loose)
    np.testing.assert_array_equal(again.clutter, given.clutter)


@pytest.mark.parametrize("clutter", [False, True])
@pytest.mark.parametrize("walks", [False, True])
def test_whether_share_at_rest_is_known_from_accepted_links(walks: bool, clutter: bool) -> None:
    n, step_m = 20, 0.1
    beams, none = BeamStore(), np.empty(0, dtype=np.int64)
    store = ObservationStore({"landmark": none, "location": NO_WALLS})
    for k in range(n):
        person = (3.0 + 0.1 * k * walks, 0.3)
        points = seen_from(step_m * k, person)
        points = cluttered(points, k) if clutter else points
        beams.append(GivenBeams.checked(points, np.zeros(2)))
        store.append(none, NO_WALLS)
    motions, measured = np.tile([0.0, -step_m, 0.0], (n, 1)), np.ones(n, dtype=np.bool_)
    scans = Scans(store, beams, motions, measured, lambda a, b: None, none)
    share = share_at_rest(scans, measured)
    assert share < 0.3 if walks else share > 0.8


def test_a_crowd_does_not_drag_the_map_along() -> None:
    """With the people's bodies as walls, it was 0.9 m off here."""
    run = simulate_building(361, 0.01, sampling="laser", seed=1, step_m=0.1, people=15)
    mapper = refined(
        PlaneMapper(segmenter=PlaneSegmenter(view_rad=np.pi, range_m=8.0)),
        (scan.points[:, :2] for scan in run.scans[:86]),
    )
    submap = mapper.submaps[0]
    known = np.isfinite(submap.poses[:, 0, 0])
    assert known.sum() > 60
    assert submap_ate_m(submap, run.trajectory) < 0.1
