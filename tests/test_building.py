"""The simulated building: its plan, its drive, its sensors and its truth."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import RelmapError
from relmap.core.arrays import Floats
from relmap.simulation import Building, BuildingScan, building_scene, simulate_building
from relmap.simulation.building import SENSOR_HEIGHT_M
from relmap.simulation.floor_plan import World, make_floor_plan
from relmap.simulation.sensor import Sampling, Sensor, sensor_of
from relmap.simulation.shapes import wall_distances
from tests.segments import crossings

WORLDS: tuple[World, ...] = ("building", "panels", "long-wall")


@pytest.fixture(scope="module")
def exact() -> Building:
    return simulate_building(points=300, sigma=0.0, sample_ends=True, seed=3)


@pytest.mark.parametrize("world", WORLDS)
def test_walls_do_not_cross(world: World) -> None:
    for seed in range(40):
        walls = make_floor_plan(world, np.random.default_rng(seed)).walls
        assert crossings(walls) == 0
        assert np.linalg.norm(walls[:, 2:4] - walls[:, :2], axis=1).min() > 0.75
        assert len(np.unique(walls[:, 4:], axis=0)) == 1


def test_crossings_are_counted() -> None:
    walls = np.array([[0, 0, 2, 2, 0, 1], [0, 2, 2, 0, 0, 1], [0, 0, 0, 2, 0, 1.0]])
    assert crossings(walls) == 2


def test_the_building_is_closed_but_for_doors_between_its_rooms() -> None:
    """Standing anywhere inside, every ray ends at a wall."""
    far = Sensor(range_m=100.0, view_rad=np.pi)
    for seed in range(15):
        ranges = building_scene(seed, 721, 0.0, sampling="laser", sensor=far).ranges_m
        assert np.isfinite(ranges).all()


@pytest.mark.parametrize("seed", range(4))
def test_half_way_along_the_long_wall_nothing_else_is_in_view(seed: int) -> None:
    run = simulate_building(points=1, sigma=0.0, seed=seed, world="long-wall")
    bare = [
        bool((scan.seen.wall == 0).all() and "corner" not in scan.seen.end_type)
        for scan in run.scans
        if len(scan.seen.wall)
    ]
    twice = "".join("x" if alone else "." for alone in [*bare, *bare])
    assert 40 <= max(map(len, twice.split("."))) <= 70


def test_panels_are_free_standing_and_have_two_sides() -> None:
    walls = make_floor_plan("panels", np.random.default_rng(0)).walls
    assert len(walls) >= 40
    np.testing.assert_array_equal(walls[::2, :4], walls[1::2][:, [2, 3, 0, 1]])
    panels = walls[::2]
    for k in range(len(panels)):
        t = np.linspace(0, 1, 50)[:, None]
        points = (1 - t) * panels[k, :2] + t * panels[k, 2:4]
        assert wall_distances(points, np.delete(panels, k, axis=0)).min() > 0.5


@pytest.mark.parametrize("world", WORLDS)
def test_the_robot_drives_smoothly_round_and_touches_nothing(world: World) -> None:
    for seed in range(5):
        run = simulate_building(points=1, world=world, seed=seed)
        assert 150 <= len(run.scans) <= 400
        T = run.trajectory
        np.testing.assert_allclose(T[:, 2], np.tile([0, 0, 1, 0], (len(T), 1)))
        np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1.0)
        round_trip = np.concatenate([T, T[:1]])
        steps = np.linalg.norm(np.diff(round_trip[:, :2, 3], axis=0), axis=1)
        assert steps.min() > 0.1
        assert steps.max() < 0.3
        yaw = np.unwrap(np.arctan2(round_trip[:, 1, 0], round_trip[:, 0, 0]))
        assert np.abs(np.diff(yaw)).max() < np.deg2rad(6)
        assert yaw[-1] - yaw[0] == pytest.approx(2 * np.pi)
        assert wall_distances(T[:, :2, 3], run.walls).min() > 0.4
        assert (np.diff(run.stamps_s) > 0).all()


def test_a_loop_ends_where_it_began_and_sees_the_first_walls_again() -> None:
    run = simulate_building(points=1, loops=2)
    half = len(run.scans) // 2
    np.testing.assert_allclose(run.trajectory[:half], run.trajectory[half:], atol=1e-9)
    first = set(run.scans[0].seen.wall.tolist())
    seen_again = [bool(first & set(scan.seen.wall.tolist())) for scan in run.scans[:half]]
    assert first <= set(run.scans[half].seen.wall.tolist())
    assert seen_again[half - 1]
    assert sum(seen_again) < half / 2


def walls_of(run: Building, scan: int) -> Floats:
    """Return the ends (n, 2, 2) of the wall of each point, robot frame."""
    T = run.trajectory[scan]
    ends = run.walls[run.scans[scan].wall][:, :4].reshape(-1, 2, 2)
    return np.asarray((ends - T[:2, 3]) @ T[:2, :2])


def test_without_noise_points_lie_on_their_walls(exact: Building) -> None:
    low, high = exact.walls[0, 4:]
    assert low == -SENSOR_HEIGHT_M
    for number, scan in enumerate(exact.scans):
        ends = walls_of(exact, number)
        along = ends[:, 1] - ends[:, 0]
        offset = scan.points[:, :2] - ends[:, 0]
        length = np.linalg.norm(along, axis=1)
        across = (along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / length
        t = (offset * along).sum(axis=1) / length**2
        assert np.abs(across).max() < 1e-12
        assert t.min() >= -1e-12
        assert t.max() <= 1 + 1e-12
        assert low <= scan.points[:, 2].min()
        assert scan.points[:, 2].max() <= high
        np.testing.assert_array_equal(scan.wall, scan.seen.wall[scan.stretch])


def test_ends_are_sampled_exactly_on_request(exact: Building) -> None:
    n_checked = 0
    for scan in exact.scans:
        for number, ends in enumerate(scan.seen.ends):
            on = scan.points[scan.stretch == number, :2]
            if len(on) >= 2:
                assert (on == ends[0]).all(axis=1).any()
                assert (on == ends[1]).all(axis=1).any()
                n_checked += 1
    assert n_checked > 100


def test_true_corners_are_corners_of_the_map(exact: Building) -> None:
    for pose, scan in zip(exact.trajectory, exact.scans, strict=True):
        in_map = scan.seen.ends @ pose[:2, :2].T + pose[:2, 3]
        true = exact.walls[scan.seen.wall][:, :4].reshape(-1, 2, 2)
        corner = scan.seen.end_type == "corner"
        np.testing.assert_allclose(in_map[corner], true[corner], atol=1e-12)


def test_how_often_a_wall_and_its_ends_were_seen_is_counted(exact: Building) -> None:
    counts = exact.times_seen()
    for wall in range(len(exact.walls)):
        rows = [scan.seen.end_type[scan.seen.wall == wall] for scan in exact.scans]
        assert counts[wall, 0] == sum(len(types) > 0 for types in rows)
        for side in (0, 1):
            assert counts[wall, 1 + side] == sum((t[:, side] == "corner").any() for t in rows)
    assert (counts[:, 0] == 0).any()
    assert (counts[:, 1:] > 0).all(axis=1).any()


def test_points_are_uniform_on_the_surface() -> None:
    scan = building_scene(5, points=40_000, sigma=0.0, sensor=Sensor(8.0, np.pi))
    lengths = np.linalg.norm(scan.seen.ends[:, 1] - scan.seen.ends[:, 0], axis=1)
    assert len(lengths) >= 3
    expected = lengths / lengths.sum()
    counts = np.bincount(scan.stretch, minlength=len(lengths)) / 40_000
    np.testing.assert_allclose(counts, expected, atol=4 * np.sqrt(0.25 / 40_000))
    for number, (a, b) in enumerate(scan.seen.ends):
        t = (scan.points[scan.stretch == number, :2] - a) @ (b - a) / ((b - a) @ (b - a))
        if len(t) > 1000:
            np.testing.assert_allclose(
                np.quantile(t, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.04
            )


def test_noise_has_the_given_standard_deviation() -> None:
    clean = building_scene(1, points=20_000, sigma=0.0).points
    for noise in ("gaussian", "uniform"):
        error = building_scene(1, points=20_000, sigma=0.2, noise=noise).points - clean
        # The same draws place the points; the noise comes after them.
        np.testing.assert_allclose(error.std(axis=0), 0.2, rtol=0.03)
        np.testing.assert_allclose(error.mean(axis=0), 0.0, atol=0.01)
        assert (np.abs(error).max() <= 0.2 * np.sqrt(3)) == (noise == "uniform")


def test_the_beams_of_a_laser_are_equally_spaced_from_right_to_left() -> None:
    scan = building_scene(2, points=181, sigma=0.0, sampling="laser", sensor=Sensor(4.0, np.pi))
    assert scan.ranges_m.shape == (181,)
    bearing = np.deg2rad(np.arange(-90, 91))
    returned = np.isfinite(scan.ranges_m)
    assert 0 < returned.sum() < 181
    assert scan.ranges_m[returned].max() <= 4.0 + 1e-9
    ray = np.column_stack([np.cos(bearing), np.sin(bearing)])[returned]
    expected = scan.ranges_m[returned, None] * ray
    np.testing.assert_allclose(scan.points[:, :2], expected, atol=1e-9)
    assert not scan.points[:, 2].any()


def test_the_noise_of_beams_is_along_them() -> None:
    samplings: tuple[Sampling, ...] = ("rays", "laser")
    for sampling in samplings:
        clean = building_scene(1, points=4000, sigma=0.0, sampling=sampling).points
        noisy = building_scene(1, points=4000, sigma=0.1, sampling=sampling).points
        ray = clean / np.linalg.norm(clean, axis=1)[:, None]
        along = ((noisy - clean) * ray).sum(axis=1)
        np.testing.assert_allclose(noisy, clean + along[:, None] * ray, atol=1e-12)
        assert along.std() == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("sampling", ["rays", "laser"])
def test_no_beam_measures_behind_the_sensor_however_large_the_noise(sampling: Sampling) -> None:
    scan = building_scene(1, points=4000, sigma=3.0, sampling=sampling)
    half_view = sensor_of(sampling).view_rad / 2
    bearing = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    assert np.abs(bearing).max() <= half_view + 1e-9
    assert scan.ranges_m is None or (scan.ranges_m > 0).all()


def test_rays_are_a_grid_of_azimuth_and_elevation() -> None:
    sensor = Sensor(vertical_view_rad=np.deg2rad(40))
    scan = building_scene(5, points=2000, sigma=0.0, sampling="rays", sensor=sensor)
    azimuth = np.degrees(np.arctan2(scan.points[:, 1], scan.points[:, 0]))
    flat = np.hypot(scan.points[:, 0], scan.points[:, 1])
    elevation = np.degrees(np.arctan2(scan.points[:, 2], flat))
    assert (np.diff(azimuth) > -1e-9).all()
    for angles, half in ((azimuth, 45), (elevation, 20)):
        different = np.unique(angles.round(6))
        assert np.abs(different).max() <= half + 1e-6
        np.testing.assert_allclose(np.diff(different), np.diff(different).min(), atol=1e-5)
    assert 500 < len(scan.points) <= 2100


def content(scans: list[BuildingScan]) -> bytes:
    return b"".join(scan.points.tobytes() + scan.seen.ends.tobytes() for scan in scans)


@pytest.mark.parametrize("sampling", ["surface", "rays", "laser"])
def test_a_seed_gives_the_same_run_and_another_seed_another(sampling: Sampling) -> None:
    first, again, other = (
        simulate_building(points=50, iterations=30, sampling=sampling, seed=seed)
        for seed in (4, 4, 5)
    )
    assert content(first.scans) == content(again.scans)
    assert content(first.scans) != content(other.scans)
    assert len(first.scans) == len(first.trajectory) == len(first.stamps_s) == 30


def test_iterations_go_on_round() -> None:
    once = simulate_building(points=1)
    k = len(once.scans)
    more = simulate_building(points=1, iterations=k + 5)
    np.testing.assert_allclose(more.trajectory[k:], once.trajectory[:5], atol=1e-12)


@pytest.mark.parametrize(
    "bad",
    [
        {"points": 0},
        {"sigma": -1.0},
        {"sigma": float("nan")},
        {"noise": "pink"},
        {"sampling": "sonar"},
        {"iterations": 0},
        {"seed": -1},
        {"world": "moon"},
        {"loops": 0},
        {"sensor": Sensor(range_m=0.0)},
        {"sensor": Sensor(view_rad=6.3)},
    ],
)
def test_arguments_out_of_range_are_named(bad: dict[str, object]) -> None:
    name = next(iter(bad))
    with pytest.raises(RelmapError, match="range|view" if name == "sensor" else name):
        simulate_building(**bad)  # type: ignore[arg-type]
