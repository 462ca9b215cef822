from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from relmap.core.alignment import fit_rigid
from relmap.core.registration import Constellation, KnownAssociation, NearestPrevious
from relmap.core.registration.placement import agreeing_pairs, trimmed_fit
from relmap.core.registration.tracks import LiveTracks
from tests.worlds import random_rotation

Points = NDArray[np.float64]

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
    """Show points to a robot that turned."""
    if points.shape[1] == 2:
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        return np.asarray(points @ np.array([[c, -s], [s, c]]))
    R = Rotation.from_euler("ZYX", degrees * np.array([1, -0.5, 0.3]), degrees=True).as_matrix()
    return np.asarray(points @ R)


def seen_at(points: Points, k: int) -> Points:
    """Show points in iteration k to a robot that drives and turns a little."""
    return turned(points - 0.1 * k, 1.5 * k)


def settled(
    points: Points, sigma: float, rng: np.random.Generator
) -> tuple[Constellation, NDArray[np.int64]]:
    """Let a registration see the points in iterations 0 to 9; return it and the labels."""
    registration = Constellation(MISSED)
    for k in range(10):
        noisy = seen_at(points, k) + sigma * rng.standard_normal(points.shape)
        labels = registration.match(noisy, None)
    assert labels.tolist() == list(range(len(points)))
    return registration, labels


def spacing(points: Points) -> float:
    return float(np.median(np.sort(np.linalg.norm(points[:, None] - points, axis=2), axis=1)[:, 1]))


# The paper's own way.


def naive_nearest(scans: list[Points], gate_m: float | None) -> list[list[int]]:
    labels: list[list[int]] = []
    count = 0
    for k, now in enumerate(scans):
        before = scans[k - 1] if k else now[:0]
        limit = gate_m if gate_m is not None else np.inf
        if gate_m is None and len(before) > 1:
            limit = spacing(before) / 2
        row = []
        for i, point in enumerate(now):
            label = -1
            if len(before):
                j = int(np.argmin(np.linalg.norm(before - point, axis=1)))
                back = int(np.argmin(np.linalg.norm(now - before[j], axis=1)))
                if back == i and np.linalg.norm(before[j] - point) <= limit:
                    label = labels[k - 1][j]
            row.append(label)
        for i, label in enumerate(row):
            if label < 0:
                row[i], count = count, count + 1
        labels.append(row)
    return labels


@given(seeds, dimensions, st.sampled_from([None, 0.3, 1.0, 50.0]))
def test_nearest_previous_is_the_naive_mutual_search(
    seed: int, d: int, gate_m: float | None
) -> None:
    rng = np.random.default_rng(seed)
    scans = [rng.uniform(-2, 2, (n, d)) for n in rng.integers(0, 9, 5)]
    registration = NearestPrevious(gate_m)
    found = [registration.match(scan, None).tolist() for scan in scans]
    assert found == naive_nearest(scans, gate_m)
    numbers = set(itertools.chain(*found))
    assert numbers == set(range(len(numbers)))
    assert registration.labels_of(np.array([3, 0])).tolist() == [3, 0]


@pytest.mark.parametrize(("gate_m", "limit"), [(0.7, 0.7), (None, 1.0)])
def test_nearest_previous_stops_at_the_gate(gate_m: float | None, limit: float) -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [9.0, 9.0]])  # neighbours 2 apart
    for share, same in ((0.99, True), (1.01, False)):
        registration = NearestPrevious(gate_m)
        registration.match(square, None)
        moved = registration.match(square - share * limit / np.sqrt(2), None)
        assert moved.tolist() == ([0, 1, 2, 3] if same else [4, 5, 6, 7])


@given(st.lists(st.lists(st.integers(-3, 9), max_size=6, unique=True), max_size=8))
def test_known_ids_are_numbered_in_order_of_first_sight(scans: list[list[int]]) -> None:
    registration = KnownAssociation()
    order: list[int] = []
    for ids in scans:
        order += [i for i in ids if i >= 0 and i not in order]
        found = registration.match(np.zeros((len(ids), 2)), np.array(ids, dtype=np.int64))
        assert found.tolist() == [order.index(i) if i >= 0 else -1 for i in ids]
    assert registration.labels_of(np.arange(len(order))).tolist() == order


# By constellation.


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
def test_where_the_tracks_end_those_of_the_last_scan_go_on(d: int) -> None:
    rng = np.random.default_rng(d)
    registration, _ = settled(scattered(12, d, rng), 0.02, rng)
    for k in range(MISSED + 1):
        place = scattered(12, d, rng)
        labels = registration.match(place, None)
        assert labels.tolist() == list(range(12 * (k + 1), 12 * (k + 2)))
    np.testing.assert_array_equal(registration.match(seen_at(place, 1), None), labels)


