from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from relmap import MapperConfig, PointMapper, RelmapError
from tests.worlds import aligned_rmse, finished, mapped, random_rotation, walk

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
few = settings(max_examples=15)


def rmse(mapper: PointMapper, landmarks: np.ndarray) -> float:
    """Return the error of a map whose labels are the true ones."""
    d = landmarks.shape[1]
    return aligned_rmse(mapper.map.positions[:, :d], landmarks[mapper.map.landmark_ids])


@few
@given(seeds, dimensions)
def test_the_map_is_exact_without_noise(seed: int, d: int) -> None:
    world = walk(d, seed)
    mapper = mapped(world.scans)
    seen = np.unique(np.concatenate([ids for ids, _ in world.scans]))
    np.testing.assert_array_equal(mapper.map.landmark_ids, seen)
    assert rmse(mapper, world.landmarks) < 1e-9


@few
@given(seeds, dimensions)
def test_the_frame_is_that_of_the_first_pose(seed: int, d: int) -> None:
    world = walk(d, seed)
    mapper = mapped(world.scans)
    expected = np.zeros((len(mapper.map.landmark_ids), 3))
    expected[:, :d] = world.landmarks[mapper.map.landmark_ids]
    np.testing.assert_allclose(mapper.map.positions, expected, atol=1e-9)
    (R0, t0), poses = world.poses[0], mapper.trajectory
    for T, (R, t) in zip(poses, world.poses, strict=True):
        np.testing.assert_allclose(T[:d, :d], R0.T @ R, atol=1e-9)
        np.testing.assert_allclose(T[:d, 3], R0.T @ (t - t0), atol=1e-9)


@few
@given(seeds, dimensions)
def test_a_rigid_motion_of_any_scan_changes_nothing_but_the_frame(seed: int, d: int) -> None:
    world, rng = walk(d, seed), np.random.default_rng(seed)
    moved = [
        (ids, points @ random_rotation(d, 3.0, rng).T + rng.normal(0, 50, d))
        for ids, points in world.scans
    ]
    assert rmse(mapped(moved), world.landmarks) < 1e-9


@few
@given(seeds, dimensions)
def test_the_order_of_rows_and_the_names_of_ids_change_nothing_but_labels(
    seed: int, d: int
) -> None:
    world, rng = walk(d, seed), np.random.default_rng(seed)
    names = rng.permutation(10_000)[: len(world.landmarks)] * 10**12
    shuffled = []
    for ids, points in world.scans:
        order = rng.permutation(len(ids))
        shuffled.append((names[ids[order]], points[order]))
    plain, other = mapped(world.scans).map, mapped(shuffled).map
    by_name = dict(zip(other.landmark_ids.tolist(), other.positions, strict=True))
    assert len(by_name) == len(plain.landmark_ids)
    for label, position in zip(plain.landmark_ids, plain.positions, strict=True):
        np.testing.assert_allclose(by_name[int(names[label])], position, atol=1e-9)


@few
@given(seeds, dimensions)
def test_nearest_association_needs_no_ids(seed: int, d: int) -> None:
    landmarks, rng = walk(d, seed).landmarks, np.random.default_rng(seed)
    turned = random_rotation(d, 3.0, rng)
    scans = [landmarks @ turned.T - 0.05 * k for k in range(60)]
    in_view = [np.linalg.norm(scan, axis=1) < 12 for scan in scans]
    assume(min(seen.sum() for seen in in_view) >= 4)
    mapper = PointMapper()
    for scan, seen in zip(scans, in_view, strict=True):
        labels = mapper.update(scan[seen])
        assert len(np.unique(labels)) == len(labels)
    mapper.finish()
    table = mapper.landmarks
    assert len(table.landmark) == np.any(in_view, axis=0).sum()
    assert (table.level[table.observations >= 10] > 0).all()


def test_the_same_input_gives_bit_identical_output() -> None:
    world = walk(3, 5, sigma=0.05)
    first, second = mapped(world.scans), mapped(world.scans)
    assert first.map.positions.tobytes() == second.map.positions.tobytes()
    assert first.trajectory.tobytes() == second.trajectory.tobytes()


