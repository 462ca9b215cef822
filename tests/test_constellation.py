"""Registration by constellation: every track is one landmark, and none is false."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.association import Constellation
from relmap.core.association.tracks import LiveTracks
from tests.worlds import spacing, turn

Points = Floats

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
MISSED = 5


def scattered(n: int, d: int, rng: np.random.Generator, apart: float = 1.0) -> Points:
    """Draw n points, no two nearer than `apart`, about two apart."""
    half, kept = 1.5 * n ** (1 / d), np.empty((0, d))
    while len(kept) < n:
        point = rng.uniform(-half, half, d)
        if (np.linalg.norm(kept - point, axis=1) > apart).all():
            kept = np.vstack([kept, point])
    return kept


def turned(points: Points, degrees: float) -> Points:
    """Observe points from a robot that turned."""
    if points.shape[1] == 2:
        return np.asarray(points @ turn(np.deg2rad(degrees)))
    R = Rotation.from_euler("ZYX", degrees * np.array([1, -0.5, 0.3]), degrees=True).as_matrix()
    return np.asarray(points @ R)


def seen_at(points: Points, k: int) -> Points:
    """Observe points in iteration k from a robot that drives and turns a little."""
    return turned(points - 0.1 * k, 1.5 * k)


def settled(points: Points, sigma: float, rng: np.random.Generator) -> tuple[Constellation, Ints]:
    """Let a registration see the points in iterations 0 to 9; return it and the labels."""
    registration = Constellation(MISSED)
    for k in range(10):
        noisy = seen_at(points, k) + sigma * rng.standard_normal(points.shape)
        labels = registration.match(noisy, None)
    assert labels.tolist() == list(range(len(points)))
    return registration, labels


@both_dimensions
@pytest.mark.parametrize(("sigma", "miss"), [(0.0, 0.0), (0.03, 0.0), (0.03, 0.1)])
@pytest.mark.parametrize("seed", range(3))
def test_every_track_is_one_landmark_for_as_long_as_it_is_in_view(
    d: int, sigma: float, miss: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    world = scattered(110 if d == 2 else 330, d, rng)
    world *= 15 / np.abs(world).max()
    registration, R, t = Constellation(MISSED), np.eye(d), np.zeros(d)
    last: dict[int, int] = {}
    track: dict[int, int] = {}
    number, pairs, farthest, before = itertools.count(), set(), 0.0, world
    for k in range(50):
        axis = rng.normal(size=3)
        angle = np.deg2rad(15) * rng.choice([-1, 1])
        R = (
            R
            @ Rotation.from_rotvec(
                angle * (axis / np.linalg.norm(axis) if d == 3 else np.eye(3)[2])
            ).as_matrix()[:d, :d]
        )
        t = t + rng.uniform(-0.3, 0.3, d)
        here = (world - t) @ R
        in_range = np.linalg.norm(here, axis=1) < 10
        farthest = max(farthest, np.linalg.norm(here - before, axis=1)[in_range].max())
        before = here
        seen = rng.permutation(np.flatnonzero(in_range & (rng.random(len(here)) >= miss)))
        noisy = here[seen] + sigma * rng.standard_normal((len(seen), d))
        labels = registration.match(noisy, None)
        for landmark, label in zip(seen.tolist(), labels.tolist(), strict=True):
            if k - last.get(landmark, -99) > MISSED + 1:
                track[landmark] = next(number)
            last[landmark] = k
            pairs.add((track[landmark], label))
    assert farthest > spacing(world)
    assert len(pairs) == len({true for true, _ in pairs}) == len({label for _, label in pairs})


@both_dimensions
@pytest.mark.parametrize("gap", [1, MISSED, MISSED + 1])
def test_a_missed_landmark_coasts_and_is_taken_up_again(d: int, gap: int) -> None:
    rng = np.random.default_rng(d)
    world = scattered(14, d, rng)
    registration, labels = settled(world, 0.01, rng)
    for k in range(10, 10 + gap):
        labels = registration.match(seen_at(np.delete(world, 4, axis=0), k), None)
        assert labels.tolist() == [0, 1, 2, 3, *range(5, 14)]
    labels = registration.match(seen_at(world, 10 + gap), None)
    assert labels.tolist() == [0, 1, 2, 3, 4 if gap <= MISSED else 14, *range(5, 14)]


@both_dimensions
@pytest.mark.parametrize("seed", range(5))
def test_a_landmark_that_enters_where_another_leaves_is_another(d: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = scattered(16, d, rng)
    registration, _ = settled(world, 0.02, rng)
    swapped = world.copy()
    swapped[3, 0] += 0.25 * spacing(world)  # nearer to the old place than to any neighbour
    others = [0, 1, 2, *range(4, 16)]
    for k in range(10, 20):
        noisy = seen_at(swapped, k) + 0.02 * rng.standard_normal(world.shape)
        labels = registration.match(noisy, None)
        assert labels[3] == 16
        assert labels[others].tolist() == others
    # The track it did not continue has ended.
    assert registration.match(seen_at(world, 20), None)[3] == 17


@both_dimensions
def test_a_mirrored_scan_is_matched_to_nothing(d: int) -> None:
    rng = np.random.default_rng(d)
    world = scattered(20, d, rng)
    registration = Constellation(MISSED)
    for _ in range(6):
        registration.match(world + 0.01 * rng.standard_normal(world.shape), None)
    mirrored = world * np.array([*[1.0] * (d - 1), -1.0])
    assert (registration.match(mirrored, None) >= 20).all()


@both_dimensions
@pytest.mark.parametrize("n", [5, 8, 20])
def test_points_of_another_place_hardly_ever_agree(d: int, n: int) -> None:
    rng = np.random.default_rng(n)
    linked = 0
    for _ in range(40):
        registration, _ = settled(scattered(n, d, rng), 0.02, rng)
        linked += int((registration.match(scattered(n, d, rng), None) < n).any())
    assert linked <= 2


@both_dimensions
@pytest.mark.parametrize("sigma", [0.0, 0.02])
def test_a_moving_landmark_is_followed_by_continuity(d: int, sigma: float) -> None:
    rng = np.random.default_rng(3)
    world = scattered(16, d, rng)
    outermost = int(np.argmax(np.linalg.norm(world, axis=1)))
    away = world[outermost] / np.linalg.norm(world[outermost])
    registration = Constellation(MISSED)
    for k in range(25):
        moved = world.copy()
        moved[outermost] += 0.1 * spacing(world) * k * away
        noisy = seen_at(moved, k) + sigma * rng.standard_normal(world.shape)
        assert registration.match(noisy, None).tolist() == list(range(16))


@both_dimensions
def test_a_scan_that_cannot_be_tied_begins_new_tracks_and_ends_none(d: int) -> None:
    rng = np.random.default_rng(d)
    world, elsewhere = scattered(12, d, rng), scattered(12, d, rng)
    registration, labels = settled(world, 0.02, rng)
    assert registration.match(elsewhere, None).tolist() == list(range(12, 24))
    np.testing.assert_array_equal(registration.match(seen_at(world, 11), None), labels)
    # One that is followed by another like it is where the robot is now.
    there = registration.match(elsewhere, None).tolist()
    assert there == list(range(24, 36))
    assert registration.match(seen_at(elsewhere, 1), None).tolist() == there


@both_dimensions
def test_after_the_end_of_tracks_the_last_scan_continues(d: int) -> None:
    rng = np.random.default_rng(d)
    registration, _ = settled(scattered(12, d, rng), 0.02, rng)
    for k in range(MISSED + 1):
        place = scattered(12, d, rng)
        labels = registration.match(place, None)
        assert labels.tolist() == list(range(12 * (k + 1), 12 * (k + 2)))
    np.testing.assert_array_equal(registration.match(seen_at(place, 1), None), labels)


@settings(max_examples=40)
@given(seeds, dimensions)
def test_scans_of_any_size_get_labels(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    world = scattered(6, d, rng)
    first, second = Constellation(2), Constellation(2)
    known: set[int] = set()
    for k, n in enumerate(rng.integers(0, 7, 15)):
        scan = seen_at(world[rng.permutation(6)[:n]], k)
        labels = first.match(scan, None)
        np.testing.assert_array_equal(labels, second.match(scan.copy(), None))
        assert len(set(labels.tolist())) == n
        known |= set(labels.tolist())
    assert known == set(range(len(known)))


def numbers_after_noise_sets_in(n: int, d: int) -> int:
    """Stand still without noise, then set off with it; return how many landmarks there were."""
    rng = np.random.default_rng(n)
    world = scattered(n, d, rng)
    registration = Constellation(MISSED)
    for _ in range(20):
        registration.match(world, None)
    for k in range(20):
        noisy = seen_at(world, k) + 0.05 * rng.standard_normal(world.shape)
        latest = registration.match(noisy, None)
    return int(latest.max()) + 1


@both_dimensions
@pytest.mark.parametrize("n", [6, 12, 24])
def test_tracks_survive_when_noise_sets_in(d: int, n: int) -> None:
    assert numbers_after_noise_sets_in(n, d) <= n + 1


@both_dimensions
def test_many_tracks_survive_when_noise_sets_in(d: int) -> None:
    assert numbers_after_noise_sets_in(40, d) <= 43


@both_dimensions
def test_few_tracks_are_held_again_some_time_after_noise_set_in(d: int) -> None:
    assert numbers_after_noise_sets_in(5, d) <= 5 + 5 * (MISSED + 5)


@both_dimensions
def test_a_first_scan_of_one_point_does_not_matter(d: int) -> None:
    world = scattered(12, d, np.random.default_rng(0))
    registration = Constellation(MISSED)
    registration.match(world[:1], None)
    labels = [registration.match(seen_at(world, k), None) for k in range(10)]
    np.testing.assert_array_equal(labels[-1], labels[-2])


@pytest.mark.parametrize("seed", range(10))
def test_a_scan_continues_the_deferred_one_where_tracks_match_by_chance(seed: int) -> None:
    """With noise, a few of the tracks from before the robot turned may match as well."""
    rng = np.random.default_rng(seed)
    before, after = scattered(30, 2, rng), scattered(30, 2, rng)
    registration = Constellation(MISSED)

    def labels(points: Points) -> Ints:
        return registration.match(points + 0.15 * rng.standard_normal(points.shape), None)

    for k in range(10):
        labels(seen_at(before, k))
    deferred = labels(after)
    few = before[rng.permutation(30)[:7]]
    continued = labels(np.vstack([turned(after, 3.0), seen_at(few, 11)]))
    assert np.sum(continued[:30] == deferred) >= 27


def test_new_tracks_that_are_missed_did_not_stray() -> None:
    tracks = LiveTracks.begun(np.arange(3), np.zeros((3, 2)))
    tracks.missed += 1
    assert tracks.restless.tolist() == [0, 0, 0]


@both_dimensions
def test_a_scan_is_matched_when_the_tracks_seen_longest_have_left_the_view(d: int) -> None:
    rng = np.random.default_rng(8)
    points = rng.permutation(scattered(100, d, rng))
    registration, _ = settled(points[:40], 0.01, rng)
    registration.match(seen_at(points, 10), None)
    assert registration.match(turned(points[40:], 100.0), None).tolist() == list(range(40, 100))


@pytest.mark.parametrize("seed", [0, 1])
def test_scans_in_a_tunnel_of_equal_rings_are_not_matched_one_ring_off(seed: int) -> None:
    """Where one ring appears as another leaves, a motion of one period matches more points."""
    rng = np.random.default_rng(seed)
    rings = [(5.0 * k, 2 * np.cos(a), 2 * np.sin(a)) for k in range(26) for a in (0.3, 1.57, 2.84)]
    marks = np.array(rings) + rng.normal(0, 0.02, (78, 3))
    tracks, owner, wrong = Constellation(MISSED), dict[int, int](), 0
    for x in np.arange(0.0, 100.0, 0.8):
        off = marks - [x, 0.0, -1.0]
        bearing = np.abs(np.arctan2(off[:, 1], off[:, 0]))
        seen = np.flatnonzero((np.linalg.norm(off, axis=1) < 16) & (bearing < np.pi / 3))
        seen = seen[rng.random(len(seen)) > 0.05]
        labels = tracks.match(off[seen] + rng.normal(0, 0.03, (len(seen), 3)), None)
        for label, mark in zip(labels.tolist(), seen.tolist(), strict=True):
            wrong += owner.setdefault(label, mark) != mark
    assert wrong == 0
    assert len(owner) < 400  # within a period tracks go on