@settings(max_examples=40)
@given(seeds, dimensions)
def test_scans_of_any_size_get_labels_of_their_own(seed: int, d: int) -> None:
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


@pytest.mark.parametrize(("d", "n"), [(2, 1), (3, 1), (3, 2)])
def test_too_few_points_to_tie_are_new_and_leave_the_tracks_alone(d: int, n: int) -> None:
    rng = np.random.default_rng(d)
    world = scattered(12, d, rng)
    registration, labels = settled(world, 0.02, rng)
    few = registration.match(seen_at(world[:n], 10), None)
    assert few.tolist() == list(range(12, 12 + n))
    assert registration.match(np.empty((0, d)), None).tolist() == []
    np.testing.assert_array_equal(registration.match(seen_at(world, 12), None), labels)


def test_two_familiar_landmarks_tie_a_planar_scan_but_two_strangers_do_not() -> None:
    rng = np.random.default_rng(2)
    world = scattered(12, 2, rng)
    registration, labels = settled(world, 0.01, rng)
    assert registration.match(seen_at(world[4:6], 10), None).tolist() == [4, 5]
    np.testing.assert_array_equal(registration.match(seen_at(world, 11), None), labels)
    strange = seen_at(world[4:6], 12) + np.array([[0.0, 0.0], [0.7, 0.7]])
    assert (registration.match(strange, None) >= 12).all()
    np.testing.assert_array_equal(registration.match(seen_at(world, 13), None), labels)


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


def test_new_tracks_that_are_missed_did_not_stray() -> None:
    tracks = LiveTracks.begun(np.arange(3), np.zeros((3, 2)))
    tracks.missed += 1
    assert tracks.restless.tolist() == [0, 0, 0]


# The placement.


@settings(max_examples=60)
@given(seeds, dimensions)
def test_trimmed_fit_finds_what_trying_every_subset_finds(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(10, 14))
    source, R, t = rng.uniform(-5, 5, (n, d)), random_rotation(d, 3.0, rng), rng.uniform(-9, 9, d)
    target = source @ R.T + t
    wrong = rng.permutation(n)[: int(rng.integers(0, n // 4 + 1))]
    astray = rng.normal(size=(len(wrong), d))
    astray /= np.linalg.norm(astray, axis=1)[:, None]
    target[wrong] += astray * rng.uniform(1, 3, (len(wrong), 1))
    counts = []
    for subset in itertools.combinations(range(n), d):
        rows = list(subset)
        fitted_R, fitted_t = fit_rigid(source[rows], target[rows])
        apart = np.linalg.norm(source @ fitted_R.T + fitted_t - target, axis=1)
        counts.append(int(np.sum(apart <= 0.1)))
    placement = trimmed_fit(source, target, 0.1)
    assert placement is not None
    assert placement.n_agreeing == max(counts) == n - len(wrong)
    np.testing.assert_allclose(placement.apply(source), source @ R.T + t, atol=1e-9)


def test_trimmed_fit_of_too_few_is_none() -> None:
    assert trimmed_fit(np.zeros((1, 2)), np.zeros((1, 2)), 0.1) is None
    assert trimmed_fit(np.zeros((2, 3)), np.zeros((2, 3)), 0.1) is None


def largest_clique(agree: NDArray[np.bool_]) -> int:
    """Return the size of the largest set of which all agree, by trying them all."""

    def grown(size: int, candidates: list[int]) -> int:
        rest = [
            grown(size + 1, [b for b in candidates[i + 1 :] if agree[a, b]])
            for i, a in enumerate(candidates)
        ]
        return max([size, *rest])

    return grown(0, list(range(len(agree))))


@settings(max_examples=60)
@given(seeds, dimensions, st.sampled_from([0.1, 1.0]))
def test_agreeing_pairs_are_the_largest_set_that_agrees(
    seed: int, d: int, tolerance_m: float
) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 8))
    source = rng.uniform(-5, 5, (n, d))
    target = source @ random_rotation(d, 3.0, rng).T + rng.uniform(-9, 9, d)
    candidates = np.vstack([np.column_stack([np.arange(n)] * 2), rng.integers(0, n, (7, 2))])
    pairs = rng.permutation(np.unique(candidates, axis=0))
    chosen = agreeing_pairs(source, target, pairs, tolerance_m)
    a, b = pairs.T
    here = np.linalg.norm(source[a][:, None] - source[a], axis=2)
    there = np.linalg.norm(target[b][:, None] - target[b], axis=2)
    agree = (np.abs(here - there) <= tolerance_m) & (a[:, None] != a) & (b[:, None] != b)
    assert agree[np.ix_(chosen, chosen)][~np.eye(len(chosen), dtype=bool)].all()
    assert len(chosen) == largest_clique(agree)