@pytest.mark.parametrize("d", [2, 3])
def test_noise_and_sd_are_those_of_the_observations(d: int) -> None:
    world = walk(d, 1, sigma=0.05, iterations=400)
    mapper = mapped(world.scans)
    assert mapper.noise_m == pytest.approx(0.05, rel=0.05)
    table = mapper.landmarks
    assert (table.sd >= 0.99 * mapper.noise_m / np.sqrt(table.observations)).all()
    assert np.median(table.sd / (mapper.noise_m / np.sqrt(table.observations))) < 1.2


def test_the_table_lists_every_landmark() -> None:
    world = walk(3, 2)
    stranger = 999
    scans = [
        (np.append(ids, stranger) if k == 50 else ids, np.vstack([p, [9, 9, 9]]) if k == 50 else p)
        for k, (ids, p) in enumerate(world.scans)
    ]
    table = mapped(scans).landmarks
    for row, label in enumerate(table.landmark):
        when = [k for k, (ids, _) in enumerate(scans) if label in ids]
        assert table.observations[row] == len(when)
        assert (table.first_iteration[row], table.last_iteration[row]) == (when[0], when[-1])
    assert (np.diff(table.landmark) > 0).all()
    np.testing.assert_array_equal(np.isfinite(table.position[:, 0]), table.level > 0)
    np.testing.assert_array_equal(np.isfinite(table.sd), table.level > 0)
    assert set(table.status[table.level > 0]) == {"static"}


def test_update_names_the_landmark_of_each_row() -> None:
    mapper = PointMapper()
    labels = mapper.update([[0, 0, 1], [5, 0, 0], [1, 4, 0]], ids=[70, -1, 3])
    assert labels.tolist() == [70, -1, 3]
    assert mapper.update([[1, 1, 1]], ids=[-5]).tolist() == [-1]
    nearest = PointMapper(MapperConfig(registration="nearest-previous"))
    assert nearest.update([[0, 0], [5, 0], [1, 4]]).tolist() == [0, 1, 2]
    assert nearest.update([[5.1, 0.0], [0.1, 0.0], [20.0, 20.0]]).tolist() == [1, 0, 3]


@pytest.mark.parametrize("known", [True, False])
def test_labels_never_returned_are_refused(known: bool) -> None:
    mapper, ids = PointMapper(), np.array([70, -1, 3])
    for k in range(3):
        labels = mapper.update(
            [[0, 0, 1 + 0.1 * k], [5, 0, 0.1 * k], [1, 4, 0.1 * k]], ids if known else None
        )
    assert mapper.landmarks_of(labels).tolist() == labels.tolist()
    assert mapper.landmarks_of([[-1], [labels[0]]]).tolist() == [[-1], [labels[0]]]
    for unknown in (4, -2, 71, 2**40):
        with pytest.raises(RelmapError, match=f"labels holds {unknown}, which no update"):
            mapper.landmarks_of([labels[0], unknown])
    with pytest.raises(RelmapError, match="labels has type float64"):
        mapper.landmarks_of([0.5])
    with pytest.raises(RelmapError, match="labels must be"):
        mapper.landmarks_of([[0], [0, 0]])
    with pytest.raises(RelmapError, match="labels holds 0"):
        PointMapper().landmarks_of([0])


def test_a_gap_in_sight_and_empty_scans_are_part_of_the_stream() -> None:
    world = walk(3, 3)
    scans = list(world.scans)
    for k in (0, 1, 30, 31, 77):
        scans[k] = (np.empty(0, dtype=np.int64), np.empty((0, 3)))
    mapper = mapped(scans)
    assert rmse(mapper, world.landmarks) < 1e-9
    assert np.isnan(mapper.trajectory[:, 0, 0]).nonzero()[0].tolist() == [0, 1, 30, 31, 77]


def test_nothing_seen_gives_an_empty_map() -> None:
    mapper = PointMapper()
    mapper.update([])
    mapper.update(np.empty((0, 2)))
    mapper.finish()
    assert mapper.map.positions.shape == (0, 3)
    assert mapper.trajectory.shape == (2, 4, 4)
    assert np.isnan(mapper.trajectory).all()
    assert PointMapper().map.positions.shape == (0, 3)


def test_too_few_landmarks_stay_unmapped_without_nan_or_warning() -> None:
    mapper = PointMapper()
    for k in range(40):
        mapper.update([[1.0 + 0.1 * k, 0.0, 0.0], [0.0, 2.0, 0.0], [3.0, 3.0, 3.0]], ids=[0, 1, 2])
    mapper.finish()
    assert len(mapper.map.positions) == 0
    assert set(mapper.landmarks.status) == {"unmapped"}


def test_landmarks_on_one_line_stay_unmapped() -> None:
    line = np.outer(np.arange(8.0), [1.0, 2.0, 0.5])
    mapper = finished(PointMapper(), ((line - [0.1 * k, 0, 0], np.arange(8)) for k in range(40)))
    assert len(mapper.map.positions) == 0


@pytest.mark.parametrize(
    ("points", "ids", "message"),
    [
        ([[1, 2, np.nan]], [1], "points row 0.*finite"),
        ([[1, 2, 3], [4, np.inf, 6]], [1, 2], "points row 1.*finite"),
        ([1, 2, 3], [1], "shape"),
        ([[1, 2, 3, 4]], [1], "shape"),
        ([[1, 2]], [1], "2 columns; earlier scans had 3"),
        ([["a", "b", "c"]], [1], "array of numbers"),
        ([[1, 2, 3], [1, 2]], [1, 2], "array of numbers"),
        ([[1, 2, 3]], [1, 2], "ids has shape"),
        ([[1, 2, 3], [4, 5, 6]], [7, 7], "ids holds 7 twice"),
        ([[1, 2, 3]], [1.5], "whole numbers"),
        ([[1, 2, 3]], np.ma.MaskedArray([1], mask=[True]), "ids has masked values"),
        ([[1, 2, 3]], None, "ids came with earlier scans"),
    ],
)
def test_a_rejected_scan_says_why_and_changes_nothing(
    points: object, ids: object, message: str
) -> None:
    world = walk(3, 4)
    plain, tried = PointMapper(), PointMapper()
    for k, (known, seen) in enumerate(world.scans):
        plain.update(seen, known)
        tried.update(seen, known)
        if k == 40:
            with pytest.raises(RelmapError, match=message):
                tried.update(points, ids)  # type: ignore[arg-type]
    assert tried.trajectory.tobytes() == plain.trajectory.tobytes()
    assert tried.map.positions.tobytes() == plain.map.positions.tobytes()


def test_a_mapper_that_is_let_go_frees_its_memory_at_once() -> None:
    world = walk(3, 5, sigma=0.05)
    mapped(world.scans)  # compiles the kernels, which may hold on to what they were called with
    mapper = mapped(world.scans)
    mapper.refine()
    alive = weakref.ref(mapper)
    gc.disable()
    try:
        del mapper
        assert alive() is None
    finally:
        gc.enable()


def test_the_scan_is_copied() -> None:
    points = np.array([[1.0, 0, 0], [0, 2, 0], [3, 3, 3], [4, 0, 1]])
    kept, changed = PointMapper(), PointMapper()
    for _ in range(12):
        kept.update(points.copy())
        mine = points.copy()
        changed.update(mine)
        mine[:] = np.nan
    assert kept.map.positions.tobytes() == changed.map.positions.tobytes()


def test_accepts_what_sensors_give() -> None:
    points = np.array([[1.0, 0, 0], [0, 2, 0], [3, 3, 3], [4, 0, 1]])
    float32, column_major = points.astype(np.float32), np.asfortranarray(points)
    views = [float32, column_major, np.repeat(points, 2, axis=0)[::2], points.tolist()]
    frozen = points.copy()
    frozen.flags.writeable = False
    mapper = PointMapper()
    for view in [*views, frozen] * 3:
        assert mapper.update(view).tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(mapper.map.positions, points, atol=1e-12)


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"group_after": 0}, "group_after is 0"),
        ({"group_after": 2.5}, "group_after is 2.5"),
        ({"group_after": 10**10}, "whole number, 1 or more, up to 1000000000"),
        ({"third_pass": 10**5000}, "third_pass is a number with thousands of digits"),
        ({"bridge_m": 10**400}, "bridge_m is 1000.*up to 1000000000"),
        ({"max_missed": True}, "max_missed is True"),
        ({"gate_m": -1.0}, "gate_m is -1.0"),
        ({"gate_m": float("nan")}, "gate_m is nan"),
        ({"gate_m": "wide"}, "gate_m is 'wide'"),
        ({"registration": "icp"}, "registration is 'icp'"),
        ({"group_afer": 4}, "did you mean group_after"),
        ({"zzz": 4}, "known are"),
    ],
)
def test_settings_are_checked(settings_: dict[str, object], message: str) -> None:
    with pytest.raises(RelmapError, match=message):
        MapperConfig.from_mapping(settings_)
